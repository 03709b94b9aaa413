"""Segmentation on sleeves with known answers, by both methods."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.errors import GeometryError
from hilbrace.material.neo_hookean import worst_energy_density
from hilbrace.material.segmentation import (
    MOST_PATCHES,
    SMALLEST_PATCH,
    dual_edges,
    otsu_threshold,
    patches,
    segment,
    without_small_patches,
)
from hilbrace.pattern.clip import triangle_areas
from tests.unit.sleeve import sleeve_domain

SLEEVE = sleeve_domain(around=40, along=24)
AREAS = triangle_areas(SLEEVE.vertices, SLEEVE.triangles)
CENTRES = SLEEVE.vertices[SLEEVE.triangles].mean(axis=1)


@pytest.mark.parametrize("lame", ["plane_stress", "plane_strain"])
@pytest.mark.parametrize(("method", "softest", "most"), [("graphcut", 0.04, 0.4), ("spectral", 0.4, 0.6)])
def test_flexed_knee_is_soft_in_a_band_at_the_joint(method, softest, most, lame):
    energy = worst_energy_density(SLEEVE.deformation, 0.45, lame)
    firm = segment(energy, AREAS, SLEEVE.triangles, SLEEVE.vertices, method)
    assert softest < (AREAS * ~firm).sum() / AREAS.sum() < most
    assert np.abs(CENTRES[~firm, 1]).mean() < 0.7 * np.abs(CENTRES[firm, 1]).mean()
    assert energy[~firm].mean() > 3 * energy[firm].mean()
    assert np.array_equal(firm, segment(energy, AREAS, SLEEVE.triangles, SLEEVE.vertices, method))
    patch, label = patches(firm, dual_edges(SLEEVE.triangles)[1])
    assert np.bincount(label).max() <= MOST_PATCHES
    assert np.bincount(patch, AREAS).min() >= SMALLEST_PATCH * AREAS.sum()


@pytest.mark.parametrize("method", ["graphcut", "spectral"])
def test_specks_are_cleaned_away(method):
    energy = np.where(CENTRES[:, 1] > 0, 1.0, 0.01)
    rng = np.random.default_rng(0)
    noisy = energy * rng.uniform(0.9, 1.1, len(energy))
    noisy[rng.choice(len(energy), 20, replace=False)] = 0.5
    firm = segment(noisy, AREAS, SLEEVE.triangles, SLEEVE.vertices, method)
    assert (firm == (CENTRES[:, 1] <= 0)).mean() > 0.97
    _, pairs = dual_edges(SLEEVE.triangles)
    border = (firm[pairs[:, 0]] != firm[pairs[:, 1]]).sum()
    assert border <= 1.3 * 2 * 40


def test_patches_are_counted_by_label():
    """Six patches large enough each, on a soft ground: the two smallest go."""
    turn = np.arctan2(CENTRES[:, 2], CENTRES[:, 0])
    firm = np.zeros(len(CENTRES), dtype=bool)
    for k in range(6):
        reach = 0.20 + 0.02 * k
        away = np.abs((turn - 2 * np.pi * k / 6 + np.pi) % (2 * np.pi) - np.pi)
        firm |= (away < reach) & (np.abs(CENTRES[:, 1]) < 50)
    pairs = dual_edges(SLEEVE.triangles)[1]
    before = patches(firm, pairs)[1]
    assert np.bincount(before).tolist() == [1, 6]
    cleaned = without_small_patches(firm, AREAS, pairs)
    assert np.bincount(patches(cleaned, pairs)[1]).tolist() == [1, MOST_PATCHES]
    assert (cleaned <= firm).all()


@pytest.mark.parametrize("method", ["graphcut", "spectral"])
def test_even_energy_is_all_firm(method):
    assert segment(np.full(len(AREAS), 0.3), AREAS, SLEEVE.triangles, SLEEVE.vertices, method).all()


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_energy_that_is_not_finite_is_named(lost):
    energy = np.full(len(AREAS), 0.3)
    energy[17] = lost
    with pytest.raises(GeometryError, match="triangle 17"):
        segment(energy, AREAS, SLEEVE.triangles, SLEEVE.vertices)


def test_otsu_splits_two_heaps():
    rng = np.random.default_rng(1)
    value = np.concatenate([rng.normal(0, 0.2, 300), rng.normal(5, 0.2, 100)])
    assert 1 < otsu_threshold(value, np.ones(400)) < 4


def test_dual_edges_pair_every_inner_edge_once():
    _, pairs = dual_edges(SLEEVE.triangles)
    loops = len(SLEEVE.upper_loop) + len(SLEEVE.lower_loop)
    assert len(pairs) == (3 * len(SLEEVE.triangles) - loops) // 2
    assert (pairs[:, 0] != pairs[:, 1]).all()
