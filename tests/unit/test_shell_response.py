"""Compliance, reactions and loop stiffness: beam theory, statics, a dense oracle and exact gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import GeometryError, SolverError
from hilbrace.shell import (
    LoadPattern,
    build_shell,
    displacements,
    joint_line_shares,
    joint_stiffness,
    loop_stiffness,
    pose_shell,
    shell_response,
    static_modes,
    wrenches_at,
)
from tests.unit.shell_cases import global_stiffness, tube

SHELL = build_shell(*tube(12, 6, 30.0, 90.0, waviness=0.1, window=True), 3.0, 0.45)
SHARES = joint_line_shares(SHELL.vertices, SHELL.triangles, 30.0)
ORIGIN = np.zeros(3)
OUTPUTS = ("compliance", "reactions", "loop_stiffness")


def some_modulus(seed=0, shell=SHELL):
    return torch.from_numpy(np.random.default_rng(seed).uniform(0.1, 1.0, len(shell.triangles)))


def some_forces(seed=0, frames=4):
    return torch.from_numpy(np.random.default_rng(100 + seed).standard_normal((frames, 3)))


def respond(modulus, forces):
    return shell_response(modulus, SHELL, LoadPattern(SHARES, forces))


# --- an independent way to the same numbers


def test_response_equals_a_dense_solve_of_all_degrees_of_freedom():
    modulus, forces = some_modulus(), some_forces()
    dense = global_stiffness(SHELL, modulus.numpy())
    free, motions = SHELL.numbering.free, SHELL.motions
    clamped = np.setdiff1d(np.arange(len(dense)), free)
    load = np.zeros((len(SHELL.vertices), 5, len(forces)))
    load[:, :3] = SHARES[:, None, None] * forces.numpy().T
    load = load.reshape(-1, len(forces))
    moves = np.zeros_like(load)
    moves[free] = np.linalg.solve(dense[np.ix_(free, free)], load[free])
    inner = np.linalg.solve(dense[np.ix_(free, free)], dense[np.ix_(free, clamped)])
    schur = dense[np.ix_(clamped, clamped)] - dense[np.ix_(clamped, free)] @ inner
    answer = respond(modulus, forces)
    np.testing.assert_allclose(answer.compliance, 0.5 * (load * moves).sum(axis=0), rtol=1e-10)
    reactions = motions.T @ (dense @ moves - load)
    np.testing.assert_allclose(answer.reactions, reactions.T, atol=1e-9 * np.abs(reactions).max())
    stiffness = motions[clamped].T @ schur @ motions[clamped]
    np.testing.assert_allclose(answer.loop_stiffness, stiffness, atol=1e-9 * np.abs(stiffness).max())
    pattern = LoadPattern(SHARES, forces)
    expected = moves.reshape(-1, 5, len(forces))[:, :3].transpose(2, 0, 1)
    np.testing.assert_allclose(
        displacements(modulus.numpy(), SHELL, pattern), expected, atol=1e-9 * moves.max()
    )


def test_reactions_are_the_loads_work_on_the_static_modes():
    modulus, forces = some_modulus(), some_forces()
    modes = static_modes(modulus.numpy(), SHELL).reshape(-1, 5, 12)[:, :3]
    expected = -np.einsum("vca,v,tc->ta", modes, SHARES, forces.numpy())
    np.testing.assert_allclose(respond(modulus, forces).reactions, expected, rtol=1e-10, atol=1e-12)


# --- statics


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_reactions_balance_force_and_moment(seed):
    forces = some_forces(seed)
    response = respond(some_modulus(seed), forces)
    reactions = wrenches_at(response.reactions, SHELL, ORIGIN).numpy().reshape(-1, 2, 2, 3)
    applied = forces.numpy()
    np.testing.assert_allclose(reactions[:, :, 0].sum(axis=1), -applied, atol=1e-9)
    moment = np.cross(SHARES @ SHELL.vertices, applied)
    np.testing.assert_allclose(reactions[:, :, 1].sum(axis=1), -moment, atol=1e-8)


def test_loop_stiffness_has_exactly_six_rigid_motions():
    stiffness = loop_stiffness(some_modulus(), SHELL).numpy()
    values = np.linalg.eigvalsh(stiffness)
    assert np.abs(values[:6]).max() < 1e-12 * values[-1]
    assert values[6] > 1e-6 * values[-1]
    together = np.zeros((12, 6))
    for side in range(2):
        together[6 * side : 6 * side + 3, :3] = np.eye(3)
        together[6 * side : 6 * side + 3, 3:] = np.cross(np.eye(3), SHELL.centres[side]).T
        together[6 * side + 3 : 6 * side + 6, 3:] = np.eye(3)
    assert np.abs(stiffness @ together).max() < 1e-11 * np.abs(stiffness).max()


@settings(max_examples=20, deadline=None)
@given(st.floats(0.01, 100.0), st.integers(0, 1000))
def test_scaling_the_modulus_scales_the_stiffness_and_leaves_the_reactions(factor, seed):
    modulus, forces = some_modulus(seed), some_forces(seed)
    one, other = respond(modulus, forces), respond(factor * modulus, forces)
    torch.testing.assert_close(other.compliance, one.compliance / factor, rtol=1e-9, atol=0)
    torch.testing.assert_close(other.reactions, one.reactions, rtol=1e-8, atol=1e-9)
    torch.testing.assert_close(
        other.loop_stiffness, factor * one.loop_stiffness, rtol=1e-8, atol=1e-9 * factor
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_more_material_never_softens_the_brace(seed):
    modulus, forces = some_modulus(seed), some_forces(seed)
    more = modulus + some_modulus(seed + 1) * (some_modulus(seed + 2) > 0.7)
    before, after = respond(modulus, forces), respond(more, forces)
    assert (after.compliance <= before.compliance * (1 + 1e-9)).all()
    gain = np.linalg.eigvalsh((after.loop_stiffness - before.loop_stiffness).numpy())
    assert gain[0] > -1e-9 * gain[-1]


def test_response_does_not_depend_on_the_frame_of_reference():
    modulus = some_modulus()
    turn, _ = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    moved = pose_shell(SHELL, SHELL.vertices @ turn.T + [10.0, -20.0, 5.0])
    here = respond(modulus, some_forces())
    there = shell_response(modulus, moved, LoadPattern(SHARES, some_forces() @ torch.from_numpy(turn.T)))
    torch.testing.assert_close(there.compliance, here.compliance, rtol=1e-9, atol=0)
    axes, centre = np.eye(3), np.array([1.0, 2.0, 3.0])
    stiff = joint_stiffness(here.loop_stiffness, SHELL, axes, centre)
    moved_centre = turn @ centre + [10.0, -20.0, 5.0]
    torch.testing.assert_close(
        joint_stiffness(there.loop_stiffness, moved, axes @ turn.T, moved_centre), stiff
    )


# --- beam theory: a straight tube with rigid ends, E = 1.15 MPa, Poisson's ratio 0 (ends do not disturb it)

RADIUS, LENGTH, THICKNESS, MODULUS = 40.0, 240.0, 2.0, 1.15
AREA = 2 * np.pi * RADIUS * THICKNESS
INERTIA = np.pi * RADIUS**3 * THICKNESS


@pytest.fixture(scope="module")
def beam():
    shell = build_shell(*tube(48, 45, RADIUS, LENGTH), THICKNESS, 0.0)
    modulus = torch.full((len(shell.triangles),), MODULUS, dtype=torch.float64)
    return shell, loop_stiffness(modulus, shell).numpy()


def test_straight_tube_stretches_like_a_bar(beam):
    assert beam[1][7, 7] == pytest.approx(MODULUS * AREA / LENGTH, rel=0.01)


def test_straight_tube_bends_and_twists_like_a_beam(beam):
    about_middle = joint_stiffness(torch.from_numpy(beam[1]), beam[0], np.eye(3), ORIGIN).numpy()
    bending = MODULUS * INERTIA / LENGTH
    torsion = 0.5 * MODULUS * 2 * INERTIA / LENGTH
    np.testing.assert_allclose(np.diag(about_middle), [bending, torsion, bending], rtol=0.015)
    np.testing.assert_allclose(about_middle, np.diag(np.diag(about_middle)), atol=1e-3 * bending)


def test_straight_tube_shears_like_a_timoshenko_beam(beam):
    shear_area = 0.5 * AREA  # thin tube
    softening = 12 * MODULUS * INERTIA / (0.5 * MODULUS * shear_area * LENGTH**2)
    expected = 12 * MODULUS * INERTIA / LENGTH**3 / (1 + softening)
    assert beam[1][6, 6] == pytest.approx(expected, rel=0.02)
    assert beam[1][8, 8] == pytest.approx(expected, rel=0.02)


def test_turning_about_a_distant_centre_adds_the_shear_of_the_offset(beam):
    centre = np.array([0.0, 30.0, 0.0])
    shifted = joint_stiffness(torch.from_numpy(beam[1]), beam[0], np.array([[1.0, 0.0, 0.0]]), centre).item()
    middle = joint_stiffness(torch.from_numpy(beam[1]), beam[0], np.eye(3)[:1], ORIGIN).item()
    assert shifted == pytest.approx(middle + 30.0**2 * beam[1][8, 8], rel=1e-6)


# --- gradients


@pytest.mark.parametrize("output", OUTPUTS)
def test_jacobian_by_the_modulus_matches_finite_differences(output):
    forces = some_forces(frames=2)
    shell = build_shell(*tube(6, 3, 30.0, 60.0, waviness=0.1), 3.0, 0.45)
    load = LoadPattern(joint_line_shares(shell.vertices, shell.triangles, 30.0), forces)

    def outputs(modulus):
        return getattr(shell_response(modulus, shell, load), output).reshape(-1)

    modulus = some_modulus(shell=shell)
    ours = torch.autograd.functional.jacobian(outputs, modulus).numpy()
    step = 3e-5
    columns = []
    for element in range(len(modulus)):
        nudge = torch.zeros_like(modulus)
        nudge[element] = step
        columns.append((outputs(modulus + nudge) - outputs(modulus - nudge)).numpy() / (2 * step))
    expected = np.stack(columns, axis=1)
    assert ours.shape == expected.shape
    np.testing.assert_allclose(ours, expected, atol=1e-6 * np.abs(expected).max())


def test_jacobian_by_the_forces_matches_finite_differences():
    modulus = some_modulus()

    def outputs(forces):
        answer = respond(modulus, forces)
        return torch.cat([answer.compliance.reshape(-1), answer.reactions.reshape(-1)])

    assert torch.autograd.gradcheck(
        outputs, some_forces(frames=2).requires_grad_(), eps=1e-4, rtol=1e-6, atol=1e-7
    )


@pytest.mark.parametrize("output", OUTPUTS)
def test_taylor_remainder_falls_with_the_square_of_the_step(output):
    modulus, forces = some_modulus().requires_grad_(), some_forces()
    rng = np.random.default_rng(8)
    weight = torch.from_numpy(rng.standard_normal(getattr(respond(modulus, forces), output).shape))

    def loss(at):
        return (weight * torch.tanh(getattr(respond(at, forces), output) / 10)).sum()

    direction = torch.from_numpy(rng.uniform(-0.5, 0.5, len(modulus))) * modulus.detach()
    start = loss(modulus)
    (gradient,) = torch.autograd.grad(start, modulus)
    steps = np.array([0.08, 0.04, 0.02, 0.01])
    remainder = [
        abs((loss(modulus + h * direction) - start - h * gradient @ direction).item()) for h in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(remainder), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.1)


def test_gradient_of_a_p_norm_through_all_outputs():
    modulus, forces = some_modulus().requires_grad_(), some_forces().requires_grad_()
    scale = respond(modulus, forces).compliance.max().detach()

    def loss(at, under):
        answer = respond(at, under)
        worst = ((answer.compliance / scale) ** 20).sum() ** (1 / 20)
        spring = torch.diagonal(joint_stiffness(answer.loop_stiffness, SHELL, np.eye(3), ORIGIN))
        return worst + answer.reactions.square().sum().sqrt() + (spring[0] / spring[2]).log()

    by_modulus, by_forces = torch.autograd.grad(loss(modulus, forces), [modulus, forces])
    rng = np.random.default_rng(9)
    along = torch.from_numpy(rng.standard_normal(len(modulus))) * modulus.detach()
    push = torch.from_numpy(rng.standard_normal(forces.shape))
    step = 1e-5
    with torch.no_grad():
        measured = (loss(modulus + step * along, forces) - loss(modulus - step * along, forces)) / (2 * step)
        pushed = (loss(modulus, forces + step * push) - loss(modulus, forces - step * push)) / (2 * step)
    assert (by_modulus @ along).item() == pytest.approx(measured.item(), rel=1e-6)
    assert (by_forces * push).sum().item() == pytest.approx(pushed.item(), rel=1e-6)


def test_loop_stiffness_alone_is_that_of_the_full_response():
    modulus = some_modulus().requires_grad_()
    alone = loop_stiffness(modulus, SHELL)
    full = respond(modulus, some_forces()).loop_stiffness
    torch.testing.assert_close(alone, full, rtol=1e-10, atol=1e-10)
    (by_alone,) = torch.autograd.grad(alone[3, 9], modulus)
    (by_full,) = torch.autograd.grad(full[3, 9], modulus)
    torch.testing.assert_close(by_alone, by_full, rtol=1e-8, atol=1e-10)


def test_same_input_gives_the_same_bytes():
    modulus, forces = some_modulus(), some_forces()
    one, other = respond(modulus, forces), respond(modulus, forces)
    for output in OUTPUTS:
        assert getattr(one, output).numpy().tobytes() == getattr(other, output).numpy().tobytes()


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf")])
def test_modulus_must_be_positive_and_finite(wrong):
    modulus = some_modulus()
    modulus[17] = wrong
    with pytest.raises(SolverError, match="triangle 17"):
        respond(modulus, some_forces())


def test_modulus_of_another_mesh_is_refused():
    with pytest.raises(SolverError, match="modulus of shape"):
        respond(some_modulus()[:-1], some_forces())


def test_vertices_of_single_precision_balance_to_double():
    vertices, triangles, upper, lower = tube(12, 6, 30.0, 90.0, waviness=0.1)
    shell = build_shell(vertices.astype(np.float32), triangles, upper, lower, 3.0, 0.45)
    values = np.linalg.eigvalsh(loop_stiffness(some_modulus(shell=shell), shell).numpy())
    assert np.abs(values[:6]).max() < 1e-12 * values[-1]
    load = LoadPattern(joint_line_shares(shell.vertices, triangles, 30.0), some_forces())
    reactions = shell_response(some_modulus(shell=shell), shell, load).reactions
    held = wrenches_at(reactions, shell, ORIGIN).numpy().reshape(-1, 2, 2, 3).sum(axis=1)
    np.testing.assert_allclose(held[:, 0], -some_forces().numpy(), atol=1e-10)


@pytest.mark.parametrize("centre", [np.full(3, np.nan), np.zeros(2), np.array([0.0, np.inf, 0.0])])
def test_joint_centre_must_be_a_point(centre):
    stiffness = loop_stiffness(some_modulus(), SHELL)
    with pytest.raises(GeometryError, match="no point"):
        joint_stiffness(stiffness, SHELL, np.eye(3), centre)
    with pytest.raises(GeometryError, match="no point"):
        wrenches_at(respond(some_modulus(), some_forces()).reactions, SHELL, centre)
    with pytest.raises(GeometryError, match="axes"):
        joint_stiffness(stiffness, SHELL, np.full((1, 3), np.nan), ORIGIN)
