from __future__ import annotations

import igl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.domain.limb import Surface
from hilbrace.domain.loops import loops_of
from hilbrace.domain.remesh import mesh_quality, remesh
from hilbrace.domain.seam import cut_along, find_seam
from hilbrace.errors import GeometryError
from tests.unit.domain_body import sleeve, upright_limb

LIMB = upright_limb()
EVEN = remesh(Surface(*sleeve(55.0, 75.0, 280.0, around=96, along=60)), 2000)


def seam_at(surface, azimuth):
    return find_seam(surface, LIMB, loops_of(surface, LIMB), azimuth)


@settings(max_examples=20, deadline=None)
@given(azimuth=st.floats(-360.0, 360.0))
def test_the_seam_runs_from_loop_to_loop_near_its_azimuth(azimuth):
    loops = loops_of(EVEN, LIMB)
    upper, lower = loops.upper, loops.lower
    path = seam_at(EVEN, azimuth)
    assert path[0] in lower
    assert path[-1] in upper
    assert not np.isin(path[1:-1], np.concatenate([upper, lower])).any()
    assert len(np.unique(path)) == len(path)
    points = EVEN.vertices[path]
    turn = np.radians(azimuth)
    across = points[:, 2] * np.cos(turn) - points[:, 0] * np.sin(turn)
    assert np.abs(across).max() < 1.3 * mesh_quality(EVEN).edge_mean_mm
    assert (points[:, 0] * np.cos(turn) + points[:, 2] * np.sin(turn) > 0.0).all()
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert length < 1.25 * np.hypot(280.0, 20.0)


def test_on_a_regular_grid_the_seam_is_the_straight_line():
    surface = Surface(*sleeve(60.0, 60.0, 240.0, around=24, along=12))
    points = surface.vertices[seam_at(surface, 90.0)]
    assert np.allclose(points[:, [0, 2]], [0.0, 60.0], atol=1e-9)
    assert np.allclose(points[:, 1], np.arange(13) * 20.0)


@settings(max_examples=10, deadline=None)
@given(azimuth=st.floats(0.0, 360.0))
def test_cutting_opens_a_disc_and_doubles_only_the_seam(azimuth):
    path = seam_at(EVEN, azimuth)
    cut = cut_along(EVEN, path)
    assert igl.euler_characteristic(cut.triangles) == 1
    assert len(igl.boundary_loop_all(cut.triangles)) == 1
    assert np.array_equal(cut.weld[cut.triangles], EVEN.triangles)
    assert np.array_equal(cut.weld[cut.pairs], np.stack([path, path], axis=1))
    opened = EVEN.vertices[cut.weld]
    assert np.linalg.norm(opened[cut.pairs[:, 0]] - opened[cut.pairs[:, 1]], axis=1).max() == 0.0
    counts = np.bincount(cut.weld)
    assert set(np.flatnonzero(counts == 2)) == set(path)
    assert counts.max() == 2


def test_the_left_edge_of_the_map_lies_to_the_right_of_the_seam():
    """Seen from outside, proximal up; a posterior seam is seen from -x, where +z is to the right."""
    surface = Surface(*sleeve(60.0, 60.0, 240.0, around=24, along=12))
    cut = cut_along(surface, seam_at(surface, 180.0))
    centres = surface.vertices[surface.triangles].mean(axis=1)
    for place, side in ((0, 1.0), (1, -1.0)):
        touching = np.isin(cut.triangles, cut.pairs[:, place]).any(axis=1)
        assert (np.sign(centres[touching, 2]) == side).all()


def test_a_sleeve_of_one_row_has_no_seam():
    surface = Surface(*sleeve(60.0, 60.0, 20.0, around=24, along=1))
    with pytest.raises(GeometryError, match="no path"):
        seam_at(surface, 180.0)


def test_a_path_that_does_not_reach_the_edge_is_refused():
    path = seam_at(EVEN, 180.0)
    with pytest.raises(GeometryError, match="does not open"):
        cut_along(EVEN, path[:-2])
