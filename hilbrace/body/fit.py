"""Shape coefficients of the body model from a person's height, mass, segment lengths and joint breadths.

Regularised least squares (Gauss-Newton): each figure is compared in units of the accuracy it is worth, each
coefficient in units of its spread in the population. Figures that are not known are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hilbrace.body.model import BodyModel

Array = np.ndarray

DENSITY = 1010.0
"""Density of the whole body in quiet breathing [kg/m^3]."""

STEPS = 4
_LEVEL = 0.012
"""Half the thickness of the slice in which a breadth is taken [m]."""

_ACCURACY = {
    "height": 0.002,
    "volume": 0.003,
    "thigh": 0.004,
    "shank": 0.004,
    "hips": 0.008,
    "shoulders": 0.02,
    "shoulder height": 0.025,
    "upper arm": 0.015,
    "forearm": 0.015,
    "knee breadth": 0.005,
    "ankle breadth": 0.005,
}
"""Standard deviation of each figure [m]; of the volume, as a fraction."""


@dataclass(frozen=True)
class Figure:
    """One measurable figure of a body.

    Attributes:
        value: Its value [m]; of the volume, its logarithm.
        slope: Its change per unit of each shape coefficient.
    """

    value: float
    slope: Float[Array, " coefficient"]


def target_figures(joints: dict[str, Float[Array, " 3"]]) -> dict[str, float]:
    """The lengths that `measure` takes, of a skeleton's joint centres."""
    return {name: float(np.linalg.norm(arrow)) for name, arrow in _arrows(joints).items()}


def fit_shape(model: BodyModel, wanted: dict[str, float]) -> Float[Array, " coefficient"]:
    """The most ordinary shape whose figures are those wanted, each to its accuracy.

    Args:
        model: The body model.
        wanted: Figures by their names in `measure`; those that are not known are left out.
    """
    shape = np.zeros(len(model.coefficient_names))
    weight = np.array([1.0 / _ACCURACY[name] for name in wanted])
    for _ in range(STEPS):
        figures = measure(model, shape)
        misfit = weight * np.array([goal - figures[name].value for name, goal in wanted.items()])
        slopes = weight[:, None] * np.array([figures[name].slope for name in wanted])
        normal = slopes.T @ slopes + np.diag(model.spread**-2)
        shape = np.linalg.solve(normal, slopes.T @ (misfit + slopes @ shape))
    return shape


def measure(model: BodyModel, shape: Float[Array, " coefficient"]) -> dict[str, Figure]:
    """Figures of a body in the pose of the model, with their slopes.

    Lengths between joint centres [m], ``"height"`` [m], ``"knee breadth"`` and ``"ankle breadth"`` from the
    inner to the outer side of the skin at the joint [m], and the logarithm of the ``"volume"`` in m^3.
    """
    vertices, joints = model.vertices(shape), model.joints(shape)
    moves = _arrows(model.joint_moves())
    figures = {}
    for name, arrow in _arrows(joints).items():
        length = float(np.linalg.norm(arrow))
        figures[name] = Figure(length, moves[name] @ arrow / length)
    crown, sole = int(vertices[:, 1].argmax()), int(vertices[:, 1].argmin())
    spans = {"height": (crown, sole, np.array([0.0, 1.0, 0.0]))}
    spans |= {f"{joint} breadth": _across(model, joint) for joint in ("knee", "ankle")}
    for name, (first, last, direction) in spans.items():
        slope = (model.directions[:, first] - model.directions[:, last]) @ direction
        figures[name] = Figure(float((vertices[first] - vertices[last]) @ direction), slope)
    volume, gradient = enclosed_volume(vertices, model.triangles)
    slope = np.tensordot(model.directions, gradient, 2) / volume
    figures["volume"] = Figure(float(np.log(volume)), slope)
    return figures


def enclosed_volume(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> tuple[float, Float[Array, "vertex 3"]]:
    """Volume inside a closed surface, and its gradient by the vertices."""
    a, b, c = (vertices[corner] for corner in triangles.T)
    pull = np.concatenate([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) / 6.0
    corners = triangles.T.ravel()
    gradient = np.stack([np.bincount(corners, axis, len(vertices)) for axis in pull.T], axis=1)
    return float((pull[: len(a)] * a).sum()), gradient


def _across(model: BodyModel, joint: str) -> tuple[int, int, Float[Array, " 3"]]:
    """Outermost and innermost vertex of the right leg around a joint in the mean adult, and the direction."""
    joints = model.joints(np.zeros(0))
    along = joints["hip_r"] - joints["ankle_r"]
    along /= np.linalg.norm(along)
    direction = np.array([0.0, 0.0, 1.0]) - along[2] * along
    direction /= np.linalg.norm(direction)
    offset = model.template - joints[f"{joint}_r"]
    level = np.flatnonzero((np.abs(offset @ along) < _LEVEL) & (model.template[:, 2] > 0.0))
    across = offset[level] @ direction
    return int(level[across.argmax()]), int(level[across.argmin()]), direction


def _arrows(joints: dict[str, Float[Array, "*batch 3"]]) -> dict[str, Float[Array, "*batch 3"]]:
    """Vectors whose lengths describe a person; means of both sides, left mirrored onto right."""
    flip = np.array([1.0, 1.0, -1.0])
    mean = {
        name[:-2]: (joints[name] + flip * joints[f"{name[:-2]}_l"]) / 2.0
        for name in joints
        if name.endswith("_r")
    }
    up, side = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    return {
        "thigh": mean["knee"] - mean["hip"],
        "shank": mean["ankle"] - mean["knee"],
        "hips": mean["hip"] * side,
        "shoulders": mean["shoulder"] * side,
        "shoulder height": (mean["shoulder"] - mean["hip"]) * up,
        "upper arm": mean["elbow"] - mean["shoulder"],
        "forearm": mean["wrist"] - mean["elbow"],
    }
