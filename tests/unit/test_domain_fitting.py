from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.domain.build import build_domain
from hilbrace.domain.edges import edges_at
from hilbrace.domain.fitting import compress, find_reliefs, harmonic_height, level_centres, relieve
from hilbrace.domain.landmarks import find_landmark
from hilbrace.domain.limb import Surface, find_limb, limb_skin, skin_order
from hilbrace.domain.loops import loop_length, loops_of
from hilbrace.domain.region import cut_region
from hilbrace.domain.rest import rest_domain
from hilbrace.errors import ConfigError, GeometryError
from tests.unit.domain_body import bending, domain_settings, sleeve, synthetic_body, upright_limb


def region_of(joint, edge_mm=8.0):
    body = synthetic_body()
    limb = find_limb(body, joint, "right")
    skin = limb_skin(body, limb)
    return body, limb, skin, cut_region(skin, limb, edges_at(limb, None, None), edge_mm)


def relieved(joint, edge_mm=6.0, **keys):
    body, limb, skin, region = region_of(joint, edge_mm)
    wanted = domain_settings(reliefs=[keys]).reliefs
    reliefs = find_reliefs(region, skin, limb, skin_order(body, limb), wanted)
    return limb, skin, region, relieve(region, reliefs)


def girth(surface, height):
    """Length of a horizontal section, and of the section at a height [mm]."""
    low, high = surface.vertices[surface.triangles], np.roll(surface.vertices[surface.triangles], -1, axis=1)
    met = (low[..., 1] > height) != (high[..., 1] > height)
    rows = met.sum(axis=1) == 2
    part = (height - low[..., 1]) / np.where(met, high[..., 1] - low[..., 1], 1.0)
    points = (low + part[..., None] * (high - low))[rows][met[rows]].reshape(-1, 2, 3)
    return np.linalg.norm(points[:, 0] - points[:, 1], axis=1).sum()


@settings(max_examples=15, deadline=None)
@given(percent=st.floats(0.5, 39.0), low=st.floats(40.0, 70.0), high=st.floats(50.0, 90.0))
def test_on_a_cone_compression_scales_the_radius(percent, low, high):
    region = Surface(*sleeve(low, high, 300.0, around=48, along=40))
    fit = compress(region, loops_of(region, upright_limb()), percent)
    exact = region.vertices * [1.0 - percent / 100.0, 1.0, 1.0 - percent / 100.0]
    assert np.abs(fit.rest.vertices - exact).max() < 0.05 * percent / 100.0 * low
    assert np.array_equal(fit.worn, region.vertices)


@pytest.mark.parametrize("joint", ["knee", "ankle"])
def test_both_edges_lose_exactly_the_percentage_however_the_limb_bends(joint):
    _, limb, _, region = region_of(joint)
    loops = loops_of(region, limb)
    fit = compress(region, loops, 7.0)
    for loop in (loops.upper, loops.lower):
        assert np.isclose(loop_length(fit.rest, loop), 0.93 * loop_length(region, loop), rtol=1e-9)
    if joint == "knee":
        for height in np.linspace(-120.0, 120.0, 9):
            assert np.isclose(girth(fit.rest, height), 0.93 * girth(region, height), rtol=0.01)


def test_the_harmonic_height_of_a_cylinder_is_its_height_and_its_axis_is_straight():
    region = Surface(*sleeve(50.0, 50.0, 240.0, around=48, along=24))
    loops = loops_of(region, upright_limb())
    height = harmonic_height(region, loops)
    assert np.allclose(height, region.vertices[:, 1] / 240.0, atol=1e-9)
    centres = level_centres(region, loops, height)
    assert np.allclose(centres[:, [0, 2]], 0.0, atol=1e-9)
    assert np.allclose(centres[:, 1], np.linspace(0.0, 240.0, len(centres)), atol=1e-9)


