"""From recorded files to a `Trial`: read, check, filter, cut, and say what was noticed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.config import MotionSettings, SubjectSettings
from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.contact_breaks import check_unbroken
from hilbrace.motion.foot_contacts import assign_contacts, feet_by_name
from hilbrace.motion.force_plates import (
    FEET,
    FootForces,
    PlateForces,
    check_columns,
    foot_forces,
    total_vertical,
    unload,
)
from hilbrace.motion.groundlink import check_clock, read_groundlink
from hilbrace.motion.label_checks import check_labels
from hilbrace.motion.marker_maps import (
    MarkerMap,
    foot_markers,
    match_markers,
    read_marker_map,
    segment_of,
    some_names,
)
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.motion.recording import Recording, check_markers, keep_markers, read_recording
from hilbrace.motion.static_pose import StaticPose, no_pose, pose_at_start, static_pose
from hilbrace.motion.subject import check_weight, subject_height, subject_mass
from hilbrace.motion.trial import Trial

Array = np.ndarray

LEAST_FRAMES = 10
"""Fewest frames of a trial."""

SURVEYED_FRAMES = 200
"""Most frames in which a subject without a standing trial is measured."""


def read_trial(motion: MotionSettings, subject: SubjectSettings) -> Trial:
    """Read a recorded motion: a C3D file, or a TRC file with the ground reactions in another file.

    Markers stay as they were recorded, gaps NaN: the same cut-off is applied later to the coordinates that
    are fitted to them. Forces are filtered over the whole recording before it is cut to the window.

    Args:
        motion: Which files, and how to read them.
        subject: Mass and height, where known.

    Raises:
        ConfigError: No recording, or an unknown marker map or plate, is named.
        InputError: A file or its content cannot be used; the message says where and what mends it.
    """
    if motion.markers is None:
        raise ConfigError(
            "no recording is named",
            where="motion.markers",
            hint="name a .c3d or .trc file, or a built-in motion with motion.synthetic",
        )
    marker_map = read_marker_map(motion.marker_map)
    with C3DReader() as reader:
        tensors = motion.forces is not None and motion.forces.suffix.lower() == ".pth"
        files = None if tensors else motion.forces
        recording = read_recording(motion.markers, files, motion.vertical_axis, reader)
        if tensors:
            recording = _with_groundlink(recording, motion, subject)
        standing = _read_static(motion, reader)
    where = str(motion.markers)
    known, recording, standing, notes = _measured(marker_map, recording, standing, motion)
    check_markers(recording.markers, known, where)
    check_labels(recording.markers, known, where)
    if recording.plates is None:
        raise InputError(
            "there are no ground reactions",
            where=where,
            hint="name their .mot or .sto file as motion.forces, or record with force plates",
        )
    check_columns(recording.plates, motion.force_threshold_n)
    table, cut_notes = _cut(recording.markers, recording.plates, motion, where)
    pose = _pose(recording, standing, known, motion)
    plates = unload(recording.plates, motion.force_threshold_n)
    mass = subject_mass(subject.mass_kg, pose.vertical_n, str(motion.static or motion.markers))
    mass_note = () if subject.mass_kg else (f"The mass, {mass:.1f} kg, was weighed while standing.",)
    check_weight(total_vertical(plates), mass, plates.source)
    forces, foot_notes = _feet(table, plates, known, motion)
    return Trial(
        name=motion.markers.stem,
        origin="recorded",
        time=table.time,
        rate_hz=table.rate_hz,
        marker_names=table.names,
        markers=table.positions,
        static_marker_names=pose.names,
        static_markers=pose.positions,
        feet=FEET,
        ground_force=forces.force,
        centre_of_pressure=forces.centre_of_pressure,
        free_torque=forces.free_torque,
        mass_kg=round(mass, 3),
        height_m=subject_height(subject.height_m, known, pose.names, pose.positions),
        marker_map=motion.marker_map,
        notes=(*recording.notes, *notes, *pose.notes, *cut_notes, *foot_notes, *mass_note),
        surveyed_markers=np.zeros((0, 0, 3)) if pose.names else _survey(recording.markers),
    )


def _with_groundlink(recording: Recording, motion: MotionSettings, subject: SubjectSettings) -> Recording:
    """The recording with the ground reactions of a GroundLink file, on the markers' clock."""
    table = recording.markers
    plates = read_groundlink(Path(str(motion.forces)), motion.forces_rate_hz, subject.mass_kg)
    check_clock(plates, table.time, table.rate_hz)
    return replace(recording, plates=replace(plates, time=plates.time + table.time[0]))


def _read_static(motion: MotionSettings, reader: C3DReader) -> Recording | None:
    if motion.static is None:
        return None
    return read_recording(motion.static, motion.static_forces, motion.vertical_axis, reader)


