"""Segmentation and blend map on sleeves and strips with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.material.neo_hookean import worst_energy_density
from hilbrace.material.segmentation import blend_map, dual_edges, otsu_threshold, segment
from hilbrace.pattern.clip import triangle_areas
from tests.unit.sleeve import sleeve_domain

SLEEVE = sleeve_domain(around=40, along=24)
AREAS = triangle_areas(SLEEVE.vertices, SLEEVE.triangles)
CENTRES = SLEEVE.vertices[SLEEVE.triangles].mean(axis=1)


def _strip(length=120.0, width=20.0, step=2.0):
    x, y = np.meshgrid(np.arange(0, length + step, step), np.arange(0, width + step, step), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    rows = x.shape[1]
    a = (np.arange(x.shape[0] - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([a, a + rows, a + rows + 1], 1), np.stack([a, a + rows + 1, a + 1], 1)]
    )
    return vertices, triangles


def test_flexed_knee_is_soft_in_a_band_at_the_joint():
    energy = worst_energy_density(SLEEVE.deformation, 0.45)
    firm = segment(energy, AREAS, SLEEVE.triangles, SLEEVE.vertices)
    assert 0.04 < (AREAS * ~firm).sum() / AREAS.sum() < 0.6
    assert np.abs(CENTRES[~firm, 1]).mean() < 0.6 * np.abs(CENTRES[firm, 1]).mean()
    assert energy[~firm].mean() > 3 * energy[firm].mean()
    assert np.array_equal(firm, segment(energy, AREAS, SLEEVE.triangles, SLEEVE.vertices))


def test_specks_are_cleaned_away():
    energy = np.where(CENTRES[:, 1] > 0, 1.0, 0.01)
    rng = np.random.default_rng(0)
    noisy = energy.copy()
    noisy[rng.choice(len(energy), 20, replace=False)] = 0.5
    firm = segment(noisy, AREAS, SLEEVE.triangles, SLEEVE.vertices)
    assert (firm == (CENTRES[:, 1] <= 0)).mean() > 0.97
    _, pairs = dual_edges(SLEEVE.triangles)
    border = (firm[pairs[:, 0]] != firm[pairs[:, 1]]).sum()
    assert border <= 1.3 * 2 * 40


def test_even_energy_is_all_firm():
    assert segment(np.full(len(AREAS), 0.3), AREAS, SLEEVE.triangles, SLEEVE.vertices).all()


def test_otsu_splits_two_heaps():
    rng = np.random.default_rng(1)
    value = np.concatenate([rng.normal(0, 0.2, 300), rng.normal(5, 0.2, 100)])
    assert 1 < otsu_threshold(value, np.ones(400)) < 4


def test_dual_edges_pair_every_inner_edge_once():
    _, pairs = dual_edges(SLEEVE.triangles)
    loops = len(SLEEVE.upper_loop) + len(SLEEVE.lower_loop)
    assert len(pairs) == (3 * len(SLEEVE.triangles) - loops) // 2
    assert (pairs[:, 0] != pairs[:, 1]).all()


@pytest.mark.parametrize("width", [10.0, 20.0])
def test_blend_follows_the_exponential_of_its_equation(width):
    vertices, triangles = _strip()
    firm = vertices[triangles].mean(axis=1)[:, 0] > 60
    at_vertex, at_triangle = blend_map(vertices, triangles, firm, width)
    away = vertices[:, 0] - 60
    length = width / np.sqrt(8)
    exact = np.where(away < 0, np.exp(away / length) / 2, 1 - np.exp(-away / length) / 2)
    assert at_vertex == pytest.approx(exact, abs=0.03)
    assert at_vertex.min() >= 0
    assert at_vertex.max() <= 1
    assert at_triangle == pytest.approx(at_vertex[triangles].mean(axis=1))


def test_blend_stays_between_zero_and_one_on_skewed_triangles():
    rng = np.random.default_rng(4)
    vertices = SLEEVE.vertices * [1, 0.2, 1] + rng.normal(0, 0.5, SLEEVE.vertices.shape)
    fraction, _ = blend_map(vertices, SLEEVE.triangles, CENTRES[:, 1] > 0, 15.0)
    assert fraction.min() >= 0
    assert fraction.max() <= 1
    assert blend_map(vertices, SLEEVE.triangles, np.ones(len(CENTRES), bool), 15.0)[0] == pytest.approx(1.0)
