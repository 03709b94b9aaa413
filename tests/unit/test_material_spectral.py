"""Self-tuning clustering on groups with known answers, and on fields."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.material.spectral import (
    SCALE_NEIGHBOUR,
    aligned,
    field_memberships,
    leading_vectors,
    memberships,
    self_tuned_affinity,
)


def ring(radius, count, spread, rng):
    angle = rng.uniform(0, 2 * np.pi, count)
    return (radius + rng.normal(0, spread, count))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def same_groups(found, truth):
    return np.array_equal(found, truth) or np.array_equal(found, ~truth)


def test_a_dense_heap_inside_a_thin_ring_is_found():
    """Fig. 1 of the publication: no single scale serves both; heaps of one threshold cannot be rings."""
    rng = np.random.default_rng(0)
    samples = np.concatenate([rng.normal(0, 0.05, (150, 2)), ring(2.0, 250, 0.05, rng)])
    truth = np.arange(400) < 150
    membership = memberships(samples)
    assert same_groups(membership > 0, truth)
    assert np.abs(membership).min() > 0.9


@given(st.integers(0, 200), st.floats(1e-3, 1e3))
def test_size_turn_and_order_of_the_samples_do_not_matter(seed, size):
    rng = np.random.default_rng(seed)
    samples = np.concatenate([rng.normal(0, 0.1, (40, 2)), rng.normal(3, 0.5, (60, 2))])
    order = rng.permutation(100)
    turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
    first = memberships(samples) > 0
    second = memberships(size * samples[order] @ turn) > 0
    assert same_groups(second, first[order])


def test_the_affinity_is_the_one_of_the_publication():
    rng = np.random.default_rng(1)
    samples = rng.normal(size=(20, 3))
    distance = np.linalg.norm(samples[:, None] - samples, axis=2)
    scale = np.sort(distance, axis=1)[:, SCALE_NEIGHBOUR]
    affinity = self_tuned_affinity(samples)
    assert affinity[3, 8] == pytest.approx(np.exp(-(distance[3, 8] ** 2) / (scale[3] * scale[8])))
    assert np.array_equal(affinity, affinity.T)
    assert (np.diag(affinity) == 0).all()


def test_the_leading_vectors_belong_to_the_largest_eigenvalues():
    affinity = self_tuned_affinity(np.random.default_rng(2).normal(size=(50, 2)))
    degree = affinity.sum(axis=1)
    matrix = affinity / np.sqrt(np.outer(degree, degree))
    values = np.linalg.eigvalsh(matrix)[::-1]
    vectors = leading_vectors(affinity)
    assert matrix @ vectors == pytest.approx(vectors * values[:2], abs=1e-12)


@given(st.floats(-2.0, 2.0))
def test_alignment_undoes_a_turn(angle):
    rng = np.random.default_rng(5)
    truth = rng.random(60) < 0.4
    rows = np.where(truth[:, None], [1.0, 0.0], [0.0, 1.0]) * rng.uniform(0.5, 1.5, (60, 1))
    c, s = np.cos(angle), np.sin(angle)
    turned, cost = aligned(rows @ np.array([[c, -s], [s, c]]))
    assert cost == pytest.approx(1.0, abs=1e-9)
    assert same_groups(turned[:, 0] ** 2 > 0.5 * (turned**2).sum(axis=1), truth)


def test_two_heaps_of_a_field_part_in_their_gap():
    rng = np.random.default_rng(3)
    values = np.concatenate([rng.normal(1.0, 0.05, 3000), rng.normal(2.0, 0.2, 500)])
    membership = field_memberships(values, np.ones(3500))
    assert np.array_equal(membership > 0, np.arange(3500) >= 3000)


@pytest.mark.parametrize("power", [0.3, 1.0, 4.0])
def test_a_field_without_a_gap_parts_near_its_median_whatever_its_scale(power):
    values = np.random.default_rng(4).uniform(0.1, 1.0, 8000) ** power
    high = field_memberships(values, np.ones(8000)) > 0
    assert high.mean() == pytest.approx(0.5, abs=0.06)
    assert values[high].min() > values[~high].max()


def test_areas_count_and_not_triangles():
    values = np.linspace(0.0, 1.0, 6000)
    weights = np.where(values < 0.5, 5.0, 1.0)
    high = field_memberships(values, weights) > 0
    assert (weights * high).sum() / weights.sum() == pytest.approx(0.5, abs=0.06)


def test_two_values_are_two_groups():
    values = np.where(np.arange(50) % 3 == 0, 2.0, 1.0)
    assert np.array_equal(field_memberships(values, np.ones(50)) > 0, values > 1.5)
