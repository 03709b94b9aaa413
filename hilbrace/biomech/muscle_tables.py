"""Muscle forces and activations as tables that OpenSim and spreadsheets open."""

from __future__ import annotations

from pathlib import Path

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.motion.opensim_files import write_storage


def write_muscle_tables(loads: JointLoads, folder: Path) -> tuple[Path, ...]:
    """Write the muscles' forces and activations as OpenSim storages.

    ``muscle_forces.sto`` holds the tension of each muscle [N] by its name in the model, and by
    ``<coordinate>_reserve`` what ideal actuators supply beside them [N*m or N], as OpenSim's own tool
    writes them. ``muscle_activations.sto`` holds the activations [-].

    Args:
        loads: The record.
        folder: Folder to write into.

    Returns:
        The files; none if the model has no muscles.
    """
    if not loads.muscle_names:
        return ()
    forces, activations = folder / "muscle_forces.sto", folder / "muscle_activations.sto"
    columns = {name: loads.muscle_force[:, k] for k, name in enumerate(loads.muscle_names)}
    columns |= {f"{name}_reserve": loads.reserve[:, k] for k, name in enumerate(loads.coordinate_names)}
    write_storage(forces, loads.time, columns, degrees=False, name="muscle forces")
    shares = {name: loads.muscle_activation[:, k] for k, name in enumerate(loads.muscle_names)}
    write_storage(activations, loads.time, shares, degrees=False, name="muscle activations")
    return forces, activations
