"""Sections of the wall: the isotropic case, strips of laminate by closed form, and what makes no section."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.errors import GeometryError
from hilbrace.shell import build_shell, loop_stiffness
from hilbrace.shell.directors import nodal_directors, tangent_basis
from hilbrace.shell.element import element_stiffness, element_stiffness_and_slope
from hilbrace.shell.section import (
    Section,
    isotropic,
    map_directions,
    map_rotations,
    orthotropic,
    section_roots,
)
from tests.unit.shell_benchmarks import TURN_X, TURN_Y, TURN_Z, Problem, X, Y, Z
from tests.unit.shell_cases import grid, tube


def tube_elements(bend=0.15):
    vertices, triangles, _, _ = tube(14, 8, 30.0, 70.0, waviness=bend)
    directors = nodal_directors(vertices, triangles)
    return vertices[triangles], directors[triangles], tangent_basis(directors)[triangles]


def some_directions(count, seed=0):
    return np.random.default_rng(seed).standard_normal((count, 3))


def lamina(young_1=1.0, young_2=0.2, poisson_12=0.3, shear=0.15):
    """Plane-stress stiffness in the material axes (11, 22, 12)."""
    compliance = np.diag([1 / young_1, 1 / young_2, 1 / shear])
    compliance[0, 1] = compliance[1, 0] = -poisson_12 / young_1
    return np.linalg.inv(compliance)


def turned_strain(angle):
    """Matrix from (11, 22, 2*12) to the same strain in axes turned by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]])


def turned(section, angle):
    """The same wall described in material axes that are turned by an angle about the director."""
    back = turned_strain(-angle)
    c, s = np.cos(angle), np.sin(angle)
    shear = np.array([[c, -s], [s, c]])
    return Section(
        back.T @ section.membrane @ back,
        back.T @ section.bending @ back,
        shear.T @ section.shear @ shear,
    )


# --- the isotropic case


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45])
def test_equal_matrices_in_any_directions_make_the_isotropic_element(poisson):
    # Exact on curved elements too: with equal matrices the coupling of bending and membrane by the
    # curvature has only one value.
    corners, directors, tangents = tube_elements()
    thickness = np.random.default_rng(1).uniform(2.0, 5.0, len(corners))
    plain = isotropic(poisson)
    given = Section(plain.membrane, plain.bending.copy(), plain.shear, some_directions(len(corners)))
    expected = element_stiffness(corners, directors, tangents, thickness, plain)
    ours = element_stiffness(corners, directors, tangents, thickness, given)
    np.testing.assert_allclose(ours, expected, atol=1e-13 * np.abs(expected).max())


def test_left_out_matrices_are_those_of_a_wall_that_is_alike_through_its_thickness():
    section = orthotropic(lamina()[None], some_directions(1))
    assert section.bending is section.membrane
    np.testing.assert_allclose(section.shear[0], 0.15 * np.eye(2), rtol=1e-14)


def test_roots_square_to_the_matrices():
    section = orthotropic(lamina()[None], some_directions(1), 0.3 * lamina(0.7)[None])
    roots = section_roots(section)
    both = roots.mean[..., 0] + roots.difference[..., 0], roots.mean[..., 0] - roots.difference[..., 0]
    for root, matrix in zip(both, (section.membrane, section.bending), strict=True):
        np.testing.assert_allclose(root.T @ root, matrix[0], rtol=1e-13, atol=1e-15)


# --- a strip of lamina, cut at an angle: classical compliance transformation

ANGLES = np.deg2rad([0.0, 30.0, 45.0, 90.0, 127.0])
THICKNESS, LENGTH, WIDTH, MODULUS = 0.4, 6.0, 2.0, 3.0
MEMBRANE, BENDING = lamina(), 0.4 * lamina(0.6, 0.5, 0.1, 0.3)


