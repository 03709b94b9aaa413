"""Homogenization against closed forms and bounds."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.config.material import CELLS
from hilbrace.material.cells import skeleton_distance
from hilbrace.material.homogenize import (
    VOID,
    coverage,
    directional_modulus,
    homogenize,
    homogenize_shear,
    mean_modulus,
    poisson_ratio,
    subpixel_distance,
    with_poisson,
)
from hilbrace.material.tables import tabulate

NU = 0.45


def test_solid_cell_has_the_base_materials_stiffness():
    law = np.array([[1, NU, 0], [NU, 1, 0], [0, 0, (1 - NU) / 2]]) / (1 - NU**2)
    stiffness = homogenize(np.ones((12, 12)), NU)
    assert stiffness == pytest.approx(law, rel=1e-9, abs=1e-12)
    assert mean_modulus(stiffness) == pytest.approx(1.0, rel=1e-9)


def test_empty_cell_has_almost_none():
    assert mean_modulus(homogenize(np.zeros((12, 12)), NU)) < 2e-7


def test_layers_carry_voigts_bound_along_and_nothing_across():
    layers = np.zeros((16, 16))
    layers[:, 4:12] = 1.0
    along, across = directional_modulus(homogenize(layers, NU), np.array([0.0, np.pi / 2]))
    assert along == pytest.approx(0.5, rel=1e-5)
    assert across < 1e-5


def test_two_layers_match_the_laminate_formula():
    # series of two isotropic sheets: strain along is shared, stress across is shared
    soft = 0.2
    layers = np.ones((16, 16))
    layers[:, :8] = soft
    c = homogenize(layers, 0.0)
    assert c[0, 0] == pytest.approx((1 + soft) / 2, rel=1e-6)
    assert c[1, 1] == pytest.approx(2 / (1 + 1 / soft), rel=1e-6)
    assert c[2, 2] == pytest.approx(0.5 * 2 / (1 + 1 / soft), rel=1e-6)


def test_thin_square_grid_stretches_like_its_bars():
    # one bar of width w per cell in each direction carries E w along itself (Gibson & Ashby 1997)
    n, bar = 64, 8
    grid = np.zeros((n, n))
    grid[:, (n - bar) // 2 : (n + bar) // 2] = 1
    grid = np.maximum(grid, grid.T)
    along = directional_modulus(homogenize(grid, NU), np.array([0.0]))[0]
    assert bar / n < along < 1.08 * bar / n


@pytest.mark.parametrize("seed", [3, 4])
def test_mirrored_cell_equals_the_periodic_problem(seed):
    pixels = 10
    cell = np.random.default_rng(seed).uniform(0.05, 1, (pixels, pixels))
    assert _difference(cell) < 1e-9


@pytest.mark.parametrize("name", CELLS)
def test_mirrored_microstructures_equal_their_periodic_problem(name):
    distance = subpixel_distance(name, 12)
    assert _difference(coverage(distance, float(np.quantile(distance, 0.5)), 12)) < 1e-9


def _difference(cell: np.ndarray) -> float:
    """Largest difference between the cell's stiffness and that of its period of two by two."""
    modulus = VOID + (1 - VOID) * cell
    period = np.block([[modulus, modulus[:, ::-1]], [modulus[::-1], modulus[::-1, ::-1]]])
    whole = _periodic(period, NU)
    return float(np.abs(homogenize(cell, NU) - whole).max() / np.abs(whole).max())


