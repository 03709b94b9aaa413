"""Pattern and solid of a whole sleeve against what the issue asks of them."""

from __future__ import annotations

import io

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from hilbrace.config import MaterialSettings, PatternSettings, SolidSettings
from hilbrace.pattern.build import build_pattern, build_solid, design_fraction, expected_volume
from hilbrace.pattern.checks import is_watertight, measured_thickness, part_count
from hilbrace.pattern.clip import triangle_areas
from hilbrace.pattern.export import stl_bytes
from hilbrace.pattern.level import FRACTION_TOLERANCE
from hilbrace.pattern.thicken import border_edges, folded_triangles, manifold, simplify, surface, thicken
from hilbrace.run.records import pack
from tests.unit.sleeve import sleeve_design, sleeve_domain

DOMAIN = sleeve_domain(around=48, along=14, height_mm=110.0)
SETTINGS = PatternSettings.model_validate(
    {"resolution_mm": 1.1, "min_strut_mm": 2.0, "scale": 0.1, "blend_mm": 25.0}
)
MATERIAL = MaterialSettings.model_validate({})
SOLID = SolidSettings.model_validate({})
DESIGN = sleeve_design(DOMAIN, SETTINGS)


@pytest.fixture(scope="module")
def pattern():
    return build_pattern(DOMAIN, DESIGN, SETTINGS, MATERIAL)


@pytest.fixture(scope="module")
def solid(pattern):
    return build_solid(pattern, DOMAIN, DESIGN, MATERIAL, SOLID)


def test_area_fraction_is_the_designs(pattern):
    assert pattern.area_fraction == pytest.approx(design_fraction(DOMAIN, DESIGN), rel=2 * FRACTION_TOLERANCE)
    area = triangle_areas(DOMAIN.vertices, DOMAIN.triangles).sum()
    own = triangle_areas(pattern.vertices, pattern.triangles).sum()
    assert own / area == pytest.approx(pattern.area_fraction, abs=2e-3)


def test_struts_and_lands_are_the_whole_skin_on_one_line_of_points(pattern):
    points = np.concatenate([pattern.vertices, pattern.land_vertices])
    whole = np.concatenate([pattern.triangles, pattern.land_triangles])
    area = triangle_areas(DOMAIN.vertices, DOMAIN.triangles).sum()
    assert triangle_areas(points, whole).sum() == pytest.approx(area, rel=1e-12)
    ends = np.concatenate([DOMAIN.upper_loop, DOMAIN.lower_loop])
    away = cKDTree(DOMAIN.vertices[ends]).query(points[np.unique(border_edges(whole))])[0]
    edge = np.linalg.norm(np.diff(DOMAIN.vertices[DOMAIN.upper_loop], axis=0), axis=1).max()
    assert away.max() < edge
    assert len(np.unique(whole)) == len(points)
    assert igl.euler_characteristic(whole) == 0
    steps = whole[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(steps, axis=0)) == len(steps)


def test_struts_are_wide_enough_by_an_independent_measure(pattern):
    """Discs of the least width that fit between the borders cover the struts (morphological opening)."""
    assert pattern.strut_width_min_mm >= SETTINGS.min_strut_mm
    assert pattern.strut_width_median_mm >= pattern.strut_width_min_mm
    rng = np.random.default_rng(0)
    corners = pattern.vertices[pattern.triangles]
    area = triangle_areas(pattern.vertices, pattern.triangles)
    owner = rng.choice(len(area), 600_000, p=area / area.sum())
    points = np.einsum("pk,pkx->px", rng.dirichlet([1, 1, 1], len(owner)), corners[owner])
    ends = pattern.vertices[border_edges(pattern.triangles)]
    edge = np.concatenate(
        [(1 - t) * ends[:, 0] + t * ends[:, 1] for t in np.linspace(0, 1, 8, endpoint=False)]
    )
    radius = 0.9 * SETTINGS.min_strut_mm / 2
    centres = points[cKDTree(edge).query(points)[0] >= radius]
    uncovered = cKDTree(centres).query(points[::4])[0] > radius + 0.2
    assert uncovered.mean() < 5e-4


