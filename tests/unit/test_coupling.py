"""Both couplings from the modulus of the shell to angles and contact force: statics, limits and gradients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hilbrace.biomech.dynamics import GroundReaction, momenta, net_load
from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings
from hilbrace.optimize import design
from hilbrace.optimize.brace_response import brace_response, posture_stiffness
from hilbrace.optimize.coupling import COUPLINGS, Prediction, brace_spring, contact_change
from hilbrace.optimize.evaluate import mechanics_of
from hilbrace.optimize.joint_response import joint_motion
from hilbrace.optimize.predictions import PASSIVE_LEVELS, predict
from hilbrace.optimize.problem import Problem, build_problem
from hilbrace.shell import shell_response
from hilbrace.units import MM_PER_M
from tests.unit.knee_tube import knee_domain, knee_loads

DOUBLE = torch.float64


def _problem(**settings: object) -> Problem:
    loads = knee_loads()
    return build_problem(
        loads,
        knee_domain(loads, around=16, along=10),
        OptimizeSettings(**settings),
        MaterialSettings(),
        PatternSettings(scale=0.08, rim_mm=10.0),
    )


@pytest.fixture(scope="module")
def problem() -> Problem:
    return _problem()


def _modulus(problem: Problem, seed: int = 0, size: float = 0.5) -> torch.Tensor:
    noise = torch.rand(problem.areas.shape, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)
    return size * (0.2 + noise)


def _predict(problem: Problem, modulus: torch.Tensor, coupling: str) -> Prediction:
    return COUPLINGS[coupling](problem, brace_response(problem, modulus))


def _outputs(problem: Problem, modulus: torch.Tensor, coupling: str) -> dict[str, torch.Tensor]:
    found = _predict(problem, modulus, coupling)
    force, moment = contact_change(found.force, found.moment)
    return {"angles": found.change, "contact force": force, "contact moment": moment}


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_every_output_has_the_gradient_of_finite_differences(problem: Problem, coupling: str):
    modulus = _modulus(problem).requires_grad_()
    outputs = _outputs(problem, modulus, coupling)
    generator = torch.Generator().manual_seed(7)
    direction = torch.randn(modulus.shape, generator=generator, dtype=DOUBLE) * modulus.detach()
    for name, output in outputs.items():
        weights = torch.randn(output.shape, generator=generator, dtype=DOUBLE)
        (gradient,) = torch.autograd.grad((output * weights).sum(), modulus, retain_graph=True)

        def moved(size: float, name: str = name, weights: torch.Tensor = weights) -> float:
            with torch.no_grad():
                there = _outputs(problem, modulus + size * direction, coupling)
            return float((there[name] * weights).sum())

        slope = (8 * (moved(1e-3) - moved(-1e-3)) - (moved(2e-3) - moved(-2e-3))) / 12e-3
        assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-6), name


def test_in_the_papers_form_loops_and_load_leave_the_limb_in_balance(problem: Problem):
    """Below the joint acts the lower reaction; above it, the load's counterpart included, the opposite."""
    modulus = _modulus(problem)
    response = shell_response(modulus, problem.postures[0].shell, problem.load)
    upper, lower = -response.reactions[:, :3], -response.reactions[:, 6:9]
    above = upper - problem.load.forces
    np.testing.assert_allclose((above + lower).numpy(), 0.0, atol=1e-8)
    found = _predict(problem, modulus, "paper")
    at = np.searchsorted(problem.motion.time.numpy(), problem.domain.time[-1])
    np.testing.assert_allclose(found.force[at].numpy(), lower[-1].numpy(), rtol=1e-9, atol=1e-12)


def test_in_the_papers_form_the_modulus_alone_changes_nothing_but_its_distribution_does(problem: Problem):
    modulus = _modulus(problem)
    once, twice = (_predict(problem, factor * modulus, "paper").change for factor in (1.0, 2.0))
    np.testing.assert_allclose(once.numpy(), twice.numpy(), rtol=1e-8, atol=1e-14)
    other = _predict(problem, _modulus(problem, seed=1), "paper").change
    assert float((other - once).abs().max()) > 1e-3 * float(once.abs().max())


def test_in_the_papers_form_the_moment_follows_from_statics_alone(problem: Problem):
    """The limb above feels the opposite of the limb below, about the same point."""
    modulus = _modulus(problem)
    response = shell_response(modulus, problem.postures[0].shell, problem.load)
    found = _predict(problem, modulus, "paper")
    shell = problem.postures[0].shell
    lower = -response.reactions[-1, 6:].numpy()
    arm = shell.centres[1] / MM_PER_M
    moment = lower[3:] / MM_PER_M + np.cross(arm, lower[:3])
    at = np.searchsorted(problem.motion.time.numpy(), problem.domain.time[-1])
    np.testing.assert_allclose(found.moment[at].numpy(), moment, rtol=1e-8, atol=1e-10)


def test_a_soft_brace_does_nothing_and_a_rigid_one_pins_the_joint(problem: Problem):
    soft = _predict(problem, _modulus(problem, size=1e-9), "stiffness").change
    assert float(soft.abs().max()) < 1e-8
    pinned = _predict(problem, _modulus(problem, size=1e8), "stiffness").change + problem.motion.angles
    late = pinned[5:-5]
    assert float(late.abs().max()) < 0.01 * float(problem.motion.angles.abs().max())


