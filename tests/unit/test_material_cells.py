"""Cells: skeletons, fold and distance table against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.errors import ConfigError
from hilbrace.material.cells import (
    LUT_INTERVALS,
    SKELETONS,
    cell_distance,
    distance_table,
    fold,
    skeleton,
    skeleton_distance,
)


@given(st.floats(-3, 3), st.floats(0.02, 0.5))
def test_fold_equals_the_papers_arccos(u, scale):
    printed = np.arccos(np.clip(np.cos(2 * np.pi * u / scale), -1, 1)) / np.pi
    # arccos loses half the digits where its argument is near one
    assert fold(np.array([u]), scale)[0] == pytest.approx(printed, abs=1e-6)


@pytest.mark.parametrize("name", SKELETONS)
def test_skeletons_lie_in_the_unit_cell(name):
    segments = skeleton(name)
    assert segments.min() >= -1e-12
    assert segments.max() <= 1 + 1e-12
    assert (np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1) > 0).all()


@pytest.mark.parametrize("name", SKELETONS)
def test_skeleton_distance_is_the_brute_force_distance(name):
    points = np.random.default_rng(1).uniform(0, 1, (300, 2))
    a, b = np.moveaxis(skeleton(name), 1, 0)
    t = np.linspace(0, 1, 2001)[:, None, None]
    laid = ((1 - t) * a + t * b).reshape(-1, 2)
    brute = np.array([np.linalg.norm(laid - p, axis=1).min() for p in points])
    assert skeleton_distance(name, points) == pytest.approx(brute, abs=1e-4)


@pytest.mark.parametrize("name", SKELETONS)
def test_distance_table_error_is_below_half_an_interval(name):
    points = np.random.default_rng(2).uniform(0, 1, (20000, 2))
    error = cell_distance(name, points[:, 0], points[:, 1]) - skeleton_distance(name, points)
    assert np.abs(error).max() < 0.5 / LUT_INTERVALS


def test_sinusoidal_cell_vanishes_on_its_own_curve():
    x = np.linspace(0, 1, 500)
    wave = 0.5 + 0.17 * np.cos(2 * np.pi * x)
    for u, v in ((x, wave), (wave, x)):
        assert skeleton_distance("sinusoidal", np.stack([u, v], 1)).max() < 6e-4


def test_voronoi_edges_are_equally_near_to_two_seed_images():
    seeds = np.array([(0.0, 0.0), (1.0, 0.5), (0.45, 1.0), (0.0, 0.62), (0.55, 0.38)])
    images = np.concatenate(
        [
            seeds * [i, j] + [k, m]
            for i, k in ((1, 0), (-1, 0), (-1, 2))
            for j, m in ((1, 0), (-1, 0), (-1, 2))
        ]
    )
    for middle in skeleton("voronoi_open").mean(axis=1):
        nearest = np.sort(np.unique(np.round(np.linalg.norm(images - middle, axis=1), 9)))[:1]
        distances = np.linalg.norm(np.unique(np.round(images, 9), axis=0) - middle, axis=1)
        assert (np.abs(distances - nearest) < 1e-6).sum() >= 2


def test_table_is_read_only_and_unknown_cells_are_refused():
    with pytest.raises(ValueError, match="read-only"):
        distance_table("sinusoidal")[0, 0] = 1.0
    with pytest.raises(ConfigError, match="no microstructure named 'plaid'") as error:
        skeleton("plaid")
    assert "sinusoidal" in error.value.hint
