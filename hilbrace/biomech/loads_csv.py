"""The joint loads as a table that opens anywhere."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.contact import COMPARTMENTS_M
from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.run.records import write_atomic
from hilbrace.units import DEG, GRAVITY

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
    "contact_force_n": "force between the bones, magnitude [N]; empty where no muscles were solved for",
    "contact_force_bw": "the same in body weights",
    "contact_force_x_n": "contact force on the distal bone, anterior [N]",
    "contact_force_y_n": "the same, up the segment: negative is compression [N]",
    "contact_force_z_n": "the same, to the subject's right [N]",
    "contact_medial_n": "compression of the medial compartment of a knee [N]",
    "contact_lateral_n": "compression of the lateral compartment of a knee [N]",
}


def write_joint_loads_csv(loads: JointLoads, path: Path) -> None:
    """Write angles, acting and contact forces of every joint, one row a frame.

    Columns are ``time_s`` and, for each joint and side, such as ``knee_left_flexion_deg``,
    ``knee_left_acting_force_x_n``, ``knee_left_contact_force_bw``. What a column means, and the frame of the
    forces (that of the distal body: tibia for the knee, talus for the ankle), stands in a JSON file of the
    same name beside it.

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
        for name, values in _contact_columns(loads, k).items():
            names.append(f"{label}_{name}")
            columns.append(values)
    table = np.column_stack(columns).tolist()
    rows = [",".join("" if value != value else f"{value:.6g}" for value in row) for row in table]
    write_atomic(path, ("\n".join([",".join(names), *rows]) + "\n").encode())
    about = {
        "columns": _MEANING,
        "force_frame": {"knee": "tibia", "ankle": "talus"},
        "convention": loads.convention,
        "body_mass_kg": loads.body_mass_kg,
        "cutoff_hz": loads.cutoff_hz,
        "compartments_apart_m": COMPARTMENTS_M,
    }
    write_atomic(path.with_suffix(".json"), (json.dumps(about, indent=2) + "\n").encode())


def _contact_columns(loads: JointLoads, k: int) -> dict[str, Float[np.ndarray, " frame"]]:
    force = loads.contact_force[:, k]
    magnitude = np.linalg.norm(force, axis=1)
    columns = {
        "contact_force_n": magnitude,
        "contact_force_bw": magnitude / (loads.body_mass_kg * GRAVITY),
        **{f"contact_force_{letter}_n": force[:, axis] for axis, letter in enumerate("xyz")},
    }
    if loads.joints[k].startswith("knee"):
        columns["contact_medial_n"] = loads.contact_medial[:, k]
        columns["contact_lateral_n"] = loads.contact_lateral[:, k]
    return columns