def test_the_compressed_mesh_keeps_its_quality_and_knows_where_it_is_worn():
    body = synthetic_body()
    keys = {"side": "right", "triangles": 1500, "seam_azimuth_deg": 90.0}
    rest = rest_domain(body, domain_settings(compression_percent=6.0, windows=[{"at": "patella"}], **keys))
    plain = rest_domain(body, domain_settings(windows=[{"at": "patella"}], **keys))
    for name in ("upper", "lower"):
        made, skin = (loop_length(r.surface, getattr(r.loops, name)) for r in (rest, plain))
        assert np.isclose(made, 0.94 * skin, rtol=2e-3)
    worn = Surface(rest.worn, rest.surface.triangles)
    assert np.isclose(
        loop_length(worn, rest.loops.upper), loop_length(plain.surface, plain.loops.upper), rtol=2e-3
    )
    away = np.linalg.norm(rest.worn - rest.surface.vertices, axis=1)
    assert 1.5 < np.median(away) < 5.0
    assert plain.worn is plain.surface.vertices


def test_the_worn_brace_is_stretched_around_by_what_compression_took():
    body = synthetic_body()
    wanted = domain_settings(compression_percent=8.0, side="right", triangles=1500, frames_per_second=100.0)
    domain = build_domain(body, bending(body, [0.0, 30.0], "right"), wanted)
    values = np.linalg.svd(domain.deformation[0], compute_uv=False)
    assert np.isclose(np.median(values[:, 0]), 1.0 / 0.92, atol=0.005)
    assert np.isclose(np.median(values[:, 1]), 1.0, atol=0.01)


def test_compression_that_folds_the_instep_is_refused():
    _, limb, _, region = region_of("ankle")
    with pytest.raises(GeometryError, match="would fold") as caught:
        compress(region, loops_of(region, limb), 97.0)
    assert "domain.compression_percent" in caught.value.two_lines()


@pytest.mark.parametrize("height", [6.0, -4.0])
def test_a_relief_stands_off_by_its_height_in_the_middle_and_not_at_all_outside(height):
    limb, skin, before, after = relieved("knee", at="patella", height_mm=height, radius_mm=35.0)
    moved = np.linalg.norm(after.vertices - before.vertices, axis=1)
    middle = find_landmark(skin, limb, "patella", "here").position
    away = np.linalg.norm(before.vertices - middle, axis=1)
    assert np.isclose(moved.max(), abs(height), rtol=0.06)
    assert away[np.argmax(moved)] < 8.0
    assert moved[away > 40.0].max() == 0.0
    expected = abs(height) * np.clip(1.0 - (away / 35.0) ** 2, 0.0, None) ** 2
    assert np.abs(moved - expected).max() < 0.12 * abs(height)
    forward = (after.vertices - before.vertices)[np.argmax(moved), 0]
    assert np.sign(forward) == np.sign(height)


def test_a_painted_relief_reaches_its_height_and_fades_out(tmp_path):
    body = synthetic_body()
    limb = find_limb(body, "ankle", "right")
    mark = find_landmark(limb_skin(body, limb), limb, "lateral_malleolus", "here").position
    away = np.linalg.norm(limb.inwards(body.vertices) - mark, axis=1)
    (tmp_path / "spot.txt").write_text(" ".join(map(str, np.flatnonzero(away < 25.0))))
    _, _, before, after = relieved("ankle", painted=tmp_path / "spot.txt", height_mm=4.0, radius_mm=15.0)
    moved = np.linalg.norm(after.vertices - before.vertices, axis=1)
    far = np.linalg.norm(before.vertices - mark, axis=1) > 90.0
    assert np.isclose(moved.max(), 4.0, rtol=0.1)
    assert moved[far].max() < 0.1


def test_reliefs_that_fold_or_miss_are_refused():
    with pytest.raises(GeometryError, match="would fold"):
        relieved("knee", 4.0, at="patella", height_mm=30.0, radius_mm=16.0)
    with pytest.raises(GeometryError, match="outside the sleeve, or is too small"):
        relieved("knee", 14.0, at="patella", height_mm=3.0, radius_mm=5.0)
    with pytest.raises(ConfigError, match="by a landmark or by paint"):
        relieved("knee", height_mm=3.0)
    with pytest.raises(ConfigError, match="no landmark 'heel'"):
        relieved("knee", at="heel", height_mm=3.0)
