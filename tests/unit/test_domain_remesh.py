from __future__ import annotations

import igl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.domain.limb import Surface
from hilbrace.domain.loops import loops_of
from hilbrace.domain.remesh import TOLERANCE, edge_for, mesh_quality, remesh, surface_area
from hilbrace.errors import GeometryError
from tests.unit.domain_body import outwardness, sleeve, upright_limb


def test_quality_of_equilateral_triangles():
    root = np.sqrt(3.0)
    points = np.array([[0, 0, 0], [2, 0, 0], [1, root, 0], [3, root, 0]], float)
    quality = mesh_quality(Surface(points, np.array([[0, 1, 2], [1, 3, 2]])))
    assert quality.triangles == 2
    assert np.isclose(quality.min_angle_deg, 60.0)
    assert np.isclose(quality.edge_mean_mm, 2.0)
    assert quality.edge_variation < 1e-12
    assert np.isclose(edge_for(2 * root, 2), 2.0)


@settings(max_examples=8, deadline=None)
@given(count=st.integers(400, 6000), low=st.floats(40.0, 70.0), high=st.floats(50.0, 90.0))
def test_the_count_is_met_with_even_triangles_and_the_shape_is_kept(count, low, high):
    region = Surface(*sleeve(low, high, 300.0, around=96, along=60, uneven=0.3))
    mesh = remesh(region, count)
    quality = mesh_quality(mesh)
    assert abs(quality.triangles / count - 1.0) <= TOLERANCE
    assert quality.min_angle_deg >= 20.0
    assert quality.edge_variation < 0.25
    assert igl.euler_characteristic(mesh.triangles) == 0
    assert outwardness(mesh.vertices, mesh.triangles) == 1.0
    assert np.isclose(surface_area(mesh), surface_area(region), rtol=0.03)
    radius = np.linalg.norm(mesh.vertices[:, [0, 2]], axis=1)
    assert (
        np.abs(radius - (low + (high - low) * mesh.vertices[:, 1] / 300.0)).max()
        < 0.08 * quality.edge_mean_mm
    )


def test_the_edges_stay_where_they_are():
    mesh = remesh(Surface(*sleeve(55.0, 75.0, 280.0, around=96, along=60)), 3000)
    loops = loops_of(mesh, upright_limb())
    for loop, radius, height in ((loops.upper, 75.0, 280.0), (loops.lower, 55.0, 0.0)):
        points = mesh.vertices[loop]
        assert np.allclose(points[:, 1], height, atol=1e-6)
        assert np.abs(np.linalg.norm(points[:, [0, 2]], axis=1) - radius).max() < 0.1
        length = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum()
        assert np.isclose(length, 2.0 * np.pi * radius, rtol=0.01)


def test_meshing_twice_gives_the_same_bytes():
    region = Surface(*sleeve(55.0, 75.0, 280.0, around=48, along=30))
    first, second = remesh(region, 1500), remesh(region, 1500)
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.triangles.tobytes() == second.triangles.tobytes()


def test_an_impossible_count_is_refused():
    with pytest.raises(GeometryError, match="no mesh of 7 triangles"):
        remesh(Surface(*sleeve(55.0, 75.0, 280.0)), 7)
