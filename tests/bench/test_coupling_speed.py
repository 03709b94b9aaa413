"""Time of the joint's response: 45 frames, forward and backward; 0.15 s are allowed."""

from __future__ import annotations

import torch

from hilbrace.optimize.joint_response import JointMotion, angle_change, joint_motion
from tests.unit.knee_tube import knee_loads

FRAMES = 45


def case() -> tuple[JointMotion, torch.Tensor]:
    loads = knee_loads(FRAMES, seconds=(FRAMES - 1) / 60)
    motion = joint_motion(loads, "knee_l", (0.5, 5.0, 1.5))
    brace = 3.0 * torch.eye(3, dtype=torch.float64).repeat(len(motion.time), 1, 1)
    return motion, brace.requires_grad_()


def test_forward_and_backward(benchmark):
    motion, brace = case()

    def once() -> None:
        angle_change(motion, brace).square().sum().backward()

    benchmark.pedantic(once, rounds=20, warmup_rounds=2)
