"""Shapes for frames: the setting's text, clusters, families, and solvers that are shared between shapes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import ConfigError, GeometryError, SolverError
from hilbrace.shell import (
    GeometryMode,
    LoadPattern,
    NodalLoads,
    build_shell,
    cluster_frames,
    element_energies,
    family_response,
    family_wrenches_at,
    geometry_mode,
    joint_line_shares,
    open_pool,
    pose_shell,
    shell_family,
    shell_response,
    wrenches_at,
)
from tests.unit.shell_cases import bent_frames, tube

FRAMES = 9
SHELL = build_shell(*tube(12, 8, 30.0, 90.0, waviness=0.1, window=True), 3.0, 0.45)
POSED = bent_frames(SHELL.vertices, FRAMES)
SHARES = joint_line_shares(SHELL.vertices, SHELL.triangles, 30.0)
ORIGIN = np.zeros(3)
MODES = ("rest", "clusters:3", "frame")


def some_modulus(seed=0):
    return torch.from_numpy(np.random.default_rng(seed).uniform(0.1, 1.0, len(SHELL.triangles)))


def some_load(frames=FRAMES):
    return LoadPattern(SHARES, torch.from_numpy(np.random.default_rng(1).standard_normal((frames, 3))))


# --- the setting


def test_the_three_modes_are_read():
    assert geometry_mode("rest") == GeometryMode("rest")
    assert geometry_mode("frame") == GeometryMode("frame")
    assert geometry_mode("clusters:9") == GeometryMode("clusters", 9)


@pytest.mark.parametrize(
    "text",
    ["", "Rest", "clusters", "clusters:", "clusters:0", "clusters:-1", "clusters:3.5", "frames", "rest "],
)
def test_other_texts_are_refused_by_the_key(text):
    with pytest.raises(ConfigError, match=r"optimize\.geometry") as refusal:
        geometry_mode(text)
    assert "clusters:9" in refusal.value.hint


# --- clusters


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 12), st.integers(2, 30), st.integers(0, 10_000))
def test_clusters_are_a_partition_with_the_frame_nearest_to_each_mean(clusters, frames, seed):
    posed = np.random.default_rng(seed).standard_normal((frames, 4, 3))
    chosen, label = cluster_frames(posed, min(clusters, frames))
    assert len(chosen) == min(clusters, frames) == label.max() + 1
    assert (np.diff(chosen) > 0).all()
    assert np.array_equal(label[chosen], np.arange(len(chosen)))
    flat = posed.reshape(frames, -1)
    means = np.stack([flat[label == k].mean(axis=0) for k in range(len(chosen))])
    distance = np.linalg.norm(flat[:, None] - means, axis=2)
    for k, frame in enumerate(chosen):
        members = np.flatnonzero(label == k)
        assert distance[frame, k] == pytest.approx(distance[members, k].min())
    own = distance[np.arange(frames), label]
    assert (own <= distance.min(axis=1) + 1e-6).all()


def test_clusters_of_a_bending_knee_follow_its_flexion():
    flexion = np.array([0.0, 0.02, 0.04, 0.6, 0.62, 1.2, 1.22, 0.61, 0.01])
    turned = [
        SHELL.vertices @ np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
        for a in flexion
    ]
    chosen, label = cluster_frames(np.stack(turned), 3)
    assert [sorted(np.flatnonzero(label == label[k]).tolist()) for k in (0, 3, 5)] == [
        [0, 1, 2, 8],
        [3, 4, 7],
        [5, 6],
    ]
    assert 7 in chosen  # the middle one of 0.60, 0.61, 0.62


def test_frames_of_one_shape_make_one_cluster():
    posed = np.repeat(POSED[:2], 4, axis=0)
    chosen, label = cluster_frames(posed, 5)
    assert len(chosen) == 2
    assert np.array_equal(label, [0, 0, 0, 0, 1, 1, 1, 1])


# --- families


def test_each_mode_has_the_shapes_it_names():
    rest, three, every = (shell_family(SHELL, POSED, geometry_mode(text)) for text in MODES)
    assert rest.shells == (SHELL,)
    assert not rest.shape_of_frame.any()
    assert len(three.shells) == 3
    chosen, label = cluster_frames(POSED, 3)
    assert np.array_equal(three.shape_of_frame, label)
    for shell, frame in zip(three.shells, chosen, strict=True):
        assert np.array_equal(shell.vertices, POSED[frame])
    assert np.array_equal(every.shape_of_frame, np.arange(FRAMES))
    assert all(shell.numbering is SHELL.numbering for shell in every.shells)


def test_more_clusters_than_frames_are_the_frames():
    family = shell_family(SHELL, POSED, geometry_mode("clusters:50"))
    assert np.array_equal(family.shape_of_frame, np.arange(FRAMES))


def test_shapes_share_what_does_not_depend_on_the_shape():
    one, other = shell_family(SHELL, POSED[:2], geometry_mode("frame")).shells
    assert np.shares_memory(one.refill.indices, other.refill.indices)
    assert np.shares_memory(one.refill.indptr, other.refill.indptr)
    assert one.maps.pairs is other.maps.pairs
    own = (one.vertices, one.thickness_mm, one.loop_motions, one.refill.data, one.maps.force, one.maps.ends)
    per_triangle = sum(part.nbytes for part in own) / len(one.triangles)
    assert per_triangle < 2000  # on this mesh many triangles touch a loop


def test_folded_frame_is_named():
    posed = POSED.copy()
    posed[4] = np.roll(posed[4], 1, axis=0)
    with pytest.raises(GeometryError, match="frame 4"):
        shell_family(SHELL, posed, geometry_mode("frame"))


# --- responses


def test_frames_answer_like_single_shells_of_their_shape():
    modulus, load = some_modulus(), some_load()
    family = shell_family(SHELL, POSED, geometry_mode("frame"))
    answer = family_response(modulus, family, load)
    energies = element_energies(answer)
    for frame in range(FRAMES):
        shell = pose_shell(SHELL, POSED[frame])
        alone = shell_response(modulus, shell, LoadPattern(SHARES, load.forces[frame : frame + 1]))
        torch.testing.assert_close(answer.compliance[frame], alone.compliance[0])
        torch.testing.assert_close(answer.reactions[frame], alone.reactions[0])
        torch.testing.assert_close(answer.loop_stiffness[frame], alone.loop_stiffness)
        torch.testing.assert_close(energies[frame], element_energies(alone)[0])


@pytest.mark.parametrize("mode", MODES)
def test_element_energies_add_up_to_twice_the_compliance(mode):
    answer = family_response(some_modulus(), shell_family(SHELL, POSED, geometry_mode(mode)), some_load())
    torch.testing.assert_close(element_energies(answer).sum(dim=1), 2 * answer.compliance, rtol=1e-10, atol=0)
    assert (element_energies(answer) >= 0).all()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("nodal", [False, True])
def test_reactions_balance_the_loads_in_every_frame(mode, nodal):
    family = shell_family(SHELL, POSED, geometry_mode(mode))
    forces = torch.from_numpy(np.random.default_rng(3).standard_normal((FRAMES, len(SHELL.vertices), 3)))
    load = NodalLoads(forces) if nodal else some_load()
    on_vertices = forces if nodal else torch.from_numpy(SHARES)[None, :, None] * load.forces[:, None, :]
    answer = family_response(some_modulus(), family, load)
    wrenches = family_wrenches_at(answer.reactions, family, ORIGIN)
    for frame, shape in enumerate(family.shape_of_frame):
        shell = family.shells[shape]
        torch.testing.assert_close(wrenches[frame], wrenches_at(answer.reactions, shell, ORIGIN)[frame])
        held = wrenches[frame].numpy().reshape(2, 2, 3).sum(axis=0)
        applied = on_vertices[frame].numpy()
        size = np.abs(applied).sum()
        np.testing.assert_allclose(held[0], -applied.sum(axis=0), atol=1e-10 * size)
        moment = np.cross(shell.vertices, applied).sum(axis=0)
        np.testing.assert_allclose(held[1], -moment, atol=1e-10 * size * 50)


@pytest.mark.parametrize("mode", MODES)
def test_answers_do_not_depend_on_threads_to_the_last_bit(mode):
    family = shell_family(SHELL, POSED, geometry_mode(mode), threads=3)
    alone = shell_family(SHELL, POSED, geometry_mode(mode))
    bits = []
    for threads, shapes in ((1, alone), (2, family), (4, family), (2, family)):
        modulus = some_modulus().requires_grad_()
        with open_pool(SHELL.numbering.sparsity, "scipy" if mode == "rest" else "auto", threads) as pool:
            answer = family_response(modulus, shapes, some_load(), solvers=pool)
            energies = element_energies(answer)
            outputs = (answer.compliance, answer.reactions, answer.loop_stiffness, energies)
            loss = sum(part.square().sum() for part in outputs)
            (gradient,) = torch.autograd.grad(loss, modulus)
        bits.append([part.detach().numpy().tobytes() for part in (*outputs, gradient)])
    assert all(row == bits[0] for row in bits)


# --- solvers


def test_pool_gives_the_same_answers_as_solvers_of_ones_own():
    with open_pool(SHELL.numbering.sparsity, threads=2) as pool:
        for seed in (0, 1, 0):
            ours = shell_response(some_modulus(seed), SHELL, some_load(), solvers=pool)
            alone = shell_response(some_modulus(seed), SHELL, some_load())
            torch.testing.assert_close(ours.compliance, alone.compliance, rtol=1e-10, atol=0)
        posed = pose_shell(SHELL, POSED[3])
        ours = shell_response(some_modulus(), posed, some_load(), solvers=pool)
    torch.testing.assert_close(
        ours.compliance, shell_response(some_modulus(), posed, some_load()).compliance, rtol=1e-10, atol=0
    )


def test_pool_survives_a_job_that_fails():
    def fails(_solver):
        raise SolverError("singular", where="shape 1", hint="none")

    def works(solver):
        return solver.sparsity.size

    with open_pool(SHELL.numbering.sparsity, threads=2) as pool:
        with pytest.raises(SolverError, match="shape 1"):
            pool.run([works, fails, works])
        assert pool.run([works] * 5) == [SHELL.numbering.sparsity.size] * 5
        assert pool.run([]) == []


def test_closed_pool_is_refused_even_for_the_gradient():
    modulus = some_modulus().requires_grad_()
    with open_pool(SHELL.numbering.sparsity) as pool:
        answer = shell_response(modulus, SHELL, some_load(), solvers=pool)
        energies = element_energies(answer)
    with pytest.raises(SolverError, match="closed"):
        shell_response(modulus, SHELL, some_load(), solvers=pool)
    with pytest.raises(SolverError, match="closed"):
        torch.autograd.grad(energies[0, 3], modulus)


def test_pool_of_another_mesh_is_refused():
    other = build_shell(*tube(6, 3, 30.0, 60.0), 3.0, 0.45)
    with (
        open_pool(other.numbering.sparsity) as pool,
        pytest.raises(SolverError, match="another shell"),
    ):
        shell_response(some_modulus(), SHELL, some_load(), solvers=pool)


@pytest.mark.parametrize("threads", [0, -1])
def test_pool_needs_a_thread(threads):
    with pytest.raises(ConfigError, match="threads"):
        open_pool(SHELL.numbering.sparsity, threads=threads)


# --- bad loads


def test_force_that_is_not_finite_names_its_frame():
    load = some_load()
    load.forces[5, 1] = torch.nan
    with pytest.raises(SolverError, match="frame 5"):
        shell_response(some_modulus(), SHELL, load)
    forces = torch.zeros((4, len(SHELL.vertices), 3), dtype=torch.float64)
    forces[2, 7, 0] = torch.inf
    with pytest.raises(SolverError, match="frame 2"):
        shell_response(some_modulus(), SHELL, NodalLoads(forces))


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan")])
def test_thickness_that_is_no_thickness_names_its_triangle(wrong):
    thickness = torch.full((len(SHELL.triangles),), 3.0, dtype=torch.float64)
    thickness[13] = wrong
    with pytest.raises(GeometryError, match="triangle 13"):
        shell_response(some_modulus(), SHELL, some_load(), thickness)


@pytest.mark.malformed
def test_thickness_of_another_mesh_is_refused():
    with pytest.raises(GeometryError, match="thickness of shape"):
        shell_response(some_modulus(), SHELL, some_load(), torch.ones(5, dtype=torch.float64))


def test_gradient_is_that_of_the_modulus_that_was_solved_with():
    modulus, thickness = some_modulus(), torch.full((len(SHELL.triangles),), 3.0, dtype=torch.float64)
    thickness.requires_grad_()
    gradients = []
    for disturb in (1.0, 5.0):
        at = modulus.clone()
        energies = element_energies(shell_response(at, SHELL, some_load(), thickness))
        at *= disturb
        gradients.append(torch.autograd.grad(energies[0, 5], thickness)[0])
    assert torch.equal(*gradients)


def test_share_that_is_not_finite_names_its_vertex():
    shares = SHARES.copy()
    shares[11] = np.nan
    with pytest.raises(SolverError, match="vertex 11"):
        shell_response(some_modulus(), SHELL, LoadPattern(shares, some_load().forces))


@pytest.mark.parametrize(
    "load", [LoadPattern(SHARES[:-1], torch.ones((2, 3))), NodalLoads(torch.ones((2, 5, 3)))]
)
def test_loads_of_another_mesh_are_refused(load):
    with pytest.raises(SolverError, match="loads of shape"):
        shell_response(some_modulus(), SHELL, load)


def test_loads_of_another_motion_are_refused():
    family = shell_family(SHELL, POSED, geometry_mode("frame"))
    with pytest.raises(SolverError, match="9 frames"):
        family_response(some_modulus(), family, some_load(5))


@pytest.mark.parametrize("mode", MODES)
def test_frame_without_finite_positions_is_named_and_not_averaged(mode):
    posed = POSED.copy()
    posed[4, 7, 1] = np.nan
    with pytest.raises(GeometryError, match="frame 4"):
        shell_family(SHELL, posed, geometry_mode(mode))


def test_motion_without_frames_is_refused():
    with pytest.raises(GeometryError, match="no frames"):
        shell_family(SHELL, POSED[:0], geometry_mode("rest"))


def test_no_frames_of_load_give_no_answers():
    answer = shell_response(some_modulus(), SHELL, some_load(0))
    assert answer.compliance.shape == (0,)
    assert answer.loop_stiffness.isfinite().all()
