"""A recording of a laboratory's devices as markers and plate loads on one clock, and as a C3D file.

Frames and samples take their places by the devices' own counters, so that what is missing is a gap and not a
jump. Plates with clocks of their own are laid over the markers by triggers, heel stomps or arrivals
(`evaluation.record.plate_time`); the same device's markers and plates need nothing of the kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from evaluation.c3d_writer import write_c3d
from evaluation.record.plate_time import PlateTime, plate_time
from evaluation.record.reading import Recorded
from evaluation.sources.stream import MarkerFrame, PlateInfo, PlateSamples, SourceInfo, ground_load, y_up
from hilbrace.errors import InputError
from hilbrace.motion.force_plates import PlateForces
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.motion.recording import Recording

Array = np.ndarray

BRIDGED_S = 0.01
"""Longest gap of a plate that a straight line may bridge, as C3D files hold no gaps of forces [s]."""

TRIMMED_S = 0.1
"""Longest stretch at either end that is left out because a plate began later or ended earlier [s]."""

UNLOADED_N = 20.0
"""Vertical force below which a plate has no point of application [N]."""

_SLACK = 1e-6


def convert(recorded: Recorded, path: Path) -> tuple[Path, tuple[str, ...]]:
    """Write a recording as a C3D file.

    Args:
        recorded: The recording.
        path: Name of the file; an existing one is never touched, the next free name serves instead.

    Returns:
        The name it got, and what the reader should know, one sentence each.

    Raises:
        InputError: The recording has no markers, or does not fit a C3D file.
    """
    recording = to_recording(recorded)
    chosen, number = path, 2
    while chosen.exists():
        chosen, number = path.with_stem(f"{path.stem}_{number}"), number + 1
    write_c3d(chosen, recording)
    return chosen, recording.notes


def to_recording(recorded: Recorded) -> Recording:
    """Markers and plate loads of a recording, y up, from its first marker frame on.

    Args:
        recorded: The recording.

    Raises:
        InputError: There are no markers, or their set changes on the way.
    """
    where = str(recorded.path)
    source = _marker_source(recorded, where)
    frames = [i for i in recorded.items if isinstance(i, MarkerFrame) and i.source == source.source]
    table, start_s, notes = _table(frames, source, where)
    described = _plates(recorded)
    per_frame = max([1, *(round(plate.rate_hz / table.rate_hz) for _, _, plate in described)])
    plates, window = [], (0, len(table.time))
    for name, info, plate in described:
        samples = [
            i for i in recorded.items
            if isinstance(i, PlateSamples) and i.source == info.source and i.plate == plate.name
        ]  # fmt: skip
        zero = None if plate.zeroed else _zero(recorded, info, plate)
        readings = _readings(samples, info, plate, zero)
        if isinstance(readings, str):
            notes.append(f"Plate '{name}' is left out: {readings}.")
            continue
        clock = PlateTime(_same, "")
        if info.source != source.source:
            try:
                clock = plate_time(recorded, frames, samples, table, (readings.time, readings.load[:, 1]))
            except InputError as fault:
                notes.append(f"Plate '{name}' is left out: {fault.what} ({fault.where}); {fault.hint}.")
                continue
            notes.append(f"Plate '{name}' {clock.remark}.")
        time = clock.to_markers(readings.time) - start_s
        found = _on_frames(replace(readings, time=time), plate, (table, per_frame))
        if isinstance(found, str):
            notes.append(f"Plate '{name}' is left out: {found}.")
            continue
        load, first, last, remark = found
        window = (max(window[0], first), min(window[1], last))
        notes += [f"Plate '{name}' {remark}."] if remark else []
        plates.append((name, load))
    return _cut(table, plates, per_frame, window, tuple(notes), where)


def _marker_source(recorded: Recorded, where: str) -> SourceInfo:
    counts = {
        info.source: sum(isinstance(i, MarkerFrame) and i.source == info.source for i in recorded.items)
        for info in recorded.infos
    }
    best = max(counts, key=lambda source: counts[source], default="")
    if not counts.get(best):
        raise InputError("the recording has no markers", where=where, hint="record a marker system too")
    sets = [info for info in recorded.infos if info.source == best and info.labels]
    if not sets or any(info.labels != sets[0].labels for info in sets):
        raise InputError(
            f"the set of markers of '{best}' changes on the way",
            where=where,
            hint="record again without changing the markers in the recording software",
        )
    return sets[0]


def _table(
    frames: Sequence[MarkerFrame], info: SourceInfo, where: str
) -> tuple[MarkerTable, float, list[str]]:
    """Markers by the device's counter, the first frame's instant by its clock [s], and what is missing."""
    if not info.rate_hz > 0:
        raise InputError(
            f"'{info.source}' does not say its frame rate", where=where, hint="record with another source"
        )
    numbers = np.array([frame.number for frame in frames])
    order = np.maximum.accumulate(numbers)
    usable = np.concatenate([[True], numbers[1:] > order[:-1]])
    count = int(numbers[usable].max() - numbers[0]) + 1
    if count > 100 * len(frames) + 1000:
        raise InputError(
            f"the counter of '{info.source}' jumps by {count} frames",
            where=where,
            hint="the device was restarted: recover the recording and use the part before",
        )
    positions = np.full((count, len(info.labels), 3), np.nan)
    for frame, use in zip(frames, usable, strict=True):
        if use and len(frame.positions) == len(info.labels):
            positions[frame.number - numbers[0]] = y_up(frame.positions, info.up)
    names = tuple(label.rsplit(":", 1)[-1] for label in info.labels)
    notes = []
    if count > usable.sum():
        notes.append(f"{count - int(usable.sum())} of {count} frames are missing and stay gaps.")
    if not usable.all():
        notes.append(f"{int((~usable).sum())} frames came with an earlier number and are left out.")
    return MarkerTable(names, np.arange(count) / info.rate_hz, info.rate_hz, positions), (
        frames[0].device_time_s
    ), notes  # fmt: skip


def _plates(recorded: Recorded) -> list[tuple[str, SourceInfo, PlateInfo]]:
    """Name, source and description of every plate that sent samples, in the order of the sources."""
    seen = {(i.source, i.plate) for i in recorded.items if isinstance(i, PlateSamples)}
    found = {}
    for info in recorded.infos:
        for plate in info.plates:
            if (info.source, plate.name) in seen:
                found.setdefault((info.source, plate.name), (f"{info.source} {plate.name}", info, plate))
    return list(found.values())


def _same(at: Float[Array, " any"]) -> Float[Array, " any"]:
    return at


def _zero(recorded: Recorded, info: SourceInfo, plate: PlateInfo) -> Float[Array, " channel"] | None:
    """The channels of the empty plate, where the operator had it measured."""
    for mark in reversed(recorded.marks):
        if mark.kind == "zero" and mark.content.get("source") == info.source and (
            mark.content.get("plate") == plate.name
        ):  # fmt: skip
            return np.array(mark.content["channels"], float)
    return None


@dataclass(frozen=True)
class _Readings:
    """What a plate sent, y up: instants [s], loads, height of the surface [m], whether it ever was zeroed."""

    time: Float[Array, " sample"]
    load: Float[Array, "sample 6"]
    height_m: float
    zeroed: bool


def _readings(
    samples: Sequence[PlateSamples],
    info: SourceInfo,
    plate: PlateInfo,
    zero: Float[Array, " channel"] | None,
) -> _Readings | str:
    """Loads of a plate by its own clock, or why there are none."""
    values = np.concatenate([block.values for block in samples])
    if values.shape[1] != plate.calibration.shape[1]:
        return f"it sent {values.shape[1]} channels, {plate.calibration.shape[1]} were announced"
    time = np.concatenate(
        [block.device_time_s + block.period_s * np.arange(len(block.values)) for block in samples]
    )
    keep = np.concatenate([[True], np.diff(time) > 0]) & np.isfinite(time) & np.isfinite(values).all(axis=1)
    if keep.sum() < 2:
        return "it has no samples"
    load = ground_load(plate, values[keep], zero)
    turned = np.hstack([y_up(load[:, :3], info.up), y_up(load[:, 3:], info.up)])
    height = float(np.nanmean(plate.corners, axis=0)[1 if info.up == "y" else 2]) if np.isfinite(
        plate.corners
    ).any() else 0.0  # fmt: skip
    return _Readings(time[keep], turned, height, plate.zeroed or zero is not None)


def _on_frames(
    readings: _Readings, plate: PlateInfo, grid: tuple[MarkerTable, int]
) -> tuple[tuple[Float[Array, "sample 6"], float], int, int, str] | str:
    """Load at the instants of the frames, with the usable frames, or why there is none."""
    (table, per_frame), time = grid, readings.time
    wanted = np.arange(len(table.time) * per_frame) / (table.rate_hz * per_frame)
    sampled = np.column_stack([np.interp(wanted, time, column) for column in readings.load.T])
    inside = (wanted >= time[0] - _SLACK) & (wanted <= time[-1] + 1 / plate.rate_hz + _SLACK)
    first = int(np.ceil(np.argmax(inside) / per_frame))
    last = (len(wanted) - int(np.argmax(inside[::-1]))) // per_frame
    if not inside.any() or first > TRIMMED_S * table.rate_hz or (
        len(table.time) - last > TRIMMED_S * table.rate_hz
    ):  # fmt: skip
        return "it did not send throughout"
    longest = float(np.diff(time).max())
    if longest > BRIDGED_S + 1 / plate.rate_hz:
        return f"it lacks up to {1000 * longest:.0f} ms, which a C3D file cannot say"
    remarks = []
    missing = round((time[-1] - time[0]) * plate.rate_hz) + 1 - len(time)
    if missing > 0 and longest > 1.5 / plate.rate_hz:
        remarks.append(
            f"lacks {missing} samples, bridged by straight lines of at most {1000 * longest:.0f} ms"
        )
    if not readings.zeroed:
        remarks.append("was never zeroed: its loads hold the empty plate's")
    return (sampled, readings.height_m), first, last, "; it ".join(remarks)


def _cut(
    table: MarkerTable,
    plates: list[tuple[str, tuple[Float[Array, "sample 6"], float]]],
    per_frame: int,
    window: tuple[int, int],
    notes: tuple[str, ...],
    where: str,
) -> Recording:
    """The recording within the frames that every plate covers."""
    first, last = window
    if last - first < 2:
        raise InputError("markers and plates do not overlap", where=where, hint="record again")
    time = np.arange(last - first) / table.rate_hz
    markers = replace(table, time=time, positions=table.positions[first:last])
    if not plates:
        return Recording(markers, None, notes)
    loads = []
    for _, (load, height) in plates:
        loads.append(about_point(load[first * per_frame : last * per_frame], height))
    force, point, torque = (np.stack(parts, axis=1) for parts in zip(*loads, strict=True))
    rate = table.rate_hz * per_frame
    forces = PlateForces(
        source=where,
        names=tuple(str(k + 1) for k in range(len(plates))),
        labels=tuple(name for name, _ in plates),
        time=np.arange(len(force)) / rate,
        rate_hz=rate,
        force=force,
        point=point,
        torque=torque,
    )
    return Recording(markers, forces, notes)


def about_point(
    load: Float[Array, "sample 6"], height_m: float
) -> tuple[Float[Array, "sample 3"], Float[Array, "sample 3"], Float[Array, "sample 3"]]:
    """Force, point of application on the plate's surface and torque about it, of a load about the origin.

    Args:
        load: Force [N] and moment about the origin [N*m], y up.
        height_m: Height of the surface [m].

    Returns:
        Force [N], point [m] and torque [N*m]; the point is NaN and the torque zero while the plate carries
        less than 20 N.
    """
    force, moment = load[:, :3], load[:, 3:]
    loaded = force[:, 1] >= UNLOADED_N
    vertical = np.where(loaded, force[:, 1], np.nan)
    x = (moment[:, 2] + height_m * force[:, 0]) / vertical
    z = (height_m * force[:, 2] - moment[:, 0]) / vertical
    twist = np.where(loaded, moment[:, 1] - (z * force[:, 0] - x * force[:, 2]), 0.0)
    still = np.zeros(len(load))
    point = np.column_stack([x, np.where(loaded, height_m, np.nan), z])
    return force, point, np.column_stack([still, twist, still])
