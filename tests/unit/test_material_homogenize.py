"""Homogenization against closed forms and bounds."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.material.cells import skeleton_distance
from hilbrace.material.homogenize import (
    coverage,
    directional_modulus,
    homogenize,
    mean_modulus,
    subpixel_distance,
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


@pytest.mark.parametrize("name", ["voronoi_open", "sinusoidal"])
@pytest.mark.parametrize("volume", [0.2, 0.4, 0.55])
def test_cells_respect_the_hashin_shtrikman_bound(name, volume):
    pixels = 32
    distance = subpixel_distance(name, pixels)
    density = coverage(distance, float(np.quantile(distance, volume)), pixels)
    c = homogenize(density, NU)
    # isotropic lower estimate (Reuss average over directions) against the bound for voids, V / (3 - 2 V)
    s = np.linalg.inv(c)
    bulk, shear = 1 / (s[0, 0] + s[1, 1] + 2 * s[0, 1]), 2 / (s[0, 0] + s[1, 1] - 2 * s[0, 1] + s[2, 2])
    v = density.mean()
    assert 4 * bulk * shear / (bulk + shear) < v / (3 - 2 * v)
    assert directional_modulus(c, np.linspace(0, np.pi, 91)).max() < v


def test_mirrored_cell_equals_the_periodic_problem():
    pixels = 10
    cell = np.clip(np.random.default_rng(3).uniform(0.05, 1, (pixels, pixels)), 0, 1)
    period = np.block([[cell, cell[:, ::-1]], [cell[::-1], cell[::-1, ::-1]]])
    assert homogenize(cell, NU) == pytest.approx(_periodic(period, NU), rel=1e-5, abs=1e-7)


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