def test_the_spring_restores_what_it_says_in_moment_and_force(problem: Problem):
    """Stiffness coupling: J^T of the wrench is the torque that the response was computed with."""
    modulus = _modulus(problem)
    found = _predict(problem, modulus, "stiffness")
    spring = brace_spring(problem, posture_stiffness(problem, modulus))
    turned = (problem.motion.angles + found.change)[0]
    expected = -torch.diagonal(spring.stiffness[0]) * turned
    torque = problem.motion.jacobian[0, 3:].T @ found.moment[0]
    assert float(problem.motion.angles[0, 0]) * 0.8 < problem.postures[1].flexion
    share = float(problem.motion.angles[0, 0]) / problem.postures[1].flexion
    expected = expected - share * torch.diagonal(spring.stiffness[1] - spring.stiffness[0]) * turned
    np.testing.assert_allclose(torque.numpy(), expected.numpy(), rtol=1e-9)


def test_contact_feels_the_opposite_of_the_brace():
    force, moment = (
        torch.tensor([[0.0, 0.0, 50.0]], dtype=DOUBLE),
        torch.tensor([[1.0, 0.0, 0.0]], dtype=DOUBLE),
    )
    change, turn = contact_change(force, moment, torch.tensor([0.0, -0.15, 0.0], dtype=DOUBLE))
    np.testing.assert_allclose(change.numpy(), [[0.0, 0.0, -50.0]])
    np.testing.assert_allclose(turn.numpy(), [[-1.0 + 0.15 * 50.0, 0.0, 0.0]])
    at_centre = contact_change(force, moment)
    np.testing.assert_allclose(at_centre[1].numpy(), [[-1.0, 0.0, 0.0]])


def test_the_change_of_contact_is_that_of_newton_and_euler():
    """The brace as one more force on the segments below, through the dynamics of the biomechanics stage."""
    random = np.random.default_rng(4)
    frames = 30
    rotations = np.broadcast_to(np.eye(3), (frames, 2, 3, 3))
    origins = np.cumsum(random.standard_normal((frames, 2, 3)), axis=0) * 0.01
    inertias = np.stack([np.diag([0.1, 0.02, 0.1])] * 2)
    segments = momenta(rotations, origins, np.array([3.0, 1.0]), np.zeros((2, 3)), inertias, 100.0)
    centre, point = random.standard_normal((2, frames, 3))
    ground, brace = (GroundReaction(*random.standard_normal((3, frames, 3))) for _ in range(2))
    brace = brace._replace(point=point)
    without = net_load(segments, [0, 1], centre, [ground])
    braced = net_load(segments, [0, 1], centre, [ground, brace])
    force, moment = contact_change(*map(torch.from_numpy, (brace.force, brace.torque, point - centre)))
    np.testing.assert_allclose(force.numpy(), braced.force - without.force, atol=1e-10)
    np.testing.assert_allclose(moment.numpy(), braced.moment - without.moment, atol=1e-10)


def test_both_couplings_and_all_passive_levels_are_predicted(problem: Problem):
    modulus = _modulus(problem)
    found = predict(problem, knee_loads(), brace_response(problem, modulus))
    frames = len(problem.domain.time)
    assert tuple(COUPLINGS) == design.COUPLINGS
    assert found.angle_change.shape == (2, frames, 3)
    assert found.sensitivity.shape == (len(PASSIVE_LEVELS), 2, 3)
    for index, coupling in enumerate(COUPLINGS):
        change = _predict(problem, modulus, coupling).change
        at_five = float(np.abs(found.angle_change[index, :, 1]).max())
        assert found.sensitivity[1, index, 1] == pytest.approx(at_five, rel=1e-9)
        assert (np.diff(found.sensitivity[:, index, 1]) < 0).all()
        np.testing.assert_allclose(found.angle_change[index, -1], change[-1].numpy(), rtol=1e-9)
    np.testing.assert_allclose(found.levels, (2.0, 5.0, 10.0))
    soft, _, firm = (joint_motion(knee_loads(), "knee_l", (0.5, level, 1.5)) for level in found.levels)
    assert float(firm.stiffness[0, 1, 1] / soft.stiffness[0, 1, 1]) == pytest.approx(5.0)


def test_the_settings_choose_the_coupling_of_the_design():
    for coupling in COUPLINGS:
        problem = _problem(coupling=coupling)
        modulus = _modulus(problem)
        change = mechanics_of(problem, modulus).prediction.change
        np.testing.assert_array_equal(change.numpy(), _predict(problem, modulus, coupling).change.numpy())


@pytest.mark.parametrize(
    ("settings", "preserve", "prevent"),
    [
        ({}, (0,), (1,)),
        ({"prevent": ("adduction", "rotation")}, (0,), (1, 2)),
        ({"preserve": ("flexion", "rotation")}, (0, 2), (1,)),
        ({"preserve": (), "prevent": ("rotation",)}, (), (2,)),
    ],
)
def test_angles_to_preserve_and_prevent_are_those_of_the_settings(settings, preserve, prevent):
    problem = _problem(**settings)
    assert (problem.preserve, problem.prevent) == (preserve, prevent)


def test_an_ankle_has_its_own_angles_on_both_sides():
    for side in "rl":
        loads = knee_loads()
        domain = replace(knee_domain(loads, around=16, along=10), joint=f"ankle_{side}")
        settings = OptimizeSettings(preserve=("dorsiflexion",), prevent=("inversion",))
        problem = build_problem(
            loads, domain, settings, MaterialSettings(), PatternSettings(scale=0.08, rim_mm=10.0)
        )
        assert (problem.preserve, problem.prevent) == ((0,), (1,))
        for coupling in COUPLINGS:
            change = _predict(problem, _modulus(problem), coupling).change
            assert bool(torch.isfinite(change).all())
            assert float(change[:, 1].abs().max()) > 0.0
