"""Widths in the cell against widths on the limb."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.config import PatternSettings
from hilbrace.material.cells import cell_distance, fold
from hilbrace.material.strut_width import (
    CELL_PERIOD_MM,
    cell_scale,
    effective_scale,
    map_length,
    maximum_width,
    minimum_width,
    strut_width_mm,
    wanted_scale,
)
from tests.unit.knee_tube import knee_domain, knee_loads


def test_width_of_a_wave_measured_on_the_unfolded_map():
    scale, length, width = 0.08, 400.0, 0.05
    # across the crest of a wave of the sinusoidal cell, where it runs along u
    u = np.full(20001, 0.0)
    v = np.linspace(0, scale / 2, 20001)
    inside = cell_distance("sinusoidal", fold(u, scale), fold(v, scale)) <= width
    measured = inside.mean() * scale / 2 * length
    assert strut_width_mm(width, scale, length) == pytest.approx(measured, rel=0.02)


@given(st.floats(0.5, 5), st.floats(0.03, 0.3), st.floats(100, 800))
def test_minimum_width_is_the_inverse(strut, scale, length):
    assert strut_width_mm(minimum_width(strut, scale, length), scale, length) == pytest.approx(strut)


def test_maximum_width_leaves_the_slit():
    pinch, scale, length = 0.18, 0.08, 400.0
    width = maximum_width(pinch, 1.0, scale, length)
    assert strut_width_mm(pinch - width, scale, length) == pytest.approx(1.0)


def test_scale_closes_around_the_limb():
    assert effective_scale(0.08, 1.0) in (pytest.approx(1 / 12), pytest.approx(1 / 13))
    for period in (0.61, 0.83, 1.0):
        turns = period / effective_scale(0.08, period)
        assert turns == pytest.approx(round(turns))
    assert effective_scale(0.08, 0.0) == 0.08


def test_map_length_of_a_scaled_plane():
    uv = np.array([[0, 0], [0.5, 0], [0, 0.25], [0.5, 0.25]])
    triangles = np.array([[0, 1, 2], [1, 3, 2]])
    vertices = np.concatenate([uv * 320.0, np.ones((4, 1))], axis=1)
    assert map_length(vertices, triangles, uv, triangles) == pytest.approx(320.0)


@pytest.fixture(scope="module")
def domain():
    return knee_domain(knee_loads(), around=20, along=14)


def test_a_period_on_the_limb_is_that_long_on_the_limb(domain):
    around = 2 * np.pi * 60.0  # the tube's radius runs from 55 to 65 mm
    asked = PatternSettings(period_mm=30.0)
    assert wanted_scale(asked, domain) * around / domain.period_u == pytest.approx(30.0, rel=0.03)
    assert cell_scale(asked, domain) == pytest.approx(domain.period_u / round(around / 30.0))


def test_the_period_left_out_is_the_joints_and_a_scale_is_taken_as_it_is(domain):
    length = map_length(domain.vertices, domain.triangles, domain.uv, domain.cut_triangles)
    assert wanted_scale(PatternSettings(), domain) * np.median(length) == pytest.approx(
        CELL_PERIOD_MM["knee"]
    )
    assert wanted_scale(PatternSettings(scale=0.08), domain) == 0.08