def test_solid_is_one_sound_body(solid):
    assert solid.watertight
    assert solid.parts == 1
    assert solid.manifold_status == "NoError"
    assert solid.folded_triangles == 0
    assert solid.genus > 100
    assert solid.thickness_p01_mm > 0.97 * MATERIAL.thickness_mm
    mesh = trimesh.Trimesh(solid.vertices, solid.triangles, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(solid.volume_mm3, rel=1e-9)
    assert mesh.body_count == 1
    assert solid.mass_g == pytest.approx(solid.volume_mm3 / 1000 * MATERIAL.density_g_per_ml)


def test_volume_is_mid_surface_times_fraction_times_thickness(solid):
    assert solid.expected_volume_mm3 == pytest.approx(expected_volume(DOMAIN, DESIGN, MATERIAL.thickness_mm))
    assert solid.volume_mm3 == pytest.approx(solid.expected_volume_mm3, rel=0.03)


def test_inner_face_lies_on_the_skin(solid):
    squared = igl.point_mesh_squared_distance(solid.vertices[::20], DOMAIN.vertices, DOMAIN.triangles)[0]
    distance = np.sqrt(squared)
    near_inner = distance < MATERIAL.thickness_mm / 2
    assert 0.3 < near_inner.mean() < 0.7
    assert distance[near_inner].max() <= 2 * SOLID.simplify_mm
    assert distance[~near_inner] == pytest.approx(MATERIAL.thickness_mm, abs=0.2)


def test_bands_close_both_ends(pattern):
    for y in (-51.0, 51.0):
        ring = pattern.vertices[np.abs(pattern.vertices[:, 1] - y) < 1.5]
        angles = np.sort(np.arctan2(ring[:, 2], ring[:, 0]))
        assert np.diff(angles).max() < 0.1


def test_same_design_gives_the_same_bytes(pattern, solid):
    again = build_pattern(DOMAIN, DESIGN, SETTINGS, MATERIAL)
    assert pack(again) == pack(pattern)
    body = build_solid(again, DOMAIN, DESIGN, MATERIAL, SOLID)
    assert pack(body) == pack(solid)
    assert stl_bytes(body.vertices, body.triangles) == stl_bytes(solid.vertices, solid.triangles)


def test_stl_of_the_solid_reads_back_closed(solid):
    mesh = trimesh.load(io.BytesIO(stl_bytes(solid.vertices, solid.triangles)), file_type="stl")
    assert mesh.volume == pytest.approx(solid.volume_mm3, rel=1e-4)


@pytest.mark.parametrize(
    ("flatten", "firm", "d"), [("lscm", None, None), ("periodic", 1.0, 0.8), ("periodic", 0.0, 0.6)]
)
def test_other_designs_and_the_free_seam_give_one_body(flatten, firm, d):
    domain = sleeve_domain(around=40, along=14, height_mm=110.0, flatten=flatten)
    settings = SETTINGS.model_copy(update={"resolution_mm": 1.375, "min_strut_mm": 2.5})
    design = sleeve_design(domain, settings, d=d, firm=firm)
    made = build_pattern(domain, design, settings, MATERIAL)
    body = build_solid(made, domain, design, MATERIAL, SOLID)
    assert (body.watertight, body.parts, body.manifold_status) == (True, 1, "NoError")
    assert made.strut_width_min_mm >= 2.5
    assert body.volume_mm3 == pytest.approx(body.expected_volume_mm3, rel=0.03)


def test_offset_of_a_cylinder_has_the_exact_volume():
    turn, y = np.meshgrid(np.arange(720) / 720 * 2 * np.pi, [0.0, 10.0, 20.0], indexing="ij")
    vertices = np.stack([50 * np.sin(turn), y, 50 * np.cos(turn)], -1).reshape(-1, 3)
    normals = vertices * [1, 0, 1] / 50
    a = (np.arange(720)[:, None] * 3 + np.arange(2)).ravel()
    b = (a + 3) % len(vertices)
    triangles = np.concatenate([np.stack([a, b, b + 1], 1), np.stack([a, b + 1, a + 1], 1)])
    body = manifold(*thicken(vertices, normals, triangles, 4.0))
    assert body.volume() == pytest.approx(np.pi * (54**2 - 50**2) * 20, rel=1e-4)
    assert folded_triangles(vertices, normals, triangles, 4.0) == 0
    assert folded_triangles(vertices, -normals, triangles, 60.0) > 0
    assert part_count(body) == 1
    corners = triangles[::7]
    measured = measured_thickness(body, vertices[corners].mean(axis=1), normals[corners].mean(axis=1), 8.0)
    assert measured == pytest.approx(4.0, abs=1e-3)
    faces = surface(simplify(body, 0.01))[1]
    assert is_watertight(faces)
    assert not is_watertight(faces[1:])
