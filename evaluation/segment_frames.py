"""Anatomical frames of thigh, shank and foot from their landmarks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from evaluation.conventions import Side
from hilbrace.errors import GeometryError

Array = np.ndarray

SMALLEST_SINE = 0.2
"""Sine of the smallest angle between a segment's long axis and its flexion axis."""


def long_bone_frame(
    proximal: Float[Array, " 3"],
    distal: Float[Array, " 3"],
    lateral: Float[Array, " 3"],
    medial: Float[Array, " 3"],
    side: Side,
    segment: str,
) -> Float[Array, "3 3"]:
    """Frame of a thigh or shank, as Visual3D builds it.

    The long axis leads from the distal to the proximal joint centre; the flexion axis is the part of the
    line between the epicondyles (or malleoli) that is normal to it.

    Args:
        proximal: Proximal joint centre.
        distal: Distal joint centre.
        lateral: Lateral epicondyle or malleolus.
        medial: Medial epicondyle or malleolus.
        side: Which leg.
        segment: Name, for messages.

    Returns:
        Columns anterior, up, right.

    Raises:
        GeometryError: The points lie on one line.
    """
    right = lateral - medial if side == "right" else medial - lateral
    return frame_from_axes(proximal - distal, right, segment)


def foot_frame(
    heel: Float[Array, " 3"], toe: Float[Array, " 3"], vertical: Float[Array, " 3"]
) -> Float[Array, "3 3"]:
    """Frame of a foot that stands flat: upward as the laboratory, forward from heel to toe on the floor.

    Raises:
        GeometryError: Heel and toe lie above each other.
    """
    right = np.cross(toe - heel, vertical)
    return frame_from_axes(vertical, right, "foot")


def frame_from_axes(up: Float[Array, " 3"], right: Float[Array, " 3"], segment: str) -> Float[Array, "3 3"]:
    """Frame with the given long axis and, as nearly as it can, the given rightward axis.

    Raises:
        GeometryError: An axis has no length, or both have nearly one direction.
    """
    forward = np.cross(up, right)
    length = float(np.linalg.norm(up) * np.linalg.norm(right))
    if not float(np.linalg.norm(forward)) > SMALLEST_SINE * length:
        raise GeometryError(
            f"the landmarks of the {segment} lie on one line",
            where="static calibration",
            hint="check the labels of hip, knee and ankle: one of them is at the wrong place",
        )
    forward = forward / np.linalg.norm(forward)
    long_axis = up / np.linalg.norm(up)
    return np.column_stack([forward, long_axis, np.cross(forward, long_axis)])
