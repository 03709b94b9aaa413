"""Plug-in Gait's stored segments and the angles it makes of two of them.

Plug-in Gait stores each segment's frame as four points: origin O, and one point along the anterior (A),
leftward (L) and proximal (P) axis.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from evaluation.conventions import Side, anatomical_degrees, in_convention
from evaluation.joint_angles import cardan_angles, relative_rotation
from hilbrace.motion.opensim_files import MarkerTable

Array = np.ndarray

_RIGHT_ANGLE_DEG = 90.0


def segment_axes(markers: MarkerTable, segment: str) -> Float[Array, "frame 3 3"]:
    """Segment frames (columns anterior, up, right) of the four points of a stored segment.

    Args:
        markers: The file's markers.
        segment: Side and segment, e.g. ``LFE``.
    """
    origin, anterior, left, proximal = (
        markers.positions[:, markers.names.index(segment + point)] for point in "OALP"
    )
    axes = np.stack([anterior - origin, proximal - origin, origin - left], axis=-1)
    return axes / np.linalg.norm(axes, axis=-2, keepdims=True)


def plug_in_gait_angles(
    proximal: Float[Array, "frame 3 3"], distal: Float[Array, "frame 3 3"], joint: str, side: Side
) -> Float[Array, "frame 3"]:
    """Angles as Plug-in Gait reports them [deg].

    Knee: flexion, varus, internal rotation. Ankle: dorsiflexion, rotation about the foot's long axis, and
    about the floating axis; the foot's long axis points to the heel, hence the right angle at neutral.

    Args:
        proximal: Frame of the proximal segment.
        distal: Frame of the distal segment.
        joint: ``Knee`` or ``Ankle``.
        side: Which leg.
    """
    angles = anatomical_degrees(cardan_angles(relative_rotation(proximal, distal)), side)
    if joint == "Knee":
        return in_convention(angles, side, "plug_in_gait")
    return np.column_stack([angles[:, 0] - _RIGHT_ANGLE_DEG, angles[:, 2], angles[:, 1]])
