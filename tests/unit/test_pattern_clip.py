"""Cutting along a zero line: a manifold for any field, exact for linear ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.pattern.border import border, hole_numbers, slit_widths, strut_widths
from hilbrace.pattern.checks import is_watertight
from hilbrace.pattern.clip import SNAP_MM, cut_out, solid_fraction, triangle_areas, zero_line
from hilbrace.pattern.refine import refine
from hilbrace.pattern.thicken import border_edges, manifold, thicken
from tests.unit.sleeve import sleeve_domain

SKIN = refine(sleeve_domain(around=24, along=12), 8.0)
FINE = refine(sleeve_domain(around=60, along=33), 1.5)
AREAS = triangle_areas(SKIN.vertices, SKIN.triangles)


def _bumps(seed, coarse):
    rng = np.random.default_rng(seed)
    waves = rng.normal(0, coarse, (6, 3))
    return np.sin(SKIN.vertices @ waves.T + rng.uniform(0, 6, 6)).sum(axis=1) + rng.normal(
        0, 0.3, len(SKIN.vertices)
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.01, 0.05, 0.3]), st.booleans())
def test_any_field_cuts_out_a_manifold(seed, coarse, with_zeros):
    depth = _bumps(seed, coarse)
    if with_zeros:
        depth[np.random.default_rng(seed).random(len(depth)) < 0.3] = 0.0
    if not (depth > 0).any():
        return
    line = zero_line(SKIN, depth)
    piece = cut_out(SKIN, line)
    points, faces = thicken(piece.vertices, piece.normals, piece.triangles, 3.0)
    assert is_watertight(faces)
    assert manifold(points, faces).volume() > 0
    # every border vertex has one way in and one way out
    ends = np.bincount(border_edges(piece.triangles)[:, 0], minlength=len(piece.vertices))
    assert ends.max(initial=0) <= 1
    area = triangle_areas(piece.vertices, piece.triangles).sum()
    assert solid_fraction(SKIN, line.depth, AREAS) == pytest.approx(area / AREAS.sum(), rel=1e-9)


def test_linear_field_is_cut_on_its_plane():
    piece = cut_out(SKIN, zero_line(SKIN, SKIN.vertices[:, 1] - 7.3))
    rim = piece.vertices[np.unique(border_edges(piece.triangles))]
    lower = rim[rim[:, 1] < 50]
    assert lower[:, 1] == pytest.approx(7.3, abs=2 * SNAP_MM)


def test_segments_run_with_the_solid_on_their_left():
    line = zero_line(SKIN, _bumps(3, 0.05))
    edge = border(SKIN, line, hole_numbers(SKIN, line))
    solid = SKIN.vertices[line.inner[line.segments[:, 0]]]
    cut = len(line.segments)
    ahead = ((solid - edge.start[:cut]) * edge.inward[:cut]).sum(axis=1)
    assert (ahead > -1e-9).mean() > 0.999


@pytest.mark.parametrize("width", [2.0, 3.5])
def test_hoops_have_their_width_and_gap(width):
    pitch = 9.0
    y = FINE.vertices[:, 1]
    depth = width / 2 - np.abs(np.mod(y + pitch / 2, pitch) - pitch / 2)
    line = zero_line(FINE, depth)
    edge = border(FINE, line, hole_numbers(FINE, line))
    inner = np.abs(edge.middle[:, 1]) < 90
    # the flanks slope a little against the y axis, so widths along the skin are a little larger
    assert np.median(strut_widths(edge, 6.0)[inner]) == pytest.approx(width, rel=0.06)
    assert np.median(slit_widths(edge, 12.0)[inner]) == pytest.approx(pitch - width, rel=0.06)


def test_holes_are_numbered_apart():
    y = SKIN.vertices[:, 1]
    hole = hole_numbers(SKIN, zero_line(SKIN, np.where(np.abs(y) < 40, 1.0, -1.0)))
    assert set(np.unique(hole)) == {-1, 0, 1}
    assert len(np.unique(np.sign(y[hole == 0]))) == 1
