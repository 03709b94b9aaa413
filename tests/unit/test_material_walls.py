"""Walls of blended cells: limits, blend, positive definiteness, and direct homogenization in between."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from hilbrace.config.material import CELLS
from hilbrace.errors import GeometryError
from hilbrace.material.curves import load_curves, load_table
from hilbrace.material.homogenize import coverage, homogenize, mean_modulus, subpixel_distance, with_poisson
from hilbrace.material.wall_cell import homogenize_wall
from hilbrace.material.walls import blended_walls, cell_walls, solid_walls

NU = 0.45


def at(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)


@pytest.mark.parametrize("name", CELLS)
def test_at_the_samples_the_walls_are_the_table(name):
    table = load_table(name)
    columns, wall = table["columns"], table["wall"]
    for level, thickness in enumerate(wall["thickness"]):
        for sample, d in enumerate(wall["d"]):
            k = round(d * (len(columns["width"]) - 1))
            c = np.diag([columns["C11"][k], columns["C22"][k], columns["C66"][k]])
            c[0, 1] = c[1, 0] = columns["C12"][k]
            walls = cell_walls(name, at(d), at(thickness), table["poisson"])
            inverse = np.linalg.inv(np.linalg.cholesky(c))
            for key in ("membrane", "bending"):
                told = getattr(walls, key)[0]
                r11, r12, r22, r66 = wall[key][level][sample]
                ratio = np.array([[r11, r12, 0], [r12, r22, 0], [0, 0, r66]])
                # both congruences of C have the same eigenvalues
                assert np.linalg.eigvalsh(inverse @ told @ inverse.T) == pytest.approx(
                    np.linalg.eigvalsh(ratio), rel=1e-6
                )
            assert np.diag(walls.shear[0]) * 2 * (1 + NU) == pytest.approx(
                [columns["K11"][k], columns["K22"][k]], rel=1e-6
            )


@pytest.mark.parametrize("name", CELLS)
def test_a_thin_walls_mean_modulus_is_the_curve_of_the_optimizer(name):
    curves, d = load_curves(name), np.linspace(0, 1, 13)
    moduli = [mean_modulus(c) for c in cell_walls(name, d, np.full(13, 0.1), NU).membrane]
    # the tabulated wall of a tenth is up to four percent stiffer than a sheet of no thickness
    assert np.array(moduli) == pytest.approx(curves.modulus(d), rel=0.05, abs=3e-3)


@pytest.mark.parametrize("name", ["sinusoidal", "star"])
def test_between_the_samples_the_walls_are_close_to_their_own_homogenization(name):
    curves, d, thickness, pixels = load_curves(name), 0.43, 0.28, 64
    density = coverage(subpixel_distance(name, pixels), float(curves.width(d)), pixels)
    direct = homogenize_wall(density, NU, thickness, 2)
    told = cell_walls(name, at(d), at(thickness), NU)
    for key, size in (("membrane", 0.08), ("bending", 0.03)):
        difference = np.abs(getattr(told, key)[0] - getattr(direct, key)).max()
        assert difference < size * getattr(direct, key).max()


def test_another_poissons_ratio_changes_thin_walls_as_the_theorem_says():
    first, second = (cell_walls("star", at(0.5), at(0.1), nu) for nu in (0.45, 0.3))
    c = homogenize(coverage(subpixel_distance("star", 64), float(load_curves("star").width(0.5)), 64), 0.3)
    assert mean_modulus(second.membrane[0]) == pytest.approx(mean_modulus(first.membrane[0]), rel=0.01)
    assert second.membrane[0] == pytest.approx(c, abs=0.08 * c.max())
    assert with_poisson(first.membrane, 0.45, 0.3)[0] == pytest.approx(second.membrane[0], rel=0.05, abs=1e-4)


def test_solid_places_are_isotropic_to_the_last_digit():
    d = np.linspace(0, 1, 4)
    solid = np.array([True, False, True, False])
    walls = blended_walls("sinusoidal", "voronoi_open", d, d, np.full(4, 0.25), 0.37, solid)
    whole = solid_walls(1, 0.37)
    plane = np.array([[1, 0.37, 0], [0.37, 1, 0], [0, 0, (1 - 0.37) / 2]]) / (1 - 0.37**2)
    assert np.array_equal(whole.membrane[0], plane)
    for key in ("membrane", "bending", "shear"):
        told = getattr(walls, key)
        assert np.array_equal(told[solid], getattr(whole, key)[[0, 0]])
        assert (told[~solid] < getattr(whole, key).max()).all()


def test_the_blend_runs_from_soft_to_firm():
    d, thickness = np.full(3, 0.6), np.full(3, 0.3)
    walls = blended_walls("sinusoidal", "honeycomb", d, at(0, 0.25, 1), thickness, NU)
    soft, firm = (cell_walls(name, d[:1], thickness[:1], NU) for name in ("sinusoidal", "honeycomb"))
    for key in ("membrane", "bending", "shear"):
        a, b, told = getattr(soft, key)[0], getattr(firm, key)[0], getattr(walls, key)
        assert told == pytest.approx(np.stack([a, 0.75 * a + 0.25 * b, b]), rel=1e-12)


@hypothesis_settings(max_examples=40)
@given(st.sampled_from(CELLS), st.floats(0, 1), st.floats(0.02, 3), st.floats(0.05, 0.49))
def test_every_wall_costs_energy_and_less_than_the_solid(name, d, thickness, poisson):
    walls, whole = cell_walls(name, at(d), at(thickness), poisson), solid_walls(1, poisson)
    for key in ("membrane", "bending", "shear"):
        told = getattr(walls, key)[0]
        assert np.array_equal(told, told.T)
        assert np.linalg.eigvalsh(told).min() > 0
        assert np.linalg.eigvalsh(getattr(whole, key)[0] - told).min() > 0


@pytest.mark.parametrize(
    ("d", "firm", "thickness", "named"),
    [
        (at(0.5, np.nan), at(0, 1), at(0.2, 0.2), "design variable nan"),
        (at(0.5, 1.2), at(0, 1), at(0.2, 0.2), "design variable 1.2"),
        (at(0.5, 0.5), at(0, 1.5), at(0.2, 0.2), "firm fraction 1.5"),
        (at(0.5, 0.5), at(0, 1), at(0.2, 0.0), "thickness 0"),
        (at(0.5, 0.5), at(0, 1), at(0.2, np.inf), "thickness inf"),
    ],
)
def test_values_out_of_range_are_refused_by_place(d, firm, thickness, named):
    with pytest.raises(GeometryError, match=named) as error:
        blended_walls("sinusoidal", "voronoi_open", d, firm, thickness, NU)
    assert error.value.where == "wall at place 1"
