"""Shape coefficients of the body model from a person's height, mass and segment lengths.

Regularised least squares (Gauss-Newton): each figure is compared in units of the accuracy it is worth, each
coefficient in units of its spread in the population. Figures that are not known are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hilbrace.body.anny_lite import AnnyLite
from hilbrace.body.segments import model_joints

Array = np.ndarray

DENSITY = 1010.0
"""Density of the whole body in quiet breathing [kg/m^3]."""

STEPS = 8
_SLIDER_SPREAD = 0.5
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


Measure = Callable[[AnnyLite, Float[Array, " coefficient"]], dict[str, Figure]]


def target_figures(joints: dict[str, Float[Array, " 3"]]) -> dict[str, float]:
    """The lengths that `measure` takes, of a skeleton's joint centres."""
    return {name: float(np.linalg.norm(arrow)) for name, arrow in _arrows(joints).items()}


def fit_shape(
    model: AnnyLite, target: dict[str, float], height_m: float | None, volume_m3: float
) -> Float[Array, " coefficient"]:
    """The most ordinary shape whose figures are those wanted, each to its accuracy.

    Args:
        model: The body model.
        target: Lengths between joint centres (`target_figures`).
        height_m: Height in the A-pose [m]; ``None`` where unknown.
        volume_m3: Volume [m^3].
    """
    wanted = {**target, "volume": float(np.log(volume_m3))}
    if height_m is not None:
        wanted["height"] = height_m
    spread = np.full(len(model.coefficient_names), _SLIDER_SPREAD)
    spread[: model.components] = 1.0
    shape = np.zeros(len(spread))
    weight = np.array([1.0 / _ACCURACY[name] for name in wanted])
    for _ in range(STEPS):
        figures = measure(model, shape)
        misfit = weight * np.array([goal - figures[name].value for name, goal in wanted.items()])
        slopes = weight[:, None] * np.array([figures[name].slope for name in wanted])
        normal = slopes.T @ slopes + np.diag(spread**-2)
        shape = np.linalg.solve(normal, slopes.T @ (misfit + slopes @ shape))
    return shape


def measure(model: AnnyLite, shape: Float[Array, " coefficient"]) -> dict[str, Figure]:
    """Figures of a body in the A-pose, with their slopes: lengths, height and logarithm of the volume."""
    vertices, joints = model.vertices(shape), model_joints(model, model.heads(shape))
    moves = [model_joints(model, move) for move in model.head_directions]
    figures = {}
    for name, arrow in _arrows(joints).items():
        length = float(np.linalg.norm(arrow))
        figures[name] = Figure(length, np.array([_arrows(m)[name] @ arrow for m in moves]) / length)
    top, bottom = vertices[:, 1].argmax(), vertices[:, 1].argmin()
    rise = model.directions[:, top, 1] - model.directions[:, bottom, 1]
    figures["height"] = Figure(float(np.ptp(vertices[:, 1])), rise)
    volume, gradient = enclosed_volume(vertices, model.triangles)
    slope = np.tensordot(model.directions, gradient, 2) / volume
    figures["volume"] = Figure(float(np.log(volume)), slope)
    return figures


def enclosed_volume(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> tuple[float, Float[Array, "vertex 3"]]:
    """Volume inside a closed surface, and its gradient by the vertices."""
    a, b, c = (vertices[corner] for corner in triangles.T)
    gradient = np.zeros_like(vertices)
    for corner, (u, v) in zip(triangles.T, ((b, c), (c, a), (a, b)), strict=True):
        np.add.at(gradient, corner, np.cross(u, v) / 6.0)
    return float((np.cross(a, b) * c).sum() / 6.0), gradient


def _arrows(joints: dict[str, Float[Array, " 3"]]) -> dict[str, Float[Array, " 3"]]:
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
