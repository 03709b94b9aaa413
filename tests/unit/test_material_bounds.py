"""Bounds against closed forms, extreme materials, and every sample of every table."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.config.material import CELLS
from hilbrace.material.bounds import bound_margin, hashin_shtrikman, isotropic_modulus, voigt
from hilbrace.material.curves import load_table
from hilbrace.material.homogenize import directional_modulus, homogenize

NU = 0.45


def test_isotropic_modulus_is_the_harmonic_mean_over_directions():
    c = np.array([[0.3, 0.05, 0], [0.05, 0.1, 0], [0, 0, 0.02]])
    moduli = directional_modulus(c, np.arange(360) * np.pi / 180)
    assert isotropic_modulus(c) == pytest.approx(1 / np.mean(1 / moduli), rel=1e-9)


def test_a_solid_meets_every_bound():
    solid = homogenize(np.ones((4, 4)), NU)
    assert voigt(1.0) == hashin_shtrikman(1.0) == 1.0
    assert isotropic_modulus(solid) == pytest.approx(1.0)
    assert bound_margin(solid, 1.0, NU) == pytest.approx(0.0, abs=1e-9)


def test_parallel_bars_reach_the_bound_and_cannot_pass_it():
    volume = 0.5
    bars = np.zeros((16, 16))
    bars[:, :8] = 1.0
    stiffness = homogenize(bars, NU)
    assert bound_margin(stiffness, volume, NU) == pytest.approx(0.0, abs=1e-3)
    assert bound_margin(1.02 * stiffness, volume, NU) < -0.01


@pytest.mark.parametrize("volume", [0.2, 0.5, 0.8])
def test_the_best_isotropic_sheet_lies_on_the_bound(volume):
    bulk, shear = 0.5 / (1 - NU), 0.5 / (1 + NU)
    # Hashin's bounds on the moduli of plane stress, written out
    best_bulk = volume * bulk * shear / ((1 - volume) * bulk + shear)
    best_shear = volume * bulk * shear / ((1 - volume) * (bulk + 2 * shear) + bulk)
    assert 4 * best_bulk * best_shear / (best_bulk + best_shear) == pytest.approx(hashin_shtrikman(volume))
    best = np.array([[best_bulk + best_shear, best_bulk - best_shear, 0], [0, 0, 0], [0, 0, best_shear]])
    best[1, :2] = best[0, 1], best[0, 0]
    assert isotropic_modulus(best) == pytest.approx(hashin_shtrikman(volume))
    assert bound_margin(best, volume, NU) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", CELLS)
def test_no_sample_of_any_table_breaks_a_bound(name):
    table = load_table(name)
    columns = {key: np.array(values) for key, values in table["columns"].items()}
    assert len(columns["volume"]) == 25
    for k, volume in enumerate(columns["volume"]):
        c = np.zeros((3, 3))
        c[0, 0], c[1, 1], c[2, 2] = columns["C11"][k], columns["C22"][k], columns["C66"][k]
        c[0, 1] = c[1, 0] = columns["C12"][k]
        assert (np.linalg.eigvalsh(c) > 0).all()
        assert bound_margin(c, volume, table["poisson"]) > 0
        assert isotropic_modulus(c) < hashin_shtrikman(volume)
        assert directional_modulus(c, np.linspace(0, np.pi, 37)).max() < voigt(volume)
        shear = columns["K11"][k], columns["K22"][k]
        assert 0 < min(shear) <= max(shear) < volume
        assert 2 / (1 / shear[0] + 1 / shear[1]) < volume / (2 - volume)
