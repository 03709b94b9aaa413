"""Directors, numbering and refill of the shell, and the surfaces that it refuses."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hilbrace.errors import GeometryError, HilbraceError, SolverError
from hilbrace.shell import build_shell, loop_stiffness, pose_shell
from hilbrace.shell.assembly import free_stiffness
from hilbrace.shell.directors import nodal_directors, tangent_basis, triangle_normals
from hilbrace.shell.loads import joint_line_shares
from hilbrace.shell.maps import assemble
from hilbrace.shell.model import unit_stiffness
from hilbrace.shell.section import orthotropic
from tests.unit.shell_cases import global_stiffness, grid, tube

TUBE = tube(10, 5, 30.0, 80.0, waviness=0.1)


def small_shell():
    return build_shell(*TUBE, 4.0, 0.45)


def test_directors_of_a_cylinder_point_along_its_radius():
    vertices, triangles, _, _ = tube(48, 20, 50.0, 120.0)
    inner = np.abs(vertices[:, 1]) < 59
    radius = vertices * [1, 0, 1] / 50.0
    np.testing.assert_allclose(nodal_directors(vertices, triangles)[inner], radius[inner], atol=1e-12)


@pytest.mark.parametrize("flip", range(8))
def test_director_of_a_cubes_corner_does_not_see_how_its_faces_are_split(flip):
    # Each face has one triangle at the corner or two, by its diagonal; the director is (1, 1, 1) either way.
    corner, opposite = np.zeros(3), -np.ones(3)
    vertices = np.vstack([corner, np.eye(3) + opposite, -np.eye(3)])
    triangles = []
    for axis in range(3):
        first, second, across = 4 + (axis + 1) % 3, 4 + (axis + 2) % 3, 1 + axis
        halves = [[0, first, second], [first, across, second]]
        if flip >> axis & 1:
            halves = [[0, first, across], [0, across, second]]
        triangles += halves
    director = nodal_directors(vertices, np.array(triangles))[0]
    np.testing.assert_allclose(director, np.full(3, 1 / np.sqrt(3)), atol=1e-14)


def test_tangents_make_right_handed_frames_with_every_director():
    directors = np.vstack([np.eye(3), -np.eye(3), nodal_directors(*TUBE[:2])])
    first, second = np.moveaxis(tangent_basis(directors), 1, 0)
    np.testing.assert_allclose(np.cross(first, second), directors, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(first, axis=1), 1.0, atol=1e-14)


def test_area_of_a_tube():
    vertices, triangles, _, _ = tube(64, 10, 50.0, 120.0)
    _, area = triangle_normals(vertices, triangles)
    assert area.sum() == pytest.approx(2 * np.pi * 50 * 120, rel=2e-3)


def test_refill_equals_dense_assembly():
    shell = small_shell()
    modulus = np.random.default_rng(0).uniform(0.1, 2.0, len(shell.triangles))
    dense = global_stiffness(shell, modulus)
    free = shell.numbering.free
    sparse = free_stiffness(shell.numbering, shell.refill, modulus).toarray()
    np.testing.assert_allclose(sparse, dense[np.ix_(free, free)], atol=1e-13 * np.abs(dense).max())
    part = assemble(shell.numbering, shell.maps, modulus)
    pull = dense @ shell.motions
    np.testing.assert_allclose(part.coupling, pull[free], atol=1e-12 * np.abs(pull).max())
    ends = shell.motions.T @ pull
    np.testing.assert_allclose(part.ends, ends, atol=1e-12 * np.abs(ends).max())


def test_clamped_loops_have_no_equations():
    shell = small_shell()
    loops = np.concatenate([shell.upper_loop, shell.lower_loop])
    clamped = np.setdiff1d(np.arange(5 * len(shell.vertices)), shell.numbering.free)
    assert np.array_equal(np.unique(clamped // 5), np.sort(loops))
    assert not shell.motions[shell.numbering.free].any()


def test_posed_shell_equals_one_built_from_its_shape():
    vertices, triangles, upper, lower = TUBE
    bent = vertices + np.column_stack([0.002 * vertices[:, 1] ** 2, 0 * vertices[:, :2]])
    posed = pose_shell(small_shell(), bent)
    built = build_shell(bent, triangles, upper, lower, 4.0, 0.45)
    assert np.array_equal(unit_stiffness(posed), unit_stiffness(built))
    assert np.array_equal(posed.refill.data, built.refill.data)
    assert np.array_equal(posed.maps.force, built.maps.force)
    assert np.array_equal(posed.loop_motions, built.loop_motions)


def test_material_directions_turn_with_the_shell():
    vertices, triangles, upper, lower = TUBE
    membrane = np.diag([1.0, 0.2, 0.1])[None]
    up = np.array([[0.0, 1.0, 0.0]])
    turn, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    shell = build_shell(vertices, triangles, upper, lower, 4.0, orthotropic(membrane, up))
    posed = pose_shell(shell, vertices @ turn.T)
    built = build_shell(vertices @ turn.T, triangles, upper, lower, 4.0, orthotropic(membrane, up @ turn.T))
    assert posed.section.directions is not None
    modulus = torch.ones(len(triangles), dtype=torch.float64)
    here, there = loop_stiffness(modulus, posed), loop_stiffness(modulus, built)
    torch.testing.assert_close(here, there, rtol=1e-9, atol=1e-9 * there.abs().max().item())
    unturned = build_shell(vertices @ turn.T, triangles, upper, lower, 4.0, orthotropic(membrane, up))
    assert (loop_stiffness(modulus, unturned) - there).abs().max() > 0.05 * there.abs().max()


def loose_vertex():
    vertices, *rest = TUBE
    return np.vstack([vertices, [0.0, 0.0, 0.0]]), *rest


def floating_part():
    vertices, triangles, upper, lower = TUBE
    island = np.array([[0, 0, 0], [5, 0, 0], [0, 0, 5.0]])
    return np.vstack([vertices, island]), np.vstack([triangles, len(vertices) + np.arange(3)]), upper, lower


def flap_on_one_vertex():
    vertices, triangles, upper, lower = TUBE
    tips = vertices[25] * 1.2 + np.array([[0, 3, 0], [0, -3, 0.0]])
    flap = [[25, len(vertices), len(vertices) + 1]]
    return np.vstack([vertices, tips]), np.vstack([triangles, flap]), upper, lower


def flat_triangle():
    vertices, triangles, upper, lower = TUBE
    return vertices, np.vstack([triangles, [20, 21, 21]]), upper, lower


def mixed_orientation():
    vertices, triangles, upper, lower = TUBE
    return vertices, np.vstack([triangles[:40, ::-1], triangles[40:]]), upper, lower


def lost_position():
    vertices, *rest = TUBE
    return np.where(np.arange(len(vertices))[:, None] == 7, np.nan, vertices), *rest


def touching_loops():
    vertices, triangles, upper, _ = TUBE
    return vertices, triangles, upper, upper[:5]


def short_loop():
    vertices, triangles, upper, lower = TUBE
    return vertices, triangles, upper, lower[:2]


REFUSED = [
    (loose_vertex, SolverError, "vertex 60"),
    (floating_part, SolverError, "triangle 100"),
    (flap_on_one_vertex, SolverError, "triangle 100"),
    (flat_triangle, GeometryError, "triangle 100"),
    (mixed_orientation, GeometryError, "the same way"),
    (lost_position, GeometryError, "vertex 7"),
    (touching_loops, GeometryError, "both loops"),
    (short_loop, GeometryError, "lower loop"),
]


@pytest.mark.parametrize(("surface", "kind", "named"), REFUSED)
def test_surfaces_that_make_no_shell_are_refused_by_name(surface, kind, named):
    with pytest.raises(HilbraceError, match=named) as refusal:
        build_shell(*surface(), 4.0, 0.45)
    assert refusal.type is kind


@pytest.mark.parametrize(("thickness", "poisson"), [(0.0, 0.45), (4.0, 0.5), (np.nan, 0.3)])
def test_thickness_and_poisson_ratio_are_checked(thickness, poisson):
    with pytest.raises(GeometryError, match="thickness" if poisson < 0.5 else "Poisson"):
        build_shell(*TUBE, thickness, poisson)


def test_posing_another_mesh_is_refused():
    with pytest.raises(GeometryError, match="posed vertices"):
        pose_shell(small_shell(), TUBE[0][:-1])


def test_shares_sum_to_one_and_follow_the_gaussian_window():
    vertices, triangles, _, _ = tube(40, 80, 50.0, 400.0)
    shares = joint_line_shares(vertices, triangles, 40.0, centre=np.array([3.0, 25.0, 0.0]))
    assert shares.sum() == pytest.approx(1.0, abs=1e-15)
    height = vertices[:, 1] - 25.0
    assert shares @ height == pytest.approx(0.0, abs=1e-3)
    assert shares @ height**2 == pytest.approx(40.0**2 / 2, rel=1e-2)


def test_shares_do_not_depend_on_where_the_mesh_is_fine():
    u, v, triangles = grid(20, 40, rising=True)
    for power in (1.0, 1.6):
        flat = np.stack([30 * u, 200 * (v**power - 0.5), 0 * u], axis=1)
        shares = joint_line_shares(flat, triangles, 30.0)
        assert shares @ flat[:, 1] ** 2 == pytest.approx(450.0, rel=0.02)


def test_load_far_from_the_brace_is_refused():
    with pytest.raises(GeometryError, match="joint line"):
        joint_line_shares(TUBE[0], TUBE[1], 10.0, centre=np.array([0.0, 500.0, 0.0]))


@pytest.mark.parametrize("window", [0.0, -10.0, np.nan])
def test_window_without_width_is_refused(window):
    with pytest.raises(GeometryError, match="window of"):
        joint_line_shares(TUBE[0], TUBE[1], window)


def test_axis_without_length_is_refused():
    with pytest.raises(GeometryError, match="axis of length 0"):
        joint_line_shares(TUBE[0], TUBE[1], 10.0, axis=np.zeros(3))


def test_brace_in_metres_is_told_the_unit():
    with pytest.raises(GeometryError, match="within the thickness") as caught:
        build_shell(TUBE[0] / 1000.0, *TUBE[1:], 4.0, 0.45)
    assert "mm" in caught.value.hint
