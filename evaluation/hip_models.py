"""Where the hip joint centre is, from what is known about one standing person.

The choice moves the angles: a trochanter marker taken as the centre turns the frontal angle by more than
five degrees, an iliac spine the sagittal one by nearly seven. A difference between conditions hardly feels
it; the frontal column of the paper's table, which is compared with zero, does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from evaluation.conventions import Side
from evaluation.protocol import HipSettings, MarkerLabels
from hilbrace.body.body import Body
from hilbrace.errors import ConfigError, InputError
from hilbrace.run.records import load

Array = np.ndarray

TROCHANTER_SHARE = 0.25
"""Medial depth of the centre over the trochanters' distance (Weinhandl & O'Connor 2010, J Biomech 43)."""

BELL = (-0.19, -0.30, 0.36)
"""Anterior, up and lateral over the width between the ASIS, from their middle (Bell et al. 1990, J Biomech
23:617, as Visual3D applies it)."""

_UPWARDS = np.array([0.0, 1.0, 0.0])

Points = Mapping[str, Float[Array, " 3"]]
Value = TypeVar("Value")


def hip_centre(points: Points, labels: MarkerLabels, settings: HipSettings, side: Side) -> Float[Array, " 3"]:
    """Hip joint centre of a standing person [m].

    Args:
        points: Standing positions by label, y up [m].
        labels: The protocol's labels.
        settings: The chosen model and its figures.
        side: Which leg.

    Raises:
        ConfigError: The model needs a label or figure that is not given.
        InputError: A marker that the model needs is not in the standing trial.
    """
    if settings.model in ("bell", "harrington"):
        return _regression(points, labels, settings.model, side)
    marker = _point(points, labels.hip, "markers.hip", settings.model)
    if settings.model == "marker":
        return marker
    forward, medial = _knee_directions(points, labels, side)
    if settings.model == "offset":
        anterior, up, inward = _given(settings.offset_m, "hip.offset_m", settings.model)
        return marker + anterior * forward + up * _UPWARDS + inward * medial
    if settings.model == "trochanter":
        width = _given(settings.trochanter_width_m, "hip.trochanter_width_m", settings.model)
        return marker + (TROCHANTER_SHARE * width + settings.marker_radius_m) * medial
    body = load(Body, _given(settings.body, "hip.body", settings.model))
    return marker + (depth_under_skin(body, side) + settings.marker_radius_m) * medial


def depth_under_skin(body: Body, side: Side, slab_m: float = 0.015) -> float:
    """How far the hip joint centre lies medially of the skin at its height [m].

    Args:
        body: A fitted body in its neutral pose.
        side: Which leg.
        slab_m: Half height of the slice of skin that is looked at [m].

    Raises:
        InputError: No skin lies lateral of the centre.
    """
    outward = 1.0 if side == "right" else -1.0
    centre = body.joint_centres[body.joint_names.index(f"hip_{side[0]}")]
    reach = body.vertices - centre
    carriers = [body.bones.index(bone) for bone in ("pelvis", f"femur_{side[0]}") if bone in body.bones]
    on_hip = np.isin(body.bone_weights.argmax(axis=1), carriers)
    beside = (np.abs(reach[:, 1]) < slab_m) & (np.abs(reach[:, 0]) < 2 * slab_m) & (outward * reach[:, 2] > 0)
    beside &= on_hip
    if not beside.any():
        raise InputError(
            "the body has no skin beside its hip joint centre",
            where=f"body model {body.model}",
            hint="choose another hip model, or run the body stage again",
        )
    return float(np.median(outward * reach[beside, 2]))


def _knee_directions(
    points: Points, labels: MarkerLabels, side: Side
) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Forward and medial on the floor's plane, from the knee's flexion axis."""
    inward = points[labels.knee_medial] - points[labels.knee_lateral]
    inward = inward - (inward @ _UPWARDS) * _UPWARDS
    inward = inward / np.linalg.norm(inward)
    right = -inward if side == "right" else inward
    return np.cross(_UPWARDS, right), inward


def _regression(points: Points, labels: MarkerLabels, model: str, side: Side) -> Float[Array, " 3"]:
    left, right = (
        _point(points, label, f"markers.{key}", model)
        for key, label in (("left_asis", labels.left_asis), ("right_asis", labels.right_asis))
    )
    middle, across = (left + right) / 2, right - left
    width = float(np.linalg.norm(across))
    across = across / width
    outward = across if side == "right" else -across
    if model == "bell":
        forward = np.cross(_UPWARDS, across)
        forward = forward / np.linalg.norm(forward)
        anterior, up, lateral = np.array(BELL) * width
    else:
        back = (
            _point(points, labels.left_psis, "markers.left_psis", model)
            + _point(points, labels.right_psis, "markers.right_psis", model)
        ) / 2
        forward = middle - back
        forward = forward - (forward @ across) * across
        depth = float(np.linalg.norm(middle - back))
        forward = forward / np.linalg.norm(forward)
        anterior, up, lateral = harrington(width, depth)
    return middle + anterior * forward + up * np.cross(across, forward) + lateral * outward


def harrington(width_m: float, depth_m: float) -> tuple[float, float, float]:
    """Anterior, up and lateral of the hip from the middle of the ASIS [m].

    Regressions on the width and depth of the pelvis of Harrington et al. (2007, J Biomech 40:595).

    Args:
        width_m: Distance between the ASIS [m].
        depth_m: Distance between the middles of ASIS and PSIS [m].
    """
    return -0.24 * depth_m - 0.0099, -0.30 * width_m - 0.0109, 0.33 * width_m + 0.0073


def _point(points: Points, label: str | None, key: str, model: str) -> Float[Array, " 3"]:
    name = _given(label, key, model)
    if name not in points:
        raise InputError(
            f"hip model '{model}' needs marker '{name}', which the standing trial lacks",
            where=key,
            hint="correct the label, or choose another protocol.hip.model",
        )
    return points[name]


def _given(value: Value | None, key: str, model: str) -> Value:
    if value is None:
        raise ConfigError(
            f"hip model '{model}' needs '{key}'",
            where="study file",
            hint=f"add protocol.{key}, or choose another protocol.hip.model",
        )
    return value
