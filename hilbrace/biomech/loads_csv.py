"""The joint loads as a table that opens anywhere."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.run.records import write_atomic
from hilbrace.units import DEG

_ANGLES = {"knee": ("flexion", "adduction", "rotation"), "ankle": ("dorsiflexion", "inversion")}
_SIDES = {"r": "right", "l": "left"}

_MEANING = {
    "time_s": "instant [s]",
    "flexion_deg": "knee flexion [deg]",
    "adduction_deg": "adduction of the shank, positive on both sides (varus) [deg]",
    "rotation_deg": "internal rotation of the shank, positive on both sides [deg]",
    "dorsiflexion_deg": "ankle dorsiflexion [deg]",
    "inversion_deg": "subtalar inversion [deg]",
    "acting_force_x_n": "net force of the proximal on the distal segment, anterior [N]",
    "acting_force_y_n": "the same, up the segment [N]",
    "acting_force_z_n": "the same, to the subject's right [N]",
}


def write_joint_loads_csv(loads: JointLoads, path: Path) -> None:
    """Write angles and acting forces of every joint, one row a frame.

    Columns are ``time_s`` and, for each joint and side, such as ``knee_left_flexion_deg``,
    ``knee_left_acting_force_x_n``. What a column means, and the frame of the forces (that of the distal
    body: tibia for the knee, talus for the ankle), stands in a JSON file of the same name beside it.

    Args:
        loads: The record.
        path: File to write, ``.csv``.
    """
    names, columns = ["time_s"], [loads.time]
    for k, joint in enumerate(loads.joints):
        kind, side = joint.split("_")
        label = f"{kind}_{_SIDES[side]}"
        for axis, angle in enumerate(_ANGLES[kind]):
            names.append(f"{label}_{angle}_deg")
            columns.append(loads.angles[:, k, axis] / DEG)
        for axis, letter in enumerate("xyz"):
            names.append(f"{label}_acting_force_{letter}_n")
            columns.append(loads.acting_force[:, k, axis])
    rows = [",".join(f"{value:.6g}" for value in row) for row in np.column_stack(columns).tolist()]
    write_atomic(path, ("\n".join([",".join(names), *rows]) + "\n").encode())
    about = {
        "columns": _MEANING,
        "force_frame": {"knee": "tibia", "ankle": "talus"},
        "convention": loads.convention,
        "body_mass_kg": loads.body_mass_kg,
        "cutoff_hz": loads.cutoff_hz,
    }
    write_atomic(path.with_suffix(".json"), (json.dumps(about, indent=2) + "\n").encode())