@pytest.mark.parametrize("name", CELLS)
def test_a_turned_or_mirrored_cell_is_the_same_material(name):
    distance = subpixel_distance(name, 16)
    density = coverage(distance, float(np.quantile(distance, 0.45)), 16)
    c = homogenize(density, NU)
    assert c == pytest.approx(c.T, rel=1e-10, abs=1e-12)
    for mirrored in (density[::-1], density[:, ::-1]):
        assert homogenize(mirrored, NU) == pytest.approx(c, rel=1e-8, abs=1e-10)
    turned = homogenize(density.T, NU)
    assert turned == pytest.approx(c[[1, 0, 2]][:, [1, 0, 2]], rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("name", ["star", "sinusoidal", "octagon", "square", "diamond"])
def test_cells_that_look_the_same_along_both_axes_are(name):
    distance = subpixel_distance(name, 16)
    c = homogenize(coverage(distance, 0.12, 16), NU)
    # the octagon's corner is a rounded figure, 0.2929
    assert c[0, 0] == pytest.approx(c[1, 1], rel=1e-3)


def test_a_finer_grid_approaches_a_limit_from_above():
    moduli = []
    for pixels in (16, 32, 64, 128):
        distance = subpixel_distance("star", pixels)
        moduli.append(mean_modulus(homogenize(coverage(distance, 0.08, pixels), NU)))
    steps = -np.diff(moduli)
    assert (steps > 0).all()
    assert steps[1:] == pytest.approx(steps[:-1] / 2, rel=0.75)
    assert steps[-1] < 0.08 * moduli[-1]


@pytest.mark.parametrize("name", CELLS)
def test_youngs_modulus_of_a_perforated_sheet_ignores_poissons_ratio(name):
    # Cherkaev, Lurie & Milton 1992: exact for the sheet, and for elements as they get small
    errors = []
    for pixels in (24, 48):
        distance = subpixel_distance(name, pixels)
        density = coverage(distance, float(np.quantile(distance, 0.5)), pixels)
        other = homogenize(density, 0.2)
        shifted = with_poisson(homogenize(density, 0.45), 0.45, 0.2)
        errors.append(np.abs(shifted - other).max() / other.max())
    assert errors[0] < 0.02
    assert errors[1] < 0.75 * errors[0]


def test_another_poissons_ratio_of_a_solid_is_exact():
    assert with_poisson(homogenize(np.ones((4, 4)), 0.45), 0.45, 0.3) == pytest.approx(
        homogenize(np.ones((4, 4)), 0.3), rel=1e-9, abs=1e-12
    )


def test_poissons_ratio_of_a_solid_and_its_mean_over_directions():
    assert poisson_ratio(homogenize(np.ones((4, 4)), 0.37)) == pytest.approx(0.37, rel=1e-9)
    c = np.array([[0.2, 0.05, 0], [0.05, 0.1, 0], [0, 0, 0.03]])
    s = np.linalg.inv(c)
    angles = np.arange(360) * np.pi / 180
    along = 1 / directional_modulus(c, angles)
    x, y = np.cos(angles), np.sin(angles)
    across = (s[0, 0] + s[1, 1] - s[2, 2]) * (x * y) ** 2 + s[0, 1] * (x**4 + y**4)
    assert poisson_ratio(c) == pytest.approx(-across.mean() / along.mean(), rel=1e-9)


def test_transverse_shear_of_a_solid_of_layers_and_its_bound():
    assert homogenize_shear(np.ones((6, 6))) == pytest.approx(np.eye(2), abs=1e-9)
    layers = np.full((12, 12), 0.25)
    layers[:, 4:10] = 1.0
    assert homogenize_shear(layers) == pytest.approx(np.diag([0.625, 1 / (0.5 + 0.5 / 0.25)]), rel=1e-5)
    for name in CELLS:
        distance = subpixel_distance(name, 64)
        density = coverage(distance, float(np.quantile(distance, 0.4)), 64)
        volume = density.mean()
        # Hashin & Shtrikman's bound on conduction with voids in two dimensions
        first, second = np.diag(homogenize_shear(density))
        assert 2 / (1 / first + 1 / second) < volume / (2 - volume)


def test_coverage_is_the_covered_area():
    distance = subpixel_distance("sinusoidal", 40)
    fine = np.random.default_rng(0).uniform(0, 1, (40000, 2))
    for width in (0.05, 0.1):
        sampled = (skeleton_distance("sinusoidal", fine) <= width).mean()
        assert coverage(distance, width, 40).mean() == pytest.approx(sampled, abs=0.01)


def test_tables_are_reproducible():
    first, second = (tabulate("sinusoidal", pixels=16, samples=3) for _ in range(2))
    assert first == second
    assert first["columns"]["volume"] == pytest.approx([0.1, 0.33, 0.55], abs=0.02)


def _periodic(density: np.ndarray, poisson: float) -> np.ndarray:
    """Textbook periodic homogenization, dense: unit strains plus periodic fluctuations."""
    n = len(density)
    law = np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]]) / (1 - poisson**2)
    gauss, element = 1 / np.sqrt(3), np.zeros((8, 8))
    for a in (-gauss, gauss):
        for b in (-gauss, gauss):
            dn = 0.5 * np.array([[-(1 - b), 1 - b, 1 + b, -(1 + b)], [-(1 - a), -(1 + a), 1 + a, 1 - a]])
            strain = np.zeros((3, 8))
            strain[0, 0::2], strain[1, 1::2], strain[2, 0::2], strain[2, 1::2] = dn[0], dn[1], dn[1], dn[0]
            element += strain.T @ law @ strain / 4
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) / n
    unit = np.zeros((8, 3))
    unit[0::2, 0], unit[1::2, 1] = corners[:, 0], corners[:, 1]
    unit[0::2, 2], unit[1::2, 2] = corners[:, 1] / 2, corners[:, 0] / 2
    size = 2 * n * n
    matrix, load, parts = np.zeros((size, size)), np.zeros((size, 3)), []
    for i in range(n):
        for j in range(n):
            nodes = [((i + di) % n) * n + (j + dj) % n for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))]
            dofs = np.array([[2 * m, 2 * m + 1] for m in nodes]).ravel()
            matrix[np.ix_(dofs, dofs)] += density[i, j] * element
            load[dofs] -= density[i, j] * element @ unit
            parts.append((dofs, density[i, j]))
    fluctuation = np.zeros((size, 3))
    fluctuation[2:] = np.linalg.solve(matrix[2:, 2:], load[2:])
    return sum(e * (fluctuation[d] + unit).T @ element @ (fluctuation[d] + unit) for d, e in parts)
