from __future__ import annotations

import igl
import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.domain.isoline import compact, cut_by_plane, mesh_edges, split_at_zero

BALL = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
POINTS = np.array(BALL.vertices)
FACES = np.array(BALL.faces, np.int64)


def area_vectors(vertices, triangles):
    corner = vertices[triangles]
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2.0


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_splitting_keeps_the_surface_and_its_topology(seed):
    levels = POINTS @ np.random.default_rng(seed).normal(size=3) + 0.2 * np.sin(5.0 * POINTS[:, 0])
    levels[np.random.default_rng(seed).integers(0, len(POINTS), 40)] = 0.0
    vertices, triangles, new_levels = split_at_zero(POINTS, FACES, levels)
    before, after = area_vectors(POINTS, FACES), area_vectors(vertices, triangles)
    assert np.isclose(np.linalg.norm(after, axis=1).sum(), np.linalg.norm(before, axis=1).sum(), rtol=1e-12)
    assert np.allclose(after.sum(axis=0), 0.0, atol=1e-12)
    corner = new_levels[triangles]
    assert not ((corner.max(axis=1) > 0.0) & (corner.min(axis=1) < 0.0)).any()
    assert igl.euler_characteristic(triangles) == 2
    assert not igl.boundary_loop_all(triangles)
    edges, _ = mesh_edges(triangles)
    assert 3 * len(triangles) == 2 * len(edges)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), offset=st.floats(-0.8, 0.8))
def test_a_plane_leaves_a_cap_with_one_planar_edge_and_no_slivers(seed, offset):
    normal = np.random.default_rng(seed).normal(size=3)
    normal /= np.linalg.norm(normal)
    edge = 0.14
    vertices, triangles = cut_by_plane(POINTS, FACES, normal, offset, 0.1 * edge)
    loops = igl.boundary_loop_all(triangles)
    assert len(loops) == 1
    assert np.abs(vertices[loops[0]] @ normal - offset).max() < 1e-12
    assert (vertices @ normal).max() < offset + 1e-12
    cap = 2.0 * np.pi * (1.0 + offset)
    assert np.isclose(
        np.linalg.norm(area_vectors(vertices, triangles), axis=1).sum(), cap, rtol=0.03, atol=0.02
    )
    assert np.degrees(np.asarray(igl.internal_angles(vertices, triangles))).min() > 2.0


def test_a_plane_beside_the_mesh_changes_nothing():
    vertices, triangles = cut_by_plane(POINTS, FACES, np.array([0.0, 1.0, 0.0]), 2.0, 0.01)
    assert np.array_equal(vertices, POINTS)
    assert np.array_equal(np.sort(triangles, axis=0), np.sort(FACES, axis=0))


def test_compacting_keeps_the_shape_of_what_is_kept():
    keep = np.zeros(len(FACES), bool)
    keep[[3, 50, 51]] = True
    vertices, triangles = compact(POINTS, FACES, keep)
    assert np.array_equal(vertices[triangles], POINTS[FACES[keep]])
    assert len(vertices) == len(np.unique(FACES[keep]))
