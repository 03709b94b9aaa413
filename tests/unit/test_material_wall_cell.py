"""Walls of finite thickness against plate theory, rods and the thin sheet."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.config.material import CELLS
from hilbrace.material.homogenize import coverage, homogenize, subpixel_distance
from hilbrace.material.wall_cell import homogenize_wall

NU = 0.45
LAW = np.array([[1, NU, 0], [NU, 1, 0], [0, 0, (1 - NU) / 2]]) / (1 - NU**2)


@pytest.mark.parametrize("thickness", [0.1, 0.4, 0.8])
@pytest.mark.parametrize("layers", [1, 3])
def test_a_solid_wall_is_the_plate_of_the_textbook(thickness, layers):
    wall = homogenize_wall(np.ones((6, 6)), NU, thickness, layers)
    assert wall.membrane == pytest.approx(LAW, rel=1e-9, abs=1e-10)
    assert wall.bending == pytest.approx(LAW, rel=1e-9, abs=1e-10)


def test_bars_bend_like_bars():
    # parallel bars: E I per width along them, nothing across; half of the wall is bars
    bars = np.zeros((12, 12))
    bars[:, 3:9] = 1.0
    wall = homogenize_wall(bars + 1e-9 * (bars == 0), NU, 0.2, 2)
    compliance = np.linalg.inv(wall.bending[:2, :2] + np.diag([0, 1e-9]))
    assert 1 / compliance[0, 0] == pytest.approx(0.5, rel=1e-3)
    assert wall.membrane[0, 0] == pytest.approx(0.5, rel=1e-3)


def test_a_square_grid_twists_by_the_torsion_of_its_bars():
    # bars b wide and h high in both directions, one each per cell: 12 D66 / h^3 -> G J 12 / (2 h^3)
    # (two families share the twist), J by Saint-Venant's series; short bars meet in stiff joints
    pixels, bar, height = 48, 6, 0.3
    grid = np.zeros((pixels, pixels))
    grid[:, (pixels - bar) // 2 : (pixels + bar) // 2] = 1
    grid = np.maximum(grid, grid.T)
    width, shear = bar / pixels, 0.5 / (1 + NU)
    n = np.arange(1, 20, 2)
    series = (192 * width / (np.pi**5 * height) * np.tanh(n * np.pi * height / (2 * width)) / n**5).sum()
    torsion = height * width**3 / 3 * (1 - series)
    free = 12 / height**3 * shear * torsion / 2
    twist = homogenize_wall(grid, NU, height, 3).bending[2, 2]
    assert free < twist < 1.6 * free


@pytest.mark.parametrize("name", CELLS)
def test_a_thin_wall_stretches_like_the_sheet_and_all_costs_energy(name):
    distance = subpixel_distance(name, 24)
    density = coverage(distance, float(np.quantile(distance, 0.45)), 24)
    wall = homogenize_wall(density, NU, 0.05, 2)
    sheet = homogenize(density, NU)
    assert wall.membrane == pytest.approx(sheet, abs=0.03 * sheet.max())
    for matrix in (wall.membrane, wall.bending):
        assert matrix == pytest.approx(matrix.T, rel=1e-9, abs=1e-12)
        assert (np.linalg.eigvalsh(matrix) > 0).all()
        assert np.linalg.eigvalsh(LAW - matrix).min() > 0


def test_soft_cells_are_stiffer_in_bending_than_in_stretch():
    distance = subpixel_distance("sinusoidal", 24)
    density = coverage(distance, float(np.quantile(distance, 0.4)), 24)
    thin, thick = (homogenize_wall(density, NU, t, 2) for t in (0.1, 0.4))
    for wall in (thin, thick):
        assert wall.bending[0, 0] > 2 * wall.membrane[0, 0]
        assert wall.bending[2, 2] > 5 * wall.membrane[2, 2]
    # the excess shrinks as the wall gets thicker than its struts are wide
    assert thick.bending[0, 0] < thin.bending[0, 0]


def test_finer_grids_approach_a_limit():
    ends = []
    for pixels, layers in ((16, 2), (32, 2), (32, 4), (64, 2)):
        density = coverage(subpixel_distance("voronoi_open", pixels), 0.07, pixels)
        ends.append(homogenize_wall(density, NU, 0.2, layers).bending[[0, 2], [0, 2]])
    coarse, middle, layered, fine = ends
    assert (np.abs(middle - fine) < 0.6 * np.abs(coarse - fine)).all()
    assert middle == pytest.approx(fine, rel=0.06)
    assert layered == pytest.approx(middle, rel=0.01)
