"""Time of one optimizer iteration in the shell, 45 frames: forward and gradient, for each way to give shapes.

Run by ``pytest tests/bench/test_shell_speed.py --benchmark-only``; with ``-s`` it prints the medians in one
table at the end. Goals on two quiet cores with MKL at 10k triangles: fixed pattern 0.15 s, 45 free loads
0.25 s, clusters:9 0.8 s, frame 3.3 s. The CPU time stands beside the wall time, since it bears other work on
the machine better. OMP_NUM_THREADS sets the threads.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from hilbrace.shell import (
    LoadPattern,
    NodalLoads,
    ShellFamily,
    SolverPool,
    build_shell,
    family_response,
    geometry_mode,
    joint_line_shares,
    loop_stiffness,
    open_pool,
    pose_shell,
    shell_family,
)
from tests.unit.shell_cases import bent_frames, tube

FRAMES = 45
MESHES = {4000: (48, 42), 10_000: (77, 67)}
GOALS = {"fixed pattern": 0.15, "45 free loads": 0.25, "clusters:9": 0.8, "frame": 3.3}
ROUNDS = {"fixed pattern": 7, "45 free loads": 7, "clusters:9": 3, "frame": 2}


def knee_tube(triangles):
    columns, rows = MESHES[triangles]
    return tube(columns, rows, 60.0, 300.0, waviness=0.1, window=True)


@dataclass
class Case:
    """A brace in all its shapes, its loads, and open solvers."""

    families: dict[str, ShellFamily]
    modulus: torch.Tensor
    pattern: LoadPattern
    nodal: NodalLoads
    pool: SolverPool

    def iteration(self, name):
        """Forward and gradient of a loss that sees every answer."""
        load = self.nodal if name == "45 free loads" else self.pattern
        answer = family_response(self.modulus, self.families[name], load, solvers=self.pool)
        loss = answer.compliance.sum() + answer.reactions.square().sum() + answer.loop_stiffness.sum()
        return torch.autograd.grad(loss, self.modulus)


@pytest.fixture(scope="module")
def case() -> Iterator[Case]:
    vertices, faces, upper, lower = knee_tube(10_000)
    shell = build_shell(vertices, faces, upper, lower, 4.0, 0.45)
    posed = bent_frames(vertices, FRAMES, width=25.0)
    shares = joint_line_shares(vertices, faces, 40.0)
    rng = np.random.default_rng(0)
    forces = torch.from_numpy(rng.standard_normal((FRAMES, 3)))
    families = {
        name: shell_family(shell, posed, geometry_mode(name)) for name in ("rest", "clusters:9", "frame")
    }
    with open_pool(shell.numbering.sparsity) as pool:
        yield Case(
            families={"fixed pattern": families["rest"], "45 free loads": families["rest"], **families},
            modulus=torch.from_numpy(rng.uniform(0.05, 1.15, len(faces))).requires_grad_(),
            pattern=LoadPattern(shares, forces),
            nodal=NodalLoads(torch.from_numpy(shares)[:, None] * forces[:, None, :]),
            pool=pool,
        )


@pytest.fixture(scope="module")
def table(case) -> Iterator[dict[str, tuple[float, float]]]:
    """Medians by name, printed when all are there."""
    found: dict[str, tuple[float, float]] = {}
    yield found
    triangles = len(case.families["rest"].shells[0].triangles)
    lines = [f"\n{triangles} triangles, {FRAMES} frames, {case.pool.name}, {case.pool.threads} threads"]
    for name, (wall, cpu) in found.items():
        lines.append(f"{name:>15}: median {wall:.3f} s, CPU {cpu:.3f} s (goal {GOALS[name]} s)")
    sys.stdout.write("\n".join(lines) + "\n")


@pytest.mark.parametrize("name", GOALS)
def test_iteration(benchmark, case, table, name):
    spent = []

    def iteration():
        start = time.process_time()
        case.iteration(name)
        spent.append(time.process_time() - start)

    benchmark.extra_info.update(
        triangles=len(case.families["rest"].shells[0].triangles),
        frames=FRAMES,
        backend=case.pool.name,
        threads=case.pool.threads,
        goal_s=GOALS[name],
    )
    benchmark.pedantic(iteration, rounds=ROUNDS[name], warmup_rounds=1)
    benchmark.extra_info["cpu_s"] = float(np.median(spent[1:]))
    table[name] = (benchmark.stats.stats.median, benchmark.extra_info["cpu_s"])


@pytest.mark.parametrize("triangles", MESHES)
def test_loop_stiffness_of_one_posture(benchmark, triangles):
    vertices, faces, upper, lower = knee_tube(triangles)
    shell = build_shell(vertices, faces, upper, lower, 4.0, 0.45)
    modulus = torch.full((len(faces),), 1.0, dtype=torch.float64).requires_grad_()
    with open_pool(shell.numbering.sparsity) as pool:

        def iteration():
            return torch.autograd.grad(loop_stiffness(modulus, shell, solvers=pool).trace(), modulus)

        benchmark.pedantic(iteration, rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("triangles", MESHES)
def test_build(benchmark, triangles):
    benchmark.pedantic(build_shell, (*knee_tube(triangles), 4.0, 0.45), rounds=3, warmup_rounds=1)


@pytest.mark.parametrize("triangles", MESHES)
def test_pose(benchmark, triangles):
    vertices, faces, upper, lower = knee_tube(triangles)
    shell = build_shell(vertices, faces, upper, lower, 4.0, 0.45)
    benchmark.pedantic(pose_shell, (shell, 1.01 * vertices), rounds=3, warmup_rounds=1)
