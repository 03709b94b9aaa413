"""Check the angle core against angles that Vicon's Plug-in Gait stored in a C3D file.

Plug-in Gait stores each segment's frame as four points: origin O, and one point along the anterior (A),
leftward (L) and proximal (P) axis. From these the angles of knee and ankle must come out as stored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.conventions import Side, anatomical_degrees, in_convention
from evaluation.joint_angles import cardan_angles, relative_rotation
from hilbrace.errors import InputError
from hilbrace.motion.c3d import C3DRecording
from hilbrace.motion.opensim_files import MarkerTable

Array = np.ndarray

TOLERANCE_DEG = 1e-3
"""Largest difference at which angles count as reproduced."""

_SEGMENTS = {"Knee": ("FE", "TI"), "Ankle": ("TI", "FO")}
_RIGHT_ANGLE_DEG = 90.0


@dataclass(frozen=True)
class JointCheck:
    """Stored angles of one joint beside those computed from the stored segment axes.

    Attributes:
        name: Name of the angles in the file, e.g. ``LKneeAngles``.
        frames: Frames compared.
        rms_deg: Root mean square of the difference, plane by plane [deg].
        largest_deg: Largest difference, plane by plane [deg].
        stored_deg: Angles as stored [deg]; NaN in gaps.
        computed_deg: Angles from the axes [deg].
    """

    name: str
    frames: int
    rms_deg: Float[Array, " 3"]
    largest_deg: Float[Array, " 3"]
    stored_deg: Float[Array, "frame 3"]
    computed_deg: Float[Array, "frame 3"]

    @property
    def agrees(self) -> bool:
        """Whether every angle of every frame is reproduced."""
        return bool((self.largest_deg <= TOLERANCE_DEG).all())


def verify_plug_in_gait(recording: C3DRecording, where: str) -> list[JointCheck]:
    """Compare every knee and ankle whose angles and segment axes the file stores.

    Args:
        recording: A C3D file with Plug-in Gait outputs.
        where: The file, for messages.

    Raises:
        InputError: The file stores no angles with their segment axes.
    """
    checks = [
        _check(recording, joint, side)
        for joint in _SEGMENTS
        for side in ("left", "right")
        if _is_stored(recording, joint, side)
    ]
    if not checks:
        raise InputError(
            "no Plug-in Gait angles with their segment axes",
            where=where,
            hint="run the Plug-in Gait model with its segment axes written (LFEO, LFEA, LFEL, LFEP, ...)",
        )
    return checks


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


def _is_stored(recording: C3DRecording, joint: str, side: Side) -> bool:
    letter = side[0].upper()
    points = {letter + segment + point for segment in _SEGMENTS[joint] for point in "OALP"}
    return f"{letter}{joint}Angles" in recording.outputs and points <= set(recording.markers.names)


def _check(recording: C3DRecording, joint: str, side: Side) -> JointCheck:
    letter = side[0].upper()
    proximal, distal = (segment_axes(recording.markers, letter + segment) for segment in _SEGMENTS[joint])
    stored = recording.outputs[f"{letter}{joint}Angles"]
    computed = plug_in_gait_angles(proximal, distal, joint, side)
    known = np.isfinite(stored).all(axis=1) & np.isfinite(computed).all(axis=1)
    difference = (computed - stored)[known]
    difference = (difference + 180.0) % 360.0 - 180.0
    if not len(difference):
        difference = np.full((1, 3), np.nan)
    return JointCheck(
        f"{letter}{joint}Angles",
        int(known.sum()),
        np.sqrt((difference**2).mean(axis=0)),
        np.abs(difference).max(axis=0),
        stored,
        computed,
    )
