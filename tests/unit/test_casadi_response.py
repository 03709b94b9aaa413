"""The CasADi twin gives what torch gives, value and derivative, and its example runs as printed."""

from __future__ import annotations

import doctest
import subprocess
import sys

import casadi
import numpy as np
import pytest
import torch

from hilbrace.errors import ConfigError
from hilbrace.optimize import casadi_response
from hilbrace.optimize.casadi_response import joint_response_function
from hilbrace.optimize.joint_response import JointMotion, angle_change, angle_change_by_wrench, joint_motion
from tests.unit.knee_tube import knee_loads


def _motion(frames: int, seed: int = 0) -> JointMotion:
    """A knee whose constants change from instant to instant and are full matrices."""
    motion = joint_motion(knee_loads(frames, seconds=(frames - 1) / 60), "knee_l", (0.5, 5.0, 1.5))
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn((len(motion.time), *shape), generator=generator).double()  # noqa: E731
    parts = [draw(3, 3) for _ in range(3)]
    inertia, damping, stiffness = (
        size * (part @ part.transpose(1, 2) + torch.eye(3))
        for part, size in zip(parts, (0.1, 1.0, 60.0), strict=True)
    )
    return JointMotion(motion.time, motion.angles, inertia, damping, stiffness, draw(6, 3))


def _braces(motion: JointMotion) -> torch.Tensor:
    root = torch.randn((len(motion.time), 3, 3), generator=torch.Generator().manual_seed(9)).double()
    return 4.0 * root @ root.transpose(1, 2)


def _side_by_side(brace: torch.Tensor) -> np.ndarray:
    return np.concatenate(list(brace.numpy()), axis=1)


def _close(found: object, expected: np.ndarray) -> None:
    np.testing.assert_allclose(np.array(found), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("frames", [3, 45])
def test_both_couplings_give_the_angles_that_torch_gives(frames):
    motion = _motion(frames)
    brace = _braces(motion)
    wrench = torch.randn((frames, 6), generator=torch.Generator().manual_seed(2)).double()
    by_stiffness = joint_response_function(motion, "stiffness")(brace_stiffness=_side_by_side(brace))
    change = angle_change(motion, brace)
    _close(by_stiffness["angle_change"], change.numpy().T)
    _close(by_stiffness["angles"], (motion.angles + change).numpy().T)
    by_wrench = joint_response_function(motion, "paper")(wrench=wrench.numpy().T)
    change = angle_change_by_wrench(motion, wrench)
    _close(by_wrench["angle_change"], change.numpy().T)
    _close(by_wrench["angles"], (motion.angles + change).numpy().T)


def test_its_own_jacobian_by_the_stiffness_is_that_of_torch():
    motion = _motion(14)
    brace = _braces(motion)
    jacobian = joint_response_function(motion, "stiffness").jacobian()
    found = jacobian(brace_stiffness=_side_by_side(brace))["jac_angle_change_brace_stiffness"]
    torchs = torch.autograd.functional.jacobian(lambda at: angle_change(motion, at), brace).numpy()
    _close(found, torchs.transpose(0, 1, 2, 4, 3).reshape(3 * 14, 9 * 14))


def test_its_own_jacobian_by_the_wrench_is_that_of_torch():
    motion = _motion(14)
    wrench = torch.zeros((14, 6), dtype=torch.float64)
    jacobian = joint_response_function(motion, "paper").jacobian()
    found = jacobian(wrench=wrench.numpy().T)["jac_angle_change_wrench"]
    torchs = torch.autograd.functional.jacobian(lambda at: angle_change_by_wrench(motion, at), wrench)
    _close(found, torchs.numpy().reshape(3 * 14, 6 * 14))


def test_it_can_be_differentiated_backwards_inside_another_problem():
    motion = _motion(10)
    brace = casadi.MX.sym("brace", 3, 30)
    response = joint_response_function(motion, "stiffness")
    cost = casadi.sumsqr(response(brace_stiffness=brace)["angles"])
    slope = casadi.Function("slope", [brace], [casadi.gradient(cost, brace)])
    value = _braces(motion).requires_grad_()
    loss = (motion.angles + angle_change(motion, value)).square().sum()
    (torchs,) = torch.autograd.grad(loss, value)
    _close(slope(_side_by_side(value.detach())), _side_by_side(torchs))


def test_an_unknown_coupling_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match="'springs'") as fault:
        joint_response_function(_motion(4), "springs")
    assert "stiffness, paper" in fault.value.hint


def test_the_example_of_the_docstring_runs():
    tried = doctest.testmod(casadi_response, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert tried.attempted > 10
    assert tried.failed == 0


def test_nothing_else_loads_casadi():
    loaded = "import sys, hilbrace.pipeline.stages, hilbrace.optimize.build; print('casadi' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
