"""The refined skin: welded, faithful to the domain, closed across the seam."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.config import MaterialSettings, PatternSettings
from hilbrace.material.strut_width import cell_scale
from hilbrace.pattern.clip import triangle_areas
from hilbrace.pattern.implicit import blended_pattern, vertex_map_length
from hilbrace.pattern.refine import refine, vertex_normals
from tests.unit.sleeve import sleeve_design, sleeve_domain

DOMAIN = sleeve_domain(around=36, along=20)
SETTINGS = PatternSettings.model_validate({"resolution_mm": 3.0})
MATERIAL = MaterialSettings.model_validate({})


@pytest.mark.parametrize("resolution", [20.0, 6.0, 3.0, 1.9])
def test_split_keeps_area_and_topology(resolution):
    skin = refine(DOMAIN, resolution)
    k = round(np.sqrt(len(skin.triangles) / len(DOMAIN.triangles)))
    assert len(skin.triangles) == k * k * len(DOMAIN.triangles)
    assert skin.edge_mm <= resolution or k == 1
    area = triangle_areas(DOMAIN.vertices, DOMAIN.triangles).sum()
    assert triangle_areas(skin.vertices, skin.triangles).sum() == pytest.approx(area, rel=1e-12)
    # an annulus: V - E + F = 0, every vertex used
    assert len(skin.vertices) - len(skin.edges) + len(skin.triangles) == 0
    assert np.array_equal(np.unique(skin.triangles), np.arange(len(skin.vertices)))
    assert len(skin.loop_edges) == k * (len(DOMAIN.upper_loop) + len(DOMAIN.lower_loop))
    for number in np.unique(skin.loop):
        loop = skin.loop_edges[skin.loop == number]
        upper = skin.vertices[loop[0, 0], 1] > 0
        assert len(loop) == k * len(DOMAIN.upper_loop if upper else DOMAIN.lower_loop)
        assert ((skin.vertices[loop, 1] > 0) == upper).all()


def test_values_are_those_of_a_linear_function():
    skin = refine(DOMAIN, 3.0)
    value = DOMAIN.vertices @ [0.3, -1.0, 2.0]
    assert skin.from_vertices(DOMAIN.triangles, value) == pytest.approx(skin.vertices @ [0.3, -1.0, 2.0])
    positions = [
        skin.from_vertices(DOMAIN.cut_triangles, DOMAIN.vertices[DOMAIN.weld][:, k]) for k in range(3)
    ]
    assert np.stack(positions, 1) == pytest.approx(skin.vertices)


def test_normals_point_outwards_and_fit_the_faces():
    p = DOMAIN.vertices[DOMAIN.triangles]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    skin = refine(DOMAIN, 3.0)
    assert np.linalg.norm(skin.normals, axis=1) == pytest.approx(1.0)
    assert (skin.normals * face[skin.parent]).sum(axis=1).min() > 0.97
    assert (vertex_normals(DOMAIN)[:, [0, 2]] * DOMAIN.vertices[:, [0, 2]]).sum(axis=1).min() > 0


def test_periodic_pattern_has_one_value_on_the_seam_from_either_side():
    design = sleeve_design(DOMAIN, SETTINGS, d=0.5, firm=1.0)
    skin = refine(DOMAIN, 3.0)
    left = blended_pattern(DOMAIN, design, skin, SETTINGS, MATERIAL)
    scale = cell_scale(SETTINGS, DOMAIN)
    assert DOMAIN.period_u / scale == pytest.approx(round(DOMAIN.period_u / scale))
    # the same map one period further on: what the vertices would get from the right of the seam
    shifted = type(DOMAIN)(**{**vars(DOMAIN), "uv": DOMAIN.uv + np.array([DOMAIN.period_u, 0.0])})
    right = blended_pattern(shifted, design, skin, SETTINGS, MATERIAL)
    assert right.depth(0.0) == pytest.approx(left.depth(0.0), abs=1e-6)


def test_free_seam_takes_the_left_side():
    domain = sleeve_domain(around=36, along=20, flatten="lscm")
    skin = refine(domain, 3.0)
    right = domain.seam_pairs[:, 1]
    touched = domain.cut_triangles[skin.parent]
    weight_right = (np.isin(touched, right) * skin.barycentric).sum(axis=1)
    on_seam = np.isin(domain.triangles[skin.parent], domain.weld[right])
    whole_on_seam = (on_seam * skin.barycentric).sum(axis=1) > 1 - 1e-9
    assert whole_on_seam.any()
    assert weight_right[whole_on_seam].max() == 0


def test_map_length_is_the_local_stretch():
    length = vertex_map_length(DOMAIN)
    edge = DOMAIN.cut_triangles[:, :2]
    flat = np.linalg.norm(np.diff(DOMAIN.uv[edge], axis=1)[:, 0], axis=1)
    long = np.linalg.norm(np.diff(DOMAIN.vertices[DOMAIN.weld][edge], axis=1)[:, 0], axis=1)
    assert length[DOMAIN.weld][edge].mean(axis=1) == pytest.approx(long / flat, rel=0.08)
