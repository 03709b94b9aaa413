"""Time of one optimizer iteration in the shell: refill, factor, 3 + 12 solves, and the gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hilbrace.shell import (
    LoadPattern,
    build_shell,
    joint_line_shares,
    loop_stiffness,
    pose_shell,
    shell_response,
)
from tests.unit.shell_cases import tube

FRAMES = 45
MESHES = {4000: (48, 42), 10_000: (76, 66)}


def knee_tube(triangles):
    columns, rows = MESHES[triangles]
    return tube(columns, rows, 60.0, 300.0, waviness=0.1, window=True)


def case(triangles):
    vertices, faces, upper, lower = knee_tube(triangles)
    shell = build_shell(vertices, faces, upper, lower, 4.0, 0.45)
    rng = np.random.default_rng(0)
    modulus = torch.from_numpy(rng.uniform(0.05, 1.15, len(faces))).requires_grad_()
    forces = torch.from_numpy(rng.standard_normal((FRAMES, 3)))
    return shell, modulus, LoadPattern(joint_line_shares(vertices, faces, 40.0), forces)


@pytest.mark.parametrize("triangles", MESHES)
def test_forward_and_backward(benchmark, triangles):
    shell, modulus, load = case(triangles)

    def iteration():
        answer = shell_response(modulus, shell, load)
        loss = answer.compliance.sum() + answer.reactions.square().sum() + answer.loop_stiffness.trace()
        return torch.autograd.grad(loss, modulus)

    benchmark.extra_info["triangles"] = len(shell.triangles)
    benchmark.pedantic(iteration, rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("triangles", MESHES)
def test_loop_stiffness_of_one_posture(benchmark, triangles):
    shell, modulus, _ = case(triangles)

    def iteration():
        return torch.autograd.grad(loop_stiffness(modulus, shell).trace(), modulus)

    benchmark.pedantic(iteration, rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("triangles", MESHES)
def test_build(benchmark, triangles):
    benchmark.pedantic(build_shell, (*knee_tube(triangles), 4.0, 0.45), rounds=3, warmup_rounds=1)


@pytest.mark.parametrize("triangles", MESHES)
def test_pose(benchmark, triangles):
    shell, _, _ = case(triangles)
    benchmark.pedantic(pose_shell, (shell, 1.01 * shell.vertices), rounds=3, warmup_rounds=1)
