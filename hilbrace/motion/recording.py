"""One recording as its files hold it, turned into the OpenSim frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.force_columns import read_plate_forces
from hilbrace.motion.force_plates import PlateForces
from hilbrace.motion.marker_maps import MarkerMap, segment_of
from hilbrace.motion.opensim_files import MarkerTable, read_trc

Array = np.ndarray

SMALLEST_BODY_M, LARGEST_BODY_M = 0.3, 3.5
"""Plausible extents of the markers on one person."""

LARGEST_SPEED_M_PER_S = 100.0
"""Faster markers are exchanged labels or damaged samples."""

FARTHEST_M = 100.0
"""Farthest that a marker may be from the laboratory's origin."""


@dataclass(frozen=True)
class Recording:
    """Markers and plate loads in the OpenSim frame: x forward, y up, z to the right.

    Attributes:
        markers: The markers.
        plates: Loads on the force plates; ``None`` if the files hold none.
        notes: What the reader noticed, one sentence each.
    """

    markers: MarkerTable
    plates: PlateForces | None
    notes: tuple[str, ...]


def read_recording(
    markers: Path, forces: Path | None, vertical_axis: Literal["y", "z"] | None, reader: C3DReader
) -> Recording:
    """Read a C3D file, or a TRC file, and a MOT or STO file of ground reactions.

    Args:
        markers: C3D or TRC file.
        forces: MOT or STO file; it replaces the plates of a C3D file.
        vertical_axis: Up axis of the files; ``None`` means z for C3D and y for TRC.
        reader: Process that reads C3D files.

    Raises:
        InputError: A file is missing, cut short, damaged or of another kind.
    """
    kind = markers.suffix.lower()
    if kind == ".c3d":
        content = reader.read(markers)
        recording = Recording(content.markers, content.plates, content.notes)
    elif kind == ".trc":
        recording = Recording(_without_prefix(read_trc(markers), markers), None, ())
    else:
        raise InputError(
            f"'{markers.suffix}' is no kind of marker file",
            where=str(markers),
            hint="give a .c3d or .trc file",
        )
    if forces is not None:
        if forces.suffix.lower() not in (".mot", ".sto"):
            raise InputError(
                f"'{forces.suffix}' is no kind of force file",
                where=str(forces),
                hint="give a .mot or .sto file, or a .pth file of GroundLink",
            )
        recording = replace(recording, plates=read_plate_forces(forces))
    return _upright(recording) if (vertical_axis or ("z" if kind == ".c3d" else "y")) == "z" else recording


def from_z_up(vectors: Float[Array, "*rest 3"]) -> Float[Array, "*rest 3"]:
    """Vectors of a z-up laboratory in the y-up frame: (x, y, z) becomes (x, z, -y)."""
    return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1)


def _upright(recording: Recording) -> Recording:
    markers = replace(recording.markers, positions=from_z_up(recording.markers.positions))
    plates = recording.plates
    if plates is not None:
        plates = replace(
            plates,
            force=from_z_up(plates.force),
            point=from_z_up(plates.point),
            torque=from_z_up(plates.torque),
        )
    return Recording(markers, plates, recording.notes)


def _without_prefix(table: MarkerTable, path: Path) -> MarkerTable:
    """Names without the subject that some programs put in front ("Subject:LASI")."""
    names = tuple(name.rsplit(":", 1)[-1] for name in table.names)
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise InputError(
            f"several subjects have a marker '{repeated[0]}'",
            where=str(path),
            hint="export one subject per file",
        )
    return replace(table, names=names)


def keep_markers(table: MarkerTable, names: tuple[str, ...]) -> MarkerTable:
    """The table with the named markers alone, in their order in the file."""
    kept = [k for k, name in enumerate(table.names) if name in names]
    return replace(table, names=tuple(table.names[k] for k in kept), positions=table.positions[:, kept])


def check_markers(table: MarkerTable, marker_map: MarkerMap, where: str) -> None:
    """Refuse markers that cannot be those of an upright person in metres.

    Raises:
        InputError: The body is too large or too small (wrong unit), markers jump, or the pelvis is not above
            the feet (wrong up axis).
    """
    _check_size(table, where)
    _check_jumps(table, where)
    segments = segment_of(marker_map)
    pelvis = [k for k, name in enumerate(table.names) if segments[name] == "pelvis"]
    feet = [k for k, name in enumerate(table.names) if segments[name].startswith(("calcn", "toes"))]
    if not pelvis or not feet:
        return
    rise = _middle(table.positions[:, pelvis]) - _middle(table.positions[:, feet])
    if not rise[1] > 0.1:
        up = "xyz"[int(np.abs(np.nan_to_num(rise)).argmax())]
        raise InputError(
            f"the pelvis is {rise[1]:.2f} m above the feet: y is not up (the body stands along {up})",
            where=where,
            hint="set motion.vertical_axis to 'y' or 'z', as the recording software has it",
        )


def _middle(points: Float[Array, "frame marker 3"]) -> Float[Array, " 3"]:
    known = points[np.isfinite(points).all(axis=2)]
    return np.median(known, axis=0) if len(known) else np.full(3, np.nan)


def _check_size(table: MarkerTable, where: str) -> None:
    visible = np.asarray(np.isfinite(table.positions).all(axis=2))
    seen = table.positions[visible.any(axis=1)]
    if not len(seen):
        raise InputError("no marker is ever visible", where=where, hint="export the trajectories again")
    low = np.nanmin(np.where(np.isfinite(seen), seen, np.inf), axis=1)
    high = np.nanmax(np.where(np.isfinite(seen), seen, -np.inf), axis=1)
    size = float(np.median((high - low).max(axis=1)))
    if not SMALLEST_BODY_M <= size <= LARGEST_BODY_M:
        guess = "millimetres called metres" if size > 100 else "metres called millimetres"
        unit = guess if size > 100 or size < 0.01 else "not the unit that the file names"
        raise InputError(
            f"the markers span {size:.3g} m: no person is that size",
            where=where,
            hint=f"these look like {unit}: correct the unit in the file's header",
        )


def _check_jumps(table: MarkerTable, where: str) -> None:
    far = np.argwhere(np.abs(np.nan_to_num(table.positions)).max(axis=2) > FARTHEST_M)
    step = np.linalg.norm(np.nan_to_num(np.diff(table.positions, axis=0)), axis=2)
    jump = np.argwhere(step > LARGEST_SPEED_M_PER_S / table.rate_hz + 0.05)
    if len(far) or len(jump):
        frame, marker = (int(i) for i in (far[0] if len(far) else jump[0] + [1, 0]))
        moved = (
            f"{np.abs(table.positions[frame, marker]).max():.3g} m from the origin"
            if len(far)
            else f"{step[frame - 1, marker]:.2f} m from one frame to the next"
        )
        raise InputError(
            f"marker '{table.names[marker]}' is {moved}"
            if len(far)
            else f"marker '{table.names[marker]}' jumps {moved}",
            where=f"{where}, frame {frame + 1} ({table.time[frame]:.3f} s)",
            hint="correct its label there, or delete the sample and leave a gap",
        )
