"""Columns of ground reactions in MOT and STO files, by the names that laboratories give them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.motion.force_plates import PlateForces
from hilbrace.motion.opensim_files import Storage, even_time, read_storage

Array = np.ndarray

FAMILIES = (
    r"ground_(?:force|torque|moment)_?(?P<plate>\w*?)_?(?P<kind>[vpmt]?)(?P<axis>[xyz])",
    r"(?P<plate>\w+?)_ground_(?:force|torque|moment)_(?P<kind>[vpmt]?)(?P<axis>[xyz])",
    r"(?P<kind>[fpm])(?P<plate>\d+)_(?P<axis>[123])",
)
"""``ground_force_1_vx``, ``ground_force_r_px``, ``ground_torque_l_x``, ``ground_force_vx``;
``1_ground_force_vx``, ``R_ground_torque_x``; ``f1_1``, ``p1_2``, ``m1_3`` (OpenSim's C3D export)."""

_KINDS = {"v": "force", "f": "force", "p": "point", "m": "torque", "t": "torque", "": "torque"}
_AXES = {"x": 0, "y": 1, "z": 2, "1": 0, "2": 1, "3": 2}


def read_plate_forces(path: Path) -> PlateForces:
    """Read the ground reactions of a MOT or STO file, in the axes of the file.

    Raises:
        InputError: The file cannot be read, or its columns name no ground reactions, or only part of one.
    """
    return plate_forces(read_storage(path), str(path))


def plate_forces(storage: Storage, source: str) -> PlateForces:
    """Find the ground reactions among the columns of a storage.

    Torque columns may be absent (zero torque about the point); forces and points may not.

    Raises:
        InputError: See `read_plate_forces`.
    """
    found: dict[str, dict[str, dict[int, str]]] = {}
    for column in storage.columns:
        if (place := _place(column)) is not None:
            plate, kind, axis = place
            found.setdefault(plate, {}).setdefault(kind, {})[axis] = column
    if not found:
        raise InputError(
            f"no column names a ground reaction; there are {', '.join(list(storage.columns)[:6])}, ...",
            where=source,
            hint="name them ground_force_1_vx, ground_force_1_px, ground_force_1_mx and so on",
        )
    for plate, kinds in found.items():
        for kind, stem in (("force", "v"), ("point", "p"), ("torque", "m")):
            axes = kinds.get(kind, {})
            if len(axes) != 3 and (kind != "torque" or axes):
                raise InputError(
                    f"plate '{plate}' has {len(axes)} of 3 columns of its {kind}",
                    where=f"{source}, columns {', '.join(next(iter(kinds.values())).values())}",
                    hint=f"add ground_force_{plate}_{stem}x, ..._{stem}y and ..._{stem}z",
                )
    rate_hz = (len(storage.time) - 1) / float(storage.time[-1] - storage.time[0])
    return PlateForces(
        source,
        tuple(found),
        tuple(kinds["force"][1] for kinds in found.values()),
        even_time(storage.time, rate_hz, source),
        rate_hz,
        _stack(storage, found, "force"),
        _stack(storage, found, "point"),
        _stack(storage, found, "torque"),
    )


def _place(column: str) -> tuple[str, str, int] | None:
    for family in FAMILIES:
        if match := re.fullmatch(family, column, re.IGNORECASE):
            return match["plate"] or "0", _KINDS[match["kind"].lower()], _AXES[match["axis"].lower()]
    return None


def _stack(
    storage: Storage, found: dict[str, dict[str, dict[int, str]]], kind: str
) -> Float[Array, "sample plate 3"]:
    zero = np.zeros_like(storage.time)
    plates = [[storage.columns[kinds[kind][a]] if kind in kinds else zero for a in range(3)]
              for kinds in found.values()]  # fmt: skip
    return np.array(plates).transpose(2, 0, 1)
