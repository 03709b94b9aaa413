"""Muscle forces of the recorded Rajagopal walk: time per frame, against OpenSim's StaticOptimization tool.

Both run one after the other in one go, so that the ratio holds on a busy machine too. Time of the processor
is counted for the tool (its start and the reading of its model included), wall time for us, from the
coordinates to muscle forces: inverse dynamics, moment arms, capacities and the programme.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from hilbrace.biomech.engine import Engine
from hilbrace.biomech.muscles import MuscleFigures, balanced_coordinates, recruit
from tests.unit import muscle_oracle
from tests.unit.rajagopal_walk import read_walk

FIRST, LAST = 30, 54


def test_muscle_forces_per_frame(benchmark, shared_data: Path, tmp_path: Path):
    with Engine() as engine:
        walk = read_walk(engine, shared_data, tmp_path)
        rows, _ = balanced_coordinates(walk.figures.coordinates, walk.coordinates)
        columns = [walk.figures.coordinates.index(name) for name in rows]
        figures = MuscleFigures(**engine.call("muscle_figures"))
        frames = slice(FIRST, LAST + 1)

        def ours() -> np.ndarray:
            moments = engine.call(
                "inverse_dynamics",
                coordinates=walk.coordinates[frames],
                speeds=walk.speeds[frames],
                accelerations=walk.accelerations[frames],
                loads={body: load[frames] for body, load in walk.loads.items()},
            )
            paths = engine.call(
                "muscle_paths",
                coordinates=walk.coordinates[frames],
                speeds=walk.speeds[frames],
                rows=rows,
                parts=[],
            )
            found = recruit(paths["capacity"], paths["arms"], moments[:, columns], rows, {}, figures)
            return found.tension

        tension = benchmark.pedantic(ours, rounds=5, warmup_rounds=1)
        best = min(_seconds(ours) for _ in range(3))
    theirs = muscle_oracle.ask(
        model=str(walk.model),
        names=np.array(walk.figures.coordinates),
        time=walk.time,
        coordinates=walk.coordinates,
        reactions=walk.reactions,
        first=FIRST,
        last=LAST,
        reserves=1,
    )
    count = LAST - FIRST + 1
    benchmark.extra_info["ms_per_frame"] = 1e3 * best / count
    benchmark.extra_info["tool_ms_per_frame"] = 1e3 * float(theirs["seconds"]) / count
    benchmark.extra_info["times_faster"] = float(theirs["seconds"]) / best
    benchmark.extra_info["correlation"] = float(np.corrcoef(tension.ravel(), theirs["forces"].ravel())[0, 1])


def _seconds(task) -> float:
    begun = time.perf_counter()
    task()
    return time.perf_counter() - begun


@pytest.mark.parametrize("frames", [100, 1000])
def test_load_sharing_alone(benchmark, frames: int):
    from hilbrace.biomech.load_sharing import share_load

    random = np.random.default_rng(0)
    reach = random.choice([0.0, 1.0, 30.0, 150.0], size=(1, 20, 80), p=[0.7, 0.1, 0.1, 0.1])
    effect = random.normal(size=(frames, 20, 80)) * reach
    demand = random.normal(size=(frames, 20)) * 60.0
    benchmark(share_load, effect, demand, np.ones(20), np.full(80, 0.01))
