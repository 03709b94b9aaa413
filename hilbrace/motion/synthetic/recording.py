"""A synthetic motion as the files that a laboratory would hand over, with the truth beside them.

``motion.c3d`` and ``static.c3d`` have force plates of type 2; ``markers.trc``, ``static.trc`` and
``grf.mot`` hold the same for OpenSim. ``truth.mot`` holds the coordinates: degrees, but radians for the
kneecaps, as OpenSim reads them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.motion.opensim_files import write_storage, write_trc
from hilbrace.motion.synthetic.forces import FEET, FootForces
from hilbrace.motion.synthetic.generate import SyntheticMotion
from hilbrace.motion.synthetic.laboratory import write_c3d
from hilbrace.units import DEG

Array = np.ndarray


def write_recording(motion: SyntheticMotion, folder: Path) -> dict[str, Path]:
    """Write a synthetic motion as a laboratory's files.

    Args:
        motion: The motion.
        folder: Folder to write into; it is made if it is missing.

    Returns:
        Paths by kind: ``c3d``, ``static_c3d``, ``trc``, ``static_trc``, ``grf``, ``static_grf``, ``truth``.

    Raises:
        InputError: The folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise InputError(
            f"cannot make the folder: {fault.strerror}", where=str(folder), hint="choose another folder"
        ) from fault
    paths = {
        "c3d": folder / "motion.c3d",
        "static_c3d": folder / "static.c3d",
        "trc": folder / "markers.trc",
        "static_trc": folder / "static.trc",
        "grf": folder / "grf.mot",
        "static_grf": folder / "static_grf.mot",
        "truth": folder / "truth.mot",
    }
    still, rate = motion.static, motion.rate_hz
    write_c3d(paths["c3d"], motion, motion.time, motion.markers, motion.forces, motion.plates)
    write_c3d(paths["static_c3d"], motion, still.time, still.markers, still.forces, still.plates)
    write_trc(paths["trc"], motion.time, rate, motion.marker_names, motion.markers)
    write_trc(paths["static_trc"], still.time, rate, motion.marker_names, still.markers)
    for kind, time, forces in (
        ("grf", motion.time, motion.forces),
        ("static_grf", still.time, still.forces),
    ):
        title = f"synthetic {motion.name}: ground reactions"
        write_storage(paths[kind], time, ground_columns(forces), degrees=False, name=title)
    write_storage(
        paths["truth"],
        motion.time,
        coordinate_columns(motion.coordinates),
        degrees=True,
        name=f"synthetic {motion.name}: true coordinates",
    )
    return paths


def ground_columns(forces: FootForces) -> dict[str, Float[Array, " frame"]]:
    """Ground reactions as OpenSim's columns: force [N], point [m] and torque [N*m] of each foot."""
    columns: dict[str, Array] = {}
    for k, side in enumerate(FEET):
        for axis, label in enumerate("xyz"):
            columns[f"ground_force_{side}_v{label}"] = forces.force[:, k, axis]
        for axis, label in enumerate("xyz"):
            columns[f"ground_force_{side}_p{label}"] = forces.centre_of_pressure[:, k, axis]
        for label in "xyz":
            moment = forces.free_moment[:, k]
            columns[f"ground_torque_{side}_{label}"] = moment if label == "y" else np.zeros_like(moment)
    return columns


def coordinate_columns(coordinates: dict[str, Float[Array, " frame"]]) -> dict[str, Float[Array, " frame"]]:
    """Coordinates as OpenSim reads them from a file in degrees: kneecaps stay in radians."""
    kept = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
    return {
        name: value if name in kept or name.endswith("_beta") else value / DEG
        for name, value in coordinates.items()
    }