def strip(angle):
    """A free strip along x with material axis 1 at an angle to it, irregular mesh."""
    u, v, triangles = grid(6, 3, rising=True)
    inside = (u > 0) & (u < 1) & (v > 0) & (v < 1)
    moved = 0.06 * np.random.default_rng(2).standard_normal((len(u), 2)) * inside[:, None]
    flat = np.column_stack([LENGTH * u + moved[:, 0], WIDTH * v + moved[:, 1], 0 * u])
    direction = np.array([[np.cos(angle), np.sin(angle), 0.7]])  # the part along the director does not count
    section = orthotropic(MEMBRANE[None], direction, BENDING[None])
    up = np.tile([0.0, 0.0, 1.0], (len(u), 1))
    return Problem(flat, triangles, up, THICKNESS, MODULUS, section), u, v


def pull_ends(case, u, v, axis, per_width):
    """Equal and opposite loads per width on both ends, as linear edges carry them."""
    for end, sign in ((u == 0, -1.0), (u == 1, 1.0)):
        share = np.where((v == 0) | (v == 1), 0.5, 1.0) * WIDTH / 3
        case.load[end, axis] = sign * per_width * share[end]


@pytest.mark.parametrize("angle", ANGLES)
def test_strip_in_tension_follows_the_transformed_compliance(angle):
    case, u, v = strip(angle)
    pull_ends(case, u, v, X, per_width=1.0)
    origin = (u == 0) & (v == 0)
    case.hold(origin, (X, Y, Z, TURN_X, TURN_Y, TURN_Z))
    case.hold((u == 0) & (v == 1), (X,))
    case.hold(np.ones(len(u), bool), (Z, TURN_Z))
    moves = case.solve()
    turn = turned_strain(angle)
    compliance = np.linalg.inv(turn.T @ MEMBRANE @ turn) / (MODULUS * THICKNESS)
    stretch, narrowing, shear = compliance[:, 0]
    # Textbook form, Jones, Mechanics of Composite Materials: 1/E_x of a lamina under an angle.
    c, s = np.cos(angle), np.sin(angle)
    textbook = c**4 + s**4 / 0.2 + c**2 * s**2 * (1 / 0.15 - 2 * 0.3)
    assert stretch * MODULUS * THICKNESS == pytest.approx(textbook, rel=1e-12)
    x, y, _ = case.vertices.T
    np.testing.assert_allclose(moves[:, X], stretch * x, atol=1e-11)
    np.testing.assert_allclose(moves[:, Y], narrowing * y + shear * x, atol=1e-11)


@pytest.mark.parametrize("angle", ANGLES)
def test_strip_in_bending_follows_the_transformed_compliance(angle):
    case, u, v = strip(angle)
    moment = 0.3
    pull_ends(case, u, v, TURN_Y, per_width=moment)
    case.hold((u == 0) & (v == 0), range(6))
    case.hold(np.ones(len(u), bool), (X, Y, TURN_Z))
    moves = case.solve()
    turn = turned_strain(angle)
    compliance = np.linalg.inv(turn.T @ BENDING @ turn) * 12 / (MODULUS * THICKNESS**3)
    # Curvatures of the rotations of the director: k11 = d(turn_y)/dx, k22 = -d(turn_x)/dy, 2 k12 the sum.
    k11, k22, k12 = compliance[:, 0] * moment
    x, y, _ = case.vertices.T
    expected = -0.5 * (k11 * x**2 + k22 * y**2 + k12 * x * y)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(moves[:, Z], expected, atol=1e-10 * scale)
    np.testing.assert_allclose(moves[:, TURN_Y], k11 * x + 0.5 * k12 * y, atol=1e-10 * scale)
    np.testing.assert_allclose(moves[:, TURN_X], -k22 * y - 0.5 * k12 * x, atol=1e-10 * scale)


