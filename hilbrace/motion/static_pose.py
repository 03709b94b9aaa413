"""The subject standing still: one position per marker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from hilbrace.errors import InputError
from hilbrace.motion.force_plates import total_vertical, unload
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.motion.recording import Recording
from hilbrace.motion.subject import standing_force

Array = np.ndarray

STILL_M = 0.05
"""Largest movement of a marker (5th to 95th percentile of each coordinate) in a standing trial."""

STILL_AT_START_M = 0.02
"""The same for the start of a motion that stands in for a standing trial."""

START_SECONDS = 0.3
LEAST_FRAMES = 10


@dataclass(frozen=True)
class StaticPose:
    """A standing subject.

    Attributes:
        names: Marker names.
        positions: Median positions [m].
        vertical_n: Mean vertical force on the plates while standing [N]; ``None`` if not known.
        notes: What the reader noticed, one sentence each.
    """

    names: tuple[str, ...]
    positions: Float[Array, "marker 3"]
    vertical_n: float | None
    notes: tuple[str, ...]


def static_pose(recording: Recording, held: tuple[str, ...], threshold_n: float, where: str) -> StaticPose:
    """Median over the frames of a standing trial that show all markers.

    Markers that the whole trial hides are left out, with a note.

    Args:
        recording: The standing trial.
        held: Markers that have to hold still (the arms may sway).
        threshold_n: Vertical force below which a plate is unloaded [N].
        where: The file, for messages.

    Raises:
        InputError: Fewer than ten frames show all markers, or the subject moves.
    """
    table = recording.markers
    never = np.asarray(np.isnan(table.positions).all(axis=(0, 2)))
    names = tuple(name for name, hidden in zip(table.names, never, strict=True) if not hidden)
    positions = table.positions[:, ~never]
    complete = np.asarray(np.isfinite(positions).all(axis=(1, 2)))
    if complete.sum() < LEAST_FRAMES:
        gaps = np.isnan(positions).any(axis=2).mean(axis=0)
        worst = int(gaps.argmax()) if len(gaps) else 0
        raise InputError(
            f"only {complete.sum()} frames of the standing trial show all {len(names)} markers"
            + (f"; '{names[worst]}' is hidden in {100 * gaps[worst]:.0f} %" if names else ""),
            where=where,
            hint="label or fill the standing trial, or delete the marker from it",
        )
    hint = "stand still, or export the quiet part alone"
    _refuse_motion(positions[complete], names, held, STILL_M, where, hint)
    notes = [f"Standing trial: {name} is never visible." for name in np.array(table.names)[never]]
    pose = np.median(positions[complete], axis=0)
    return StaticPose(names, pose, _standing(recording, complete, threshold_n), tuple(notes))


def no_pose(reason: str) -> StaticPose:
    """What stands for a standing trial where nobody stands still.

    Args:
        reason: Why, for the note.
    """
    note = f"No standing trial, and {reason}: the subject is measured, and markers are placed, in the motion."
    return StaticPose((), np.zeros((0, 3)), None, (note,))


def pose_at_start(recording: Recording, held: tuple[str, ...], threshold_n: float, where: str) -> StaticPose:
    """The first 0.3 s of a motion as a standing trial, if the subject stands still there.

    Args:
        recording: The motion.
        held: Markers that have to hold still (the arms may sway).
        threshold_n: Vertical force below which a plate is unloaded [N].
        where: The file, for messages.

    Raises:
        InputError: The subject moves, or a marker is hidden.
    """
    table = recording.markers
    start: Bool[Array, " frame"] = table.time <= table.time[0] + START_SECONDS
    positions = table.positions[start]
    hint = "give a standing trial as motion.static"
    hidden = [name for k, name in enumerate(table.names) if np.isnan(positions[:, k]).any(axis=1).all()]
    if hidden or start.sum() < 2:
        raise InputError(
            f"there is no standing trial, and the first {START_SECONDS} s hide {', '.join(hidden[:5])}",
            where=where,
            hint=hint,
        )
    _refuse_motion(positions, table.names, held, STILL_AT_START_M, f"{where}, first {START_SECONDS} s", hint)
    note = f"No standing trial: the first {START_SECONDS} s of the motion stand in for it."
    pose = np.nanmedian(positions, axis=0)
    return StaticPose(table.names, pose, _standing(recording, start, threshold_n), (note,))


def _refuse_motion(
    positions: Float[Array, "frame marker 3"],
    names: tuple[str, ...],
    held: tuple[str, ...],
    limit_m: float,
    where: str,
    hint: str,
) -> None:
    low, high = np.nanpercentile(positions, [5, 95], axis=0)
    moved = np.where(np.isin(names, held), (high - low).max(axis=1), 0.0)
    worst = int(moved.argmax())
    if moved[worst] > limit_m:
        raise InputError(
            f"the subject does not stand still: '{names[worst]}' moves {100 * moved[worst]:.0f} cm",
            where=where,
            hint=hint,
        )


def _standing(recording: Recording, frames: Bool[Array, " frame"], threshold_n: float) -> float | None:
    if recording.plates is None:
        return None
    plates = unload(recording.plates, threshold_n)
    table: MarkerTable = recording.markers
    times = table.time[frames]
    during = (plates.time >= times[0]) & (plates.time <= times[-1])
    return standing_force(total_vertical(plates)[during])
