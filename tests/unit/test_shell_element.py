"""The MITC3+ element against published tables, and against what every shell element must do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.shell.directors import tangent_basis
from hilbrace.shell.element import element_stiffness, uncondensed_stiffness
from hilbrace.shell.section import isotropic
from tests.unit import shell_benchmarks as cases


def test_eigenvalues_of_one_element_match_the_published_table():
    # Lee, Lee & Bathe 2014, Table 3: right triangle of side 1, thickness 1e-4, seven integration points.
    published = np.array(
        [
            6.6685e-7,
            7.9621e-7,
            2.4921e-6,
            8.3107e-6,
            1.3599e-5,
            1.4128e-5,
            466.67,
            838.13,
            1176.0,
            1344.0,
            3001.9,
        ]
    )
    corners = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    up = np.tile([0.0, 0.0, 1.0], (1, 3, 1))
    full = uncondensed_stiffness(
        corners, up, tangent_basis(up), np.full(1, 1e-4), isotropic(0.3), seven_points()
    )
    ours = 1.7472e7 * np.linalg.eigvalsh(full[0])[6:]
    np.testing.assert_allclose(ours, published, rtol=1e-4)


def seven_points():
    """Seven-point rule of degree five on the unit triangle (Radon)."""
    near, far = (6 - np.sqrt(15)) / 21, (6 + np.sqrt(15)) / 21
    points = [[1 / 3, 1 / 3]]
    for a in (near, far):
        points += [[a, a], [1 - 2 * a, a], [a, 1 - 2 * a]]
    weights = [9 / 80] + [(155 - np.sqrt(15)) / 2400] * 3 + [(155 + np.sqrt(15)) / 2400] * 3
    return np.array(points), np.array(weights)


def element(seed):
    """A triangle in space whose directors lean away from its normal."""
    rng = np.random.default_rng(seed)
    flat = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [1.0, 3.0, 0.0]]) + rng.uniform(-0.8, 0.8, (3, 3))
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    corners = flat @ turn.T
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    directors = normal / np.linalg.norm(normal) + rng.uniform(-0.2, 0.2, (3, 3))
    directors /= np.linalg.norm(directors, axis=1, keepdims=True)
    return corners, directors, tangent_basis(directors)


def stiffness(corners, directors, tangents, thickness=0.3, poisson=0.45):
    return element_stiffness(
        corners[None], directors[None], tangents[None], np.full(1, thickness), isotropic(poisson)
    )[0]


@given(st.integers(0, 10_000))
def test_only_rigid_motions_cost_no_energy(seed):
    corners, directors, tangents = element(seed)
    matrix = stiffness(corners, directors, tangents)
    motions = np.zeros((3, 5, 6))
    for axis, direction in enumerate(np.eye(3)):
        motions[:, axis, axis] = 1.0
        motions[:, :3, 3 + axis] = np.cross(direction, corners)
        motions[:, 3:, 3 + axis] = tangents[:, :, axis]
    scale = np.abs(matrix).max()
    assert np.abs(matrix @ motions.reshape(15, 6)).max() < 1e-12 * scale
    values = np.linalg.eigvalsh(matrix)
    assert np.abs(values[:6]).max() < 1e-12 * scale
    assert values[6] > 1e-9 * scale  # the twisting mode, soft by the tying points' small offset


@given(st.integers(0, 10_000))
def test_element_does_not_know_its_first_corner(seed):
    corners, directors, tangents = element(seed)
    matrix = stiffness(corners, directors, tangents)
    order = [1, 2, 0]
    turned = stiffness(corners[order], directors[order], tangents[order])
    dofs = np.concatenate([5 * node + np.arange(5) for node in order])
    np.testing.assert_allclose(turned, matrix[np.ix_(dofs, dofs)], atol=1e-12 * np.abs(matrix).max())


def test_stiffness_is_symmetric_and_scales_with_the_size_of_the_element():
    corners, directors, tangents = element(1)
    matrix = stiffness(corners, directors, tangents, thickness=0.3)
    assert np.array_equal(matrix, matrix.T)
    larger = stiffness(2 * corners, directors, tangents, thickness=0.6)
    power = np.tile([1.0, 1.0, 1.0, 2.0, 2.0], 3)  # force per length, per radian; moment per radian
    np.testing.assert_allclose(
        larger, matrix * 2.0 ** (np.add.outer(power, power) - 1.0), atol=1e-13 * larger.max()
    )


PATCH = np.array([[0, 0], [10, 0], [10, 10], [0, 10], [2, 2], [8, 3], [8, 7], [4, 7.0]])
PATCH_TRIANGLES = np.array(
    [
        [0, 1, 5],
        [0, 5, 4],
        [1, 2, 6],
        [1, 6, 5],
        [2, 3, 7],
        [2, 7, 6],
        [3, 0, 4],
        [3, 4, 7],
        [4, 5, 6],
        [4, 6, 7],
    ]
)


def membrane(x, y):
    moves = np.zeros((len(x), 6))
    moves[:, 0], moves[:, 1] = 1e-3 * (x + y / 2), 1e-3 * (y + x / 2)
    return moves


def bending(x, y):
    moves = np.zeros((len(x), 6))
    moves[:, 2] = 5e-4 * (x**2 + x * y + y**2)
    moves[:, 3], moves[:, 4] = 5e-4 * (x + 2 * y), -5e-4 * (2 * x + y)
    return moves


@pytest.mark.parametrize(("exact", "tolerance"), [(membrane, 1e-13), (bending, 1e-11)])
def test_patch_of_elements_reproduces_constant_strain(exact, tolerance):
    x, y = PATCH.T
    up = np.tile([0.0, 0.0, 1.0], (len(PATCH), 1))
    flat = np.column_stack([PATCH, 0 * x])
    case = cases.Problem(flat, PATCH_TRIANGLES, up, 0.1, 1.0, isotropic(0.3))
    case.hold(np.arange(len(PATCH)) < 4, range(6))
    expected = exact(x, y)
    np.testing.assert_allclose(case.solve(expected), expected, atol=tolerance * np.abs(expected).max())