def _measured(
    marker_map: MarkerMap, recording: Recording, standing: Recording | None, motion: MotionSettings
) -> tuple[MarkerMap, Recording, Recording | None, list[str]]:
    """The map and the recordings, reduced to the markers that both know."""
    names = recording.markers.names
    where = str(motion.markers)
    if standing is not None:
        names += standing.markers.names
        where += f" and {motion.static}"
    known = match_markers(marker_map, names, where)
    left_out = sorted(set(names) - set(known.known()))
    notes = [f"Not used, as marker map '{marker_map.name}' says: {some_names(left_out)}."] if left_out else []
    hidden = [
        name
        for k, name in enumerate(recording.markers.names)
        if name in known.known() and np.isnan(recording.markers.positions[:, k]).all()
    ]
    notes += [f"{name} is never visible in the motion: left out." for name in hidden]
    notes += standing.notes if standing else ()
    kept = tuple(name for name in known.known() if name not in hidden)
    recording = replace(recording, markers=keep_markers(recording.markers, kept))
    if standing is not None:
        standing = replace(standing, markers=keep_markers(standing.markers, known.known()))
    if not recording.markers.names:
        raise InputError(
            "no usable marker is ever visible", where=where, hint="export the trajectories again"
        )
    return known, recording, standing, notes


def _pose(
    recording: Recording, standing: Recording | None, known: MarkerMap, motion: MotionSettings
) -> StaticPose:
    threshold, held = motion.force_threshold_n, _held(known)
    if standing is None:
        try:
            return pose_at_start(recording, held, threshold, str(motion.markers))
        except InputError as moving:
            return no_pose(moving.what)
    check_markers(standing.markers, known, str(motion.static))
    check_labels(standing.markers, known, str(motion.static))
    if standing.plates is not None:
        check_columns(standing.plates, threshold)
    pose = static_pose(standing, held, threshold, str(motion.static))
    if pose.vertical_n is not None:
        return pose
    return replace(pose, vertical_n=_weight_at_start(recording, held, motion))


def _weight_at_start(recording: Recording, held: tuple[str, ...], motion: MotionSettings) -> float | None:
    """Force while standing at the start of the motion, where the standing trial has none."""
    try:
        return pose_at_start(recording, held, motion.force_threshold_n, str(motion.markers)).vertical_n
    except InputError:
        return None


def _held(known: MarkerMap) -> tuple[str, ...]:
    """Markers that hold still when a person stands: those of the trunk and the legs."""
    arms = ("humerus", "ulna", "radius", "hand")
    return tuple(name for name, segment in segment_of(known).items() if not segment.startswith(arms))


def _cut(
    table: MarkerTable, plates: PlateForces, motion: MotionSettings, where: str
) -> tuple[MarkerTable, list[str]]:
    """The frames of the window for which there are forces."""
    start, end = motion.window or (table.time[0], table.time[-1])
    slack = 0.5 / table.rate_hz
    inside = (table.time >= start - slack) & (table.time <= end + slack)
    if not end > start or inside.sum() < LEAST_FRAMES:
        raise InputError(
            f"the window {start:g} to {end:g} s holds {inside.sum()} frames",
            where=where,
            hint=f"the recording runs from {table.time[0]:g} to {table.time[-1]:g} s; "
            f"take {LEAST_FRAMES} frames or more",
        )
    covered = (table.time >= plates.time[0] - slack) & (table.time <= plates.time[-1] + slack)
    kept, notes = inside & covered, []
    if kept.sum() < LEAST_FRAMES:
        raise InputError(
            f"forces run from {plates.time[0]:g} to {plates.time[-1]:g} s, "
            f"markers from {table.time[0]:g} to {table.time[-1]:g} s",
            where=f"{where} and {plates.source}",
            hint="export both from one recording, on one clock",
        )
    if (inside & ~covered).any():
        notes.append(f"{(inside & ~covered).sum()} frames without ground reactions were cut off.")
    positions = table.positions[kept]
    gaps = np.isnan(positions).any(axis=2).sum(axis=0).tolist()
    notes += [
        f"{name} is hidden in {gap} of {len(positions)} frames."
        for name, gap in zip(table.names, gaps, strict=True)
        if gap
    ]
    return replace(table, time=table.time[kept], positions=positions), notes


def _survey(table: MarkerTable) -> Float[Array, "instant marker 3"]:
    """Markers at instants spread evenly over the whole recording."""
    count = min(len(table.time), SURVEYED_FRAMES)
    return table.positions[np.linspace(0, len(table.time) - 1, count).round().astype(int)]


def _feet(
    table: MarkerTable, plates: PlateForces, known: MarkerMap, motion: MotionSettings
) -> tuple[FootForces, tuple[str, ...]]:
    feet = {foot: keep_markers(table, foot_markers(known, foot)).positions for foot in FEET}
    owner, notes = assign_contacts(plates, table.time, feet, dict(motion.plates), feet_by_name(plates))
    check_unbroken(plates, owner, table.time, feet)
    forces = foot_forces(plates, owner, table.time, motion.cutoff_hz, motion.force_threshold_n)
    return forces, notes


def recorded_files(motion: MotionSettings) -> tuple[Path, ...]:
    """The files that `read_trial` will read, for the key of the stage."""
    files = (motion.markers, motion.forces, motion.static, motion.static_forces)
    return tuple(path for path in files if path is not None)