@pytest.mark.parametrize("along_axis", [True, False])
def test_fibres_along_or_around_a_tube_make_it_a_beam_of_their_modulus(along_axis):
    # Bar and torsion of a thin tube with rigid ends; Poisson's ratio 0, so that the ends do not disturb it.
    radius, length, thickness, modulus = 40.0, 240.0, 2.0, 1.15
    surface = tube(40, 36, radius, length)
    corners = surface[0][surface[1]]
    around = np.cross(corners.mean(axis=1), [0.0, 1.0, 0.0])
    directions = np.array([[0.0, 1.0, 0.0]]) if along_axis else around
    wall = lamina(young_1=1.0, young_2=0.1, poisson_12=0.0, shear=0.07)
    shell = build_shell(*surface, thickness, orthotropic(wall[None], directions))
    answer = loop_stiffness(torch.full((len(corners),), modulus, dtype=torch.float64), shell).numpy()
    area = 2 * np.pi * radius * thickness
    young = 1.0 if along_axis else 0.1
    assert answer[7, 7] == pytest.approx(modulus * young * area / length, rel=0.01)
    assert answer[10, 10] == pytest.approx(modulus * 0.07 * area * radius**2 / length, rel=0.015)


# --- invariance


def any_wall(seed):
    """Positive definite matrices without any symmetry between membrane and bending."""
    rng = np.random.default_rng(seed)
    parts = [rng.standard_normal((size, size)) for size in (3, 3, 2)]
    return Section(*((part @ part.T + 0.1 * np.eye(len(part)))[None] for part in parts))


def same_in_other_axes(corners, directors, wall, along, ahead, angle):
    """Both descriptions of one wall must give the same element."""
    other = turned(wall, angle)
    one = Section(wall.membrane, wall.bending, wall.shear, along)
    two = Section(other.membrane, other.bending, other.shear, ahead)
    thickness, tangents = np.full(len(corners), 3.0), tangent_basis(directors)
    expected = element_stiffness(corners, directors, tangents, thickness, one)
    ours = element_stiffness(corners, directors, tangents, thickness, two)
    np.testing.assert_allclose(ours, expected, atol=1e-11 * np.abs(expected).max())


CORNERS = tube_elements()[0]
CYLINDER = tube_elements(bend=0.0)[0]


