"""The recorded Rajagopal walk as plain arrays: coordinates and forces of the ground."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline

from hilbrace.biomech.engine import Engine
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.motion.filters import lowpass
from hilbrace.motion.opensim_files import read_storage

RATE_HZ = 100.0


class Walk(NamedTuple):
    """A motion of a model; ``reactions`` are force, point and torque on the right and the left foot."""

    figures: ModelFigures
    model: Path
    time: np.ndarray
    coordinates: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    reactions: np.ndarray

    @property
    def loads(self) -> dict[str, np.ndarray]:
        """Force and moment about the ground's origin by foot."""
        force, point, torque = np.split(self.reactions, 3, axis=2)
        moment = np.cross(point, force) + torque
        both = np.concatenate([force, moment], axis=2)
        return {f"calcn_{side}": both[:, k] for k, side in enumerate("rl")}


def read_walk(engine: Engine, data: Path, folder: Path) -> Walk:
    """One second of the walk on its published model, whose knees gain some adduction and rotation."""
    source = data / "rajagopal_walk"
    figures = ModelFigures(**engine.call("read_model", path=str(source / "subject_walk_scaled.osim")))
    model = folder / "walk.osim"
    engine.call("write_model", path=str(model))
    recorded, ground = read_storage(source / "coordinates.sto"), read_storage(source / "grf_walk.mot")
    time = 0.5 + np.arange(101) / RATE_HZ
    values = {path.split("/")[-2]: column for path, column in recorded.columns.items()}
    q = np.tile(figures.defaults, (len(time), 1))
    for k, name in enumerate(figures.coordinates):
        if name in values:
            q[:, k] = np.interp(time, recorded.time, values[name])
        elif name.startswith(("knee_adduction", "knee_rotation")):
            q[:, k] = 0.04 * np.sin(5.0 * time + k)
    q = lowpass(q, RATE_HZ, 6.0)
    rest = np.zeros(q.shape[1])
    spline = make_interp_spline(time, q, k=5, bc_type=([(3, rest), (4, rest)], [(3, rest), (4, rest)]))
    reactions = np.stack([_reaction(time, ground, side) for side in "rl"], axis=1)
    return Walk(figures, model, time, q, spline.derivative()(time), spline.derivative(2)(time), reactions)


def _reaction(time, ground, side) -> np.ndarray:
    names = [f"ground_force_{side}_{kind}{axis}" for kind in "vp" for axis in "xyz"]
    names += [f"ground_torque_{side}_{axis}" for axis in "xyz"]
    found = np.stack([np.interp(time, ground.time, ground.columns[name]) for name in names], axis=1)
    return np.where(found[:, 1:2] < 20.0, 0.0, found)
