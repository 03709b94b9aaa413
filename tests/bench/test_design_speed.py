"""Time of the design loop at 10k triangles and 45 frames, and of one evaluation of the field.

Run by ``pytest tests/bench/test_design_speed.py --benchmark-only -s``. Goals on two quiet cores: 200
iterations in 90 s with MKL and in 4 min with scipy alone, the field at 10k points in 2 ms. An iteration of
the real loop is timed (losses, gradient, step, checkpoint), and the whole run is told as 200 of them.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings
from hilbrace.domain.domain import Domain
from hilbrace.field import GaussianField, NetworkField
from hilbrace.optimize.loop import run_loop
from hilbrace.optimize.problem import build_problem
from hilbrace.run.processors import processors
from hilbrace.run.progress import silent
from hilbrace.shell import open_pool
from hilbrace.shell.solver import available_backends
from tests.unit.knee_tube import knee_domain, knee_loads

FRAMES, ITERATIONS = 45, 200
GOALS_S = {"pardiso": 90.0, "scipy": 240.0}
FIELD_GOAL_MS = 2.0
TIMED = 12


@pytest.fixture(scope="module")
def domain() -> Domain:
    """A tube of 10,000 triangles that bends to 60 degrees in 45 frames."""
    domain = knee_domain(knee_loads(), around=76, along=66, frames=FRAMES)
    assert abs(len(domain.triangles) - 10_000) < 100
    return domain


@pytest.mark.parametrize("solver", GOALS_S)
def test_design_loop(benchmark, domain: Domain, tmp_path: Path, solver: str):
    if solver not in available_backends():
        pytest.skip(f"{solver} is not installed")
    torch.set_num_threads(1)  # as a run has it
    settings = OptimizeSettings(iterations=TIMED, solver=solver)
    problem = build_problem(
        knee_loads(), domain, settings, MaterialSettings(), PatternSettings(scale=0.08, rim_mm=8.0)
    )
    spent = []
    with open_pool(problem.shapes.shells[0].numbering.sparsity, solver, processors()) as pool:

        def loop(key: int) -> float:
            start = time.process_time()
            done = run_loop(problem, tmp_path / f"{key}.npz", str(key), silent, pool)
            spent.append((time.process_time() - start) / (TIMED + 1))
            return done.seconds

        loop(0)
        seconds = benchmark.pedantic(loop, args=(1,), rounds=1)
        threads = pool.threads
    whole = seconds * ITERATIONS
    benchmark.extra_info.update(
        triangles=len(domain.triangles),
        frames=FRAMES,
        postures=len(problem.postures),
        threads=threads,
        iteration_s=seconds,
        iteration_cpu_s=spent[-1],
        run_of_200_s=whole,
        goal_s=GOALS_S[solver],
    )
    sys.stdout.write(
        f"\n{len(domain.triangles)} triangles, {FRAMES} frames, {len(problem.postures)} postures, {solver}, "
        f"{threads} threads: {seconds:.3f} s an iteration (CPU {spent[-1]:.3f} s), {ITERATIONS} in "
        f"{whole:.0f} s (goal {GOALS_S[solver]:.0f} s)\n"
    )


@pytest.mark.parametrize("sigma", [4.0, 10.0, 20.0])
@pytest.mark.parametrize("gradient", [False, True])
def test_gaussian_field(benchmark, sigma: float, gradient: bool):
    points = np.random.default_rng(0).uniform(0.0, 1.0, (10_000, 2))
    _time_field(benchmark, GaussianField(points, sigma), gradient, f"sigma {sigma:g}")


@pytest.mark.parametrize("gradient", [False, True])
def test_network_field(benchmark, gradient: bool):
    points = np.random.default_rng(0).uniform(0.0, 1.0, (10_000, 2))
    settings = OptimizeSettings()
    field = NetworkField(points, settings.network_layers, settings.network_waves)
    _time_field(benchmark, field, gradient, "network")


def _time_field(benchmark, field, gradient: bool, name: str) -> None:
    torch.set_num_threads(1)
    theta = field.start(0, 0.02)
    pull = torch.ones(10_000, dtype=torch.float64)

    def forward():
        with torch.no_grad():
            return field.logits(theta)

    def both():
        moving = theta.clone().requires_grad_()
        return torch.autograd.grad(field.logits(moving), moving, pull)

    benchmark.pedantic(both if gradient else forward, rounds=60, warmup_rounds=5)
    median = 1000.0 * benchmark.stats.stats.median
    what = "with its gradient" if gradient else f"alone (goal {FIELD_GOAL_MS} ms for Gaussians)"
    sys.stdout.write(f"\nfield at 10,000 points, {name}, {what}: median {median:.2f} ms\n")