@given(st.floats(-3.0, 3.0), st.integers(0, 1000))
def test_flat_wall_does_not_know_the_axes_that_it_is_described_in(angle, seed):
    corners = CORNERS[seed % 50 :: 50]
    along = corners[:, 1] - corners[:, 0]
    normal = np.cross(along, corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    ahead = np.cos(angle) * along + np.sin(angle) * np.cross(normal, along)
    upright = np.repeat(normal[:, None], 3, axis=1)
    same_in_other_axes(corners, upright, any_wall(seed), along, ahead, angle)


@given(st.integers(0, 1000))
def test_cylinder_does_not_know_whether_axis_one_runs_along_or_around_it(seed):
    # On a cylinder the projections of these two directions are a quarter turn apart wherever one looks.
    corners = CYLINDER[seed % 30 :: 30]
    directors = corners * [1.0, 0.0, 1.0] / 30.0
    along = np.broadcast_to([0.0, 1.0, 0.0], (len(corners), 3))
    around = np.cross(directors.mean(axis=1), along)
    same_in_other_axes(corners, directors, any_wall(seed), along, around, np.pi / 2)


def test_half_a_turn_of_the_axes_changes_nothing_on_a_curved_wall():
    corners, directors, tangents = tube_elements()
    along = some_directions(len(corners))
    thickness = np.full(len(corners), 4.0)
    one, two = (orthotropic(MEMBRANE[None], sign * along, BENDING[None]) for sign in (1.0, -2.5))
    expected = element_stiffness(corners, directors, tangents, thickness, one)
    ours = element_stiffness(corners, directors, tangents, thickness, two)
    np.testing.assert_allclose(ours, expected, atol=1e-13 * np.abs(expected).max())


def test_one_section_for_all_is_that_section_for_each():
    corners, directors, tangents = tube_elements()
    count = len(corners)
    along, thickness = some_directions(count), np.full(count, 4.0)
    one = orthotropic(MEMBRANE[None], along, BENDING[None])
    each = orthotropic(np.repeat(MEMBRANE[None], count, 0), along, np.repeat(BENDING[None], count, 0))
    expected = element_stiffness(corners, directors, tangents, thickness, one)
    ours = element_stiffness(corners, directors, tangents, thickness, each)
    np.testing.assert_allclose(ours, expected, atol=1e-14 * np.abs(expected).max())
    part = Section(each.membrane[3:4], each.bending[3:4], each.shear[3:4], along[3:4])
    alone = element_stiffness(corners[3:4], directors[3:4], tangents[3:4], thickness[3:4], part)
    np.testing.assert_allclose(alone[0], expected[3], atol=1e-13 * np.abs(expected[3]).max())


def test_curved_orthotropic_wall_is_stiff_against_everything_but_rigid_motions():
    corners, directors, tangents = tube_elements()
    # Far softer in bending than in membrane, and thick: the coupling must not make it lose its definiteness.
    section = orthotropic(MEMBRANE[None], some_directions(len(corners)), 1e-4 * BENDING[None])
    matrices = element_stiffness(corners, directors, tangents, np.full(len(corners), 9.0), section)
    values = np.linalg.eigvalsh(matrices)
    assert np.abs(values[:, :6]).max() < 1e-12 * values.max()
    assert (values[:, 6] > 1e-10 * values[:, -1]).all()


# --- derivative by the thickness


@pytest.mark.parametrize("kind", ["isotropic", "orthotropic"])
def test_slope_by_thickness_matches_finite_differences(kind):
    corners, directors, tangents = tube_elements()
    count = len(corners)
    section = isotropic(0.45)
    if kind == "orthotropic":
        section = orthotropic(MEMBRANE[None], some_directions(count), BENDING[None])
    thickness = np.random.default_rng(3).uniform(2.0, 5.0, count)

    def at(factor):
        return element_stiffness(corners, directors, tangents, factor * thickness, section)

    value, slope = element_stiffness_and_slope(corners, directors, tangents, thickness, section)
    np.testing.assert_allclose(value, at(1.0), atol=1e-14 * np.abs(value).max())
    assert np.array_equal(slope, slope.transpose(0, 2, 1))
    # Central differences of order eight, steps of 2 % of the thickness: truncated near 1e-13.
    step = 0.02
    weights = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
    measured = sum(
        weight * (at(1 + k * step) - at(1 - k * step)) for k, weight in enumerate(weights, start=1)
    ) / (step * thickness[:, None, None])
    np.testing.assert_allclose(slope, measured, atol=2e-12 * np.abs(slope).max())


# --- axes along the flat map


@given(st.integers(0, 1000))
def test_axis_one_is_where_u_grows_and_v_stays(seed):
    rng = np.random.default_rng(seed)
    flat = np.array([[0, 0], [1, 0], [0.3, 0.8]]) + rng.uniform(-0.2, 0.2, (5, 3, 2))
    jacobian = rng.standard_normal((5, 3, 2))
    corners = np.einsum("txk,tik->tix", jacobian, flat) + rng.standard_normal((5, 1, 3))
    ours = map_directions(corners, flat)
    np.testing.assert_allclose(ours, jacobian[:, :, 0], atol=1e-12)


@given(st.integers(0, 1000))
def test_rotations_of_a_conformal_map_are_its_jacobian_over_its_scale(seed):
    rng = np.random.default_rng(seed)
    flat = np.array([[0, 0], [1, 0], [0.3, 0.8]]) + rng.uniform(-0.2, 0.2, (5, 3, 2))
    turn = np.linalg.qr(rng.standard_normal((5, 3, 3)))[0]
    turn *= np.linalg.det(turn)[:, None, None]
    scale = rng.uniform(100, 500, (5, 1, 1))
    corners = np.einsum("txk,tik->tix", scale * turn[:, :, :2], flat) + rng.standard_normal((5, 1, 3))
    ours = map_rotations(corners, flat)
    np.testing.assert_allclose(ours, turn, atol=1e-10)
    np.testing.assert_allclose(
        ours.transpose(0, 2, 1) @ ours, np.broadcast_to(np.eye(3), (5, 3, 3)), atol=1e-13
    )
    np.testing.assert_allclose(np.linalg.det(ours), 1.0, atol=1e-12)


def test_triangle_without_area_in_the_map_is_named():
    flat = np.random.default_rng(0).standard_normal((5, 3, 2))
    flat[3, 2] = 2 * flat[3, 1] - flat[3, 0]
    with pytest.raises(GeometryError, match="triangle 3 of"):
        map_directions(np.ones((5, 3, 3)), flat)


# --- what makes no section


def broken(change):
    matrices = np.repeat(MEMBRANE[None], 20, axis=0)
    change(matrices[13])
    return matrices


def negative(matrix):
    matrix[1, 1] = -0.1


def coupled_too_much(matrix):
    matrix[0, 1] = matrix[1, 0] = 1.1 * np.sqrt(matrix[0, 0] * matrix[1, 1])


def skew(matrix):
    matrix[0, 1] *= 2


def lost(matrix):
    matrix[2, 2] = np.nan


@pytest.mark.parametrize("change", [negative, coupled_too_much, skew, lost])
@pytest.mark.parametrize("which", ["membrane", "bending", "transverse shear"])
def test_section_that_is_not_positive_definite_is_refused_by_triangle(change, which):
    matrices = broken(change)
    good = np.repeat(MEMBRANE[None], 20, axis=0)
    section = {
        "membrane": Section(matrices, good, good[:, :2, :2]),
        "bending": Section(good, matrices, good[:, :2, :2]),
        "transverse shear": Section(
            good, good, matrices[:, 1:, 1:] if change is lost else matrices[:, :2, :2]
        ),
    }[which]
    with pytest.raises(GeometryError, match=f"{which} stiffness of 1 of 20.*triangle 13"):
        section_roots(section)


@pytest.mark.parametrize("poisson", [-0.1, 0.5, np.nan])
def test_poissons_ratio_out_of_range_is_refused(poisson):
    with pytest.raises(GeometryError, match="Poisson's ratio"):
        isotropic(poisson)


@pytest.mark.parametrize("upright", ["director", "zero", "nan"])
def test_direction_off_the_surface_is_refused_by_triangle(upright):
    corners, directors, tangents = tube_elements()
    along = corners[:, 1] - corners[:, 0]
    along[17] = {"director": directors[17].mean(axis=0), "zero": 0.0, "nan": np.nan}[upright]
    directors[17] = directors[17].mean(axis=0) / np.linalg.norm(directors[17].mean(axis=0))
    section = orthotropic(MEMBRANE[None], along)
    with pytest.raises(GeometryError, match="triangle 17"):
        element_stiffness(corners, directors, tangents, np.full(len(corners), 3.0), section)


@pytest.mark.malformed
@pytest.mark.parametrize(
    ("membranes", "directions", "named"),
    [
        (np.eye(3), np.ones((1, 3)), "membrane of shape"),
        (np.tile(np.eye(3), (7, 1, 1)), np.ones((1, 3)), "membrane of shape"),
        (np.eye(3)[None], np.ones(3), "directions of shape"),
        (np.eye(3)[None], np.ones((7, 3)), "directions of shape"),
    ],
)
def test_section_of_another_mesh_is_refused(membranes, directions, named):
    with pytest.raises(GeometryError, match=named) as caught:
        build_shell(*tube(6, 4, 30.0, 60.0), 3.0, orthotropic(membranes, directions))
    assert "(48, 3" in caught.value.hint
