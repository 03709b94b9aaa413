"""Hold our angles against those that Vicon's Plug-in Gait stored in a C3D file.

Twice, where the file allows it: from the segment axes that it stores, which checks the angle core, and from
raw markers and measurements, which checks the whole way to the angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from evaluation.conventional_gait import knee_angles_from_markers
from evaluation.conventions import Side
from evaluation.plug_in_gait import plug_in_gait_angles, segment_axes
from hilbrace.errors import InputError
from hilbrace.motion.c3d import C3DRecording

Array = np.ndarray

TOLERANCE_DEG = 1e-3
"""Largest difference at which angles count as reproduced."""

WHOLE_NUMBERS_DEG = 0.1
"""Largest root mean square difference that counts as reproduced where a file stores whole numbers. In two
recorded trials rounded to steps of 0.01 to 0.1 mm and deg it was 0.3 to 0.45 of the step, in degrees; a whole
step is granted, up to this limit."""

SIDES: tuple[Side, Side] = ("left", "right")

_SEGMENTS = {"Knee": ("FE", "TI"), "Ankle": ("TI", "FO")}


@dataclass(frozen=True)
class JointCheck:
    """Stored angles of one joint beside ours.

    Attributes:
        name: Name of the angles in the file, e.g. ``LKneeAngles``.
        source: What ours come from: the stored segment ``axes``, or raw ``markers``.
        frames: Frames compared.
        rms_deg: Root mean square of the difference, plane by plane [deg].
        largest_deg: Largest difference, plane by plane [deg].
        stored_deg: Angles as stored [deg]; NaN in gaps.
        computed_deg: Ours [deg].
        step: Step of the file's numbers where they are whole ones; 0 for floats.
    """

    name: str
    source: Literal["axes", "markers"]
    frames: int
    rms_deg: Float[Array, " 3"]
    largest_deg: Float[Array, " 3"]
    stored_deg: Float[Array, "frame 3"]
    computed_deg: Float[Array, "frame 3"]
    step: float

    @property
    def agrees(self) -> bool:
        """Whether every angle of every frame is reproduced, as far as the file's numbers can tell."""
        if self.step:
            return bool((self.rms_deg <= _granted_deg(self.step)).all())
        return bool((self.largest_deg <= TOLERANCE_DEG).all())


def verify_plug_in_gait(recording: C3DRecording, where: str) -> tuple[list[JointCheck], tuple[str, ...]]:
    """Compare every knee and ankle whose angles the file stores.

    Args:
        recording: A C3D file with Plug-in Gait outputs.
        where: The file, for messages.

    Returns:
        The comparisons, and sentences about those that the file does not allow.

    Raises:
        InputError: The file stores no angles that could be compared.
    """
    checks = [
        _compare(recording, f"{side[0].upper()}{joint}Angles", "axes", _from_axes(recording, joint, side))
        for joint in _SEGMENTS
        for side in SIDES
        if _is_stored(recording, joint, side)
    ]
    notes = []
    if recording.step:
        notes.append(
            f"The file stores whole numbers, in steps of {recording.step:.3g} of its units: "
            f"a root mean square of {_granted_deg(recording.step):.3g} deg counts as reproduced."
        )
    without_axes = [
        name
        for joint in _SEGMENTS
        for side in SIDES
        if (name := f"{side[0].upper()}{joint}Angles") in recording.outputs
        and not _is_stored(recording, joint, side)
    ]
    if without_axes:
        notes.append(f"The segment axes behind {', '.join(without_axes)} are not stored.")
    for side in SIDES:
        name = f"{side[0].upper()}KneeAngles"
        if name not in recording.outputs:
            continue
        try:
            angles = knee_angles_from_markers(recording.markers, recording.measurements, side, where)
        except InputError as fault:
            notes.append(f"{name} from raw markers: {fault.what}.")
        else:
            checks.append(_compare(recording, name, "markers", angles))
    notes += [
        f"{check.name} from {check.source}: no frame holds both." for check in checks if not check.frames
    ]
    checks = [check for check in checks if check.frames]
    if not checks:
        reasons = "; ".join(note.rstrip(".") for note in notes)
        raise InputError(
            "no Plug-in Gait angles with their segment axes or raw markers"
            + (f" ({reasons})" if reasons else ""),
            where=where,
            hint="run Plug-in Gait with its segment axes written (LFEO, LFEA, LFEL, LFEP, ...)",
        )
    return checks, tuple(notes)


def _granted_deg(step: float) -> float:
    """Root mean square difference that whole numbers of this step explain [deg]."""
    return max(TOLERANCE_DEG, min(WHOLE_NUMBERS_DEG, step))


def _is_stored(recording: C3DRecording, joint: str, side: Side) -> bool:
    letter = side[0].upper()
    points = {letter + segment + point for segment in _SEGMENTS[joint] for point in "OALP"}
    return f"{letter}{joint}Angles" in recording.outputs and points <= set(recording.markers.names)


def _from_axes(recording: C3DRecording, joint: str, side: Side) -> Float[Array, "frame 3"]:
    letter = side[0].upper()
    proximal, distal = (segment_axes(recording.markers, letter + segment) for segment in _SEGMENTS[joint])
    return plug_in_gait_angles(proximal, distal, joint, side)


def _compare(
    recording: C3DRecording, name: str, source: Literal["axes", "markers"], computed: Float[Array, "frame 3"]
) -> JointCheck:
    stored = recording.outputs[name]
    known = np.isfinite(stored).all(axis=1) & np.isfinite(computed).all(axis=1)
    difference = (computed - stored)[known]
    difference = (difference + 180.0) % 360.0 - 180.0
    if not len(difference):
        difference = np.full((1, 3), np.nan)
    return JointCheck(
        name,
        source,
        int(known.sum()),
        np.sqrt((difference**2).mean(axis=0)),
        np.abs(difference).max(axis=0),
        stored,
        computed,
        recording.step,
    )
