"""The clean-up on patterns with known faults."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.errors import GeometryError
from hilbrace.pattern.axis import strut_axis
from hilbrace.pattern.border import border, hole_numbers, strut_widths
from hilbrace.pattern.clean import (
    clean,
    close_slits,
    depth_in_balls,
    drop_islands,
    shave_bumps,
    widen_and_prune,
)
from hilbrace.pattern.clip import triangle_areas, zero_line
from hilbrace.pattern.refine import refine
from tests.unit.sleeve import sleeve_domain

DOMAIN = sleeve_domain(around=48, along=12, height_mm=90.0)
SKIN = refine(DOMAIN, 1.2)
AREAS = triangle_areas(SKIN.vertices, SKIN.triangles)
Y = SKIN.vertices[:, 1]
ARC = np.arctan2(SKIN.vertices[:, 2], SKIN.vertices[:, 0]) * 70.0
NO_RIM = np.full(len(Y), -50.0)
RIM = 8.0 - (45.0 - np.abs(Y))


def _ladder(width, pitch=14.0):
    """Bars along the limb between two bands."""
    return np.maximum(width / 2 - np.abs(np.mod(ARC + pitch / 2, pitch) - pitch / 2), RIM)


def _widths(depth):
    line = zero_line(SKIN, depth)
    return strut_widths(border(SKIN, line, hole_numbers(SKIN, line)), 8.0)


def test_narrow_struts_are_widened_not_broken():
    depth = widen_and_prune(SKIN, zero_line(SKIN, _ladder(1.7)), RIM, 3.0)
    holes = hole_numbers(SKIN, zero_line(SKIN, _ladder(1.7))).max()
    assert hole_numbers(SKIN, zero_line(SKIN, depth)).max() == holes
    assert _widths(_ladder(1.7)).min() < 2.5
    assert _widths(depth).min() > 2.9


def test_wide_struts_keep_their_width():
    depth = widen_and_prune(SKIN, zero_line(SKIN, _ladder(5.0)), RIM, 2.0)
    middle = np.abs(Y) < 30
    before, after = (d[middle] > 0 for d in (_ladder(5.0), depth))
    assert (before == after).mean() > 0.995


def test_dead_ends_go_and_through_struts_stay():
    thorn = np.minimum(1.5 - np.abs(Y - 5), 6.0 - np.abs(ARC - 5))
    with_thorn = np.maximum(_ladder(3.0), thorn)
    tip = (np.abs(Y - 5) < 1) & (ARC > 4.5) & (ARC < 7)
    assert (with_thorn[tip] > 0).all()
    depth = widen_and_prune(SKIN, zero_line(SKIN, with_thorn), RIM, 2.0)
    assert (depth[tip] < 0).all()
    away = np.abs(ARC - 5) > 12
    assert ((depth > 0) == (with_thorn > 0))[away].mean() > 0.995


def test_axis_runs_along_the_middle_of_the_bars():
    axis = strut_axis(SKIN, zero_line(SKIN, _ladder(4.0)))
    middle = axis.points[np.abs(axis.points[:, 1]) < 25]
    arc = np.arctan2(middle[:, 2], middle[:, 0]) * 70.0
    assert np.abs(np.mod(arc + 7, 14) - 7).max() < 0.25
    radius = axis.radius[np.abs(axis.points[:, 1]) < 25]
    span = np.linalg.norm(middle[:, [0, 2]], axis=1) / 70.0
    assert radius == pytest.approx(2.0 * span, rel=0.15)


def test_slits_are_closed_and_holes_are_not():
    depth = -np.minimum(0.35 - np.abs(Y), 12.0 - np.abs(ARC))
    depth = np.minimum(depth, -np.minimum(4.0 - np.abs(Y), 4.0 - np.abs(ARC - 60)))
    closed = close_slits(SKIN, zero_line(SKIN, depth), 1.5)
    slit, hole = (np.abs(ARC) < 11) & (np.abs(Y) < 3), (np.abs(ARC - 60) < 3) & (np.abs(Y) < 3)
    assert (closed[slit] > 0).all()
    assert (closed[hole] < 0).all()
    assert np.array_equal(close_slits(SKIN, zero_line(SKIN, depth), 0.0), zero_line(SKIN, depth).depth)


def test_bumps_are_shaved_and_walls_stand():
    bump = np.minimum(0.6 - np.abs(Y), 4.5 - ARC)
    wall = -np.abs(ARC) + 3.0
    shaved = shave_bumps(SKIN, zero_line(SKIN, np.maximum(wall, bump * (ARC > 0) - (ARC <= 0))), NO_RIM, 2.4)
    assert (shaved[(np.abs(ARC) < 2) & (np.abs(Y) < 30)] > 0).all()
    assert (shaved[(np.abs(Y) < 0.4) & (ARC > 4) & (ARC < 4.4)] <= 0).all()


def test_islands_are_dropped_and_halves_are_refused():
    island = 3.0 - np.hypot(ARC - 7, Y)
    depth, dropped = drop_islands(SKIN, np.maximum(_ladder(3.0), island), AREAS)
    assert dropped == 1
    assert (depth[np.hypot(ARC - 7, Y) < 2] < 0).all()
    with pytest.raises(GeometryError, match="fall into 2 pieces"):
        drop_islands(SKIN, RIM, AREAS)


def test_depth_in_balls_is_that_of_the_best_ball():
    rng = np.random.default_rng(0)
    points, centres, radius = (
        rng.uniform(0, 10, (400, 3)),
        rng.uniform(0, 10, (30, 3)),
        rng.uniform(0.5, 3, 30),
    )
    distance = np.linalg.norm(points[:, None] - centres, axis=2)
    inside = (distance <= radius).any(axis=1)
    depth = depth_in_balls(points, centres, radius)
    assert np.array_equal(depth >= 0, inside)
    assert (depth <= (radius - distance).max(axis=1) + 1e-9).all()


def test_all_together_leaves_no_strut_too_narrow():
    rng = np.random.default_rng(5)
    ragged = _ladder(3.0) + rng.normal(0, 0.15, len(Y))
    depth = clean(SKIN, ragged, RIM, AREAS, 2.4, 1.0)
    assert np.percentile(_widths(depth), 0.5) > 2.3
    even = clean(SKIN, _ladder(3.0), RIM, AREAS, 2.4, 1.0)
    assert hole_numbers(SKIN, zero_line(SKIN, depth)).max() == hole_numbers(SKIN, zero_line(SKIN, even)).max()
