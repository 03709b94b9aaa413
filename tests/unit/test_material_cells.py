"""Cells: skeletons, fold and distance table against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.config.material import CELLS
from hilbrace.errors import ConfigError
from hilbrace.material.cell_tensor import cell_distance_tensor
from hilbrace.material.cells import (
    LUT_INTERVALS,
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


@pytest.mark.parametrize("name", CELLS)
def test_skeletons_lie_in_the_unit_cell(name):
    segments = skeleton(name)
    assert segments.min() >= -1e-12
    assert segments.max() <= 1 + 1e-12
    assert (np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1) > 0).all()


@pytest.mark.parametrize("name", CELLS)
def test_skeleton_distance_is_the_brute_force_distance(name):
    points = np.random.default_rng(1).uniform(0, 1, (300, 2))
    a, b = np.moveaxis(skeleton(name), 1, 0)
    t = np.linspace(0, 1, 2001)[:, None, None]
    laid = ((1 - t) * a + t * b).reshape(-1, 2)
    brute = np.array([np.linalg.norm(laid - p, axis=1).min() for p in points])
    assert skeleton_distance(name, points) == pytest.approx(brute, abs=1e-4)


@pytest.mark.parametrize("name", CELLS)
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
        nearest = np.linalg.norm(images - middle, axis=1).min()
        distances = np.linalg.norm(np.unique(np.round(images, 9), axis=0) - middle, axis=1)
        assert (np.abs(distances - nearest) < 1e-6).sum() >= 2


@pytest.mark.parametrize("name", CELLS)
def test_tensors_give_the_same_distance(name):
    u, v = np.random.default_rng(3).uniform(-0.01, 1.01, (2, 500))
    told = cell_distance_tensor(name, torch.from_numpy(u), torch.from_numpy(v))
    assert told.numpy() == pytest.approx(cell_distance(name, u, v), abs=1e-15)


@pytest.mark.parametrize("name", CELLS)
def test_gradient_of_the_distance_through_the_fold_matches_finite_differences(name):
    scale, h = 1 / 12, 1e-8
    rng = np.random.default_rng(4)
    # middles of table squares, two periods wide, so that a step of the difference stays inside
    inside = (rng.integers(0, LUT_INTERVALS, (2, 200)) + rng.uniform(0.2, 0.8, (2, 200))) / LUT_INTERVALS
    place = (inside / 2 + rng.integers(-2, 2, (2, 200))) * scale
    u, v = (torch.from_numpy(axis).requires_grad_() for axis in place)
    cell_distance_tensor(name, fold(u, scale), fold(v, scale)).sum().backward()

    def plain(du: float, dv: float) -> np.ndarray:
        return cell_distance(name, fold(place[0] + du, scale), fold(place[1] + dv, scale))

    for tensor, step in ((u, (h, 0)), (v, (0, h))):
        difference = (plain(*step) - plain(-step[0], -step[1])) / (2 * h)
        assert tensor.grad.numpy() == pytest.approx(difference, abs=1e-5)
    # the field is a distance: one cell side of distance per cell side of way, off its ridges
    slope = torch.hypot(u.grad, v.grad).numpy() * scale / 2
    assert np.quantile(slope, [0.25, 0.9]) == pytest.approx([1.0, 1.0], abs=0.01)
    assert slope.max() < np.sqrt(2)


def test_fold_serves_tensors():
    u = np.linspace(-2, 2, 101)
    assert fold(torch.from_numpy(u), 0.08).numpy() == pytest.approx(fold(u, 0.08), abs=0)


def test_table_is_read_only_and_unknown_cells_are_refused():
    with pytest.raises(ValueError, match="read-only"):
        distance_table("sinusoidal")[0, 0] = 1.0
    with pytest.raises(ConfigError, match="no microstructure named 'plaid'") as error:
        skeleton("plaid")
    assert "sinusoidal" in error.value.hint
