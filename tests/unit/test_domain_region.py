from __future__ import annotations

import dataclasses

import igl
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.domain.edges import edges_at
from hilbrace.domain.limb import Surface, find_limb, limb_skin
from hilbrace.domain.loops import loops_of
from hilbrace.domain.region import cut_region
from hilbrace.errors import GeometryError
from tests.unit.domain_body import HIP, KNEE, mirrored_body, synthetic_body, upright_limb

EDGE = 12.0


def region_of(body, side="right", above=0.4, below=0.38, edge=EDGE, joint="knee"):
    limb = find_limb(body, joint, side)
    return limb, cut_region(limb_skin(body, limb), limb, edges_at(limb, above, below), edge)


def refuse(body, *words, **places):
    with pytest.raises(GeometryError) as caught:
        region_of(body, **places)
    text = caught.value.two_lines()
    for word in words:
        assert word in text
    return caught.value


@settings(max_examples=12, deadline=None)
@given(above=st.floats(0.12, 0.7), below=st.floats(0.12, 0.75), side=st.sampled_from(["left", "right"]))
def test_the_region_is_a_sleeve_with_planar_edges_across_the_segments(above, below, side):
    limb, region = region_of(synthetic_body(), side, above, below)
    loops = loops_of(region, limb)
    upper, lower = loops.upper, loops.lower
    assert not loops.windows
    assert igl.euler_characteristic(region.triangles) == 0
    along = region.vertices[upper] @ limb.upper / np.linalg.norm(limb.upper)
    assert np.allclose(along, above * np.linalg.norm(limb.upper), atol=1e-9)
    along = region.vertices[lower] @ limb.lower / np.linalg.norm(limb.lower)
    assert np.allclose(along, below * np.linalg.norm(limb.lower), atol=1e-9)


def test_coarse_skin_is_refined_and_fine_skin_is_not():
    _, coarse = region_of(synthetic_body(), edge=30.0)
    _, fine = region_of(synthetic_body(), edge=8.0)
    assert len(fine.triangles) > 3.5 * len(coarse.triangles)
    skin = limb_skin(synthetic_body(), find_limb(synthetic_body(), "knee", "right"))
    squared, *_ = igl.point_mesh_squared_distance(fine.vertices, skin.vertices, skin.triangles)
    assert np.sqrt(np.max(squared)) < 2.0


def test_the_left_leg_is_seen_as_a_right_one():
    body = synthetic_body()
    _, right = region_of(body, "right")
    _, left = region_of(mirrored_body(body), "left")
    assert np.array_equal(right.vertices, left.vertices)
    assert np.array_equal(right.triangles, left.triangles)


def test_azimuth_is_anterior_lateral_posterior_medial_on_both_sides():
    body = synthetic_body()
    for side, lateral in (("right", 0.05), ("left", -0.05)):
        limb = find_limb(body, "knee", side)
        around = np.array([[0.05, 0, 0], [0, 0, lateral], [-0.05, 0, 1e-9], [0, 0, -lateral]]) + limb.centre_m
        azimuth = limb.azimuth(limb.inwards(around))
        assert np.allclose(np.cos(azimuth), [1.0, 0.0, -1.0, 0.0], atol=1e-6)
        assert np.allclose(np.sin(azimuth), [0.0, 1.0, 0.0, -1.0], atol=1e-6)


def test_skin_far_from_the_joint_is_refused():
    body = synthetic_body()
    refuse(dataclasses.replace(body, vertices=body.vertices + 3.0), "no skin", "mend")


def test_a_region_that_reaches_the_other_leg_is_refused():
    body = synthetic_body()
    high = dataclasses.replace(body, joint_centres=body.joint_centres.copy())
    high.joint_centres[[0, 3], 1] += 0.15
    refuse(high, "other leg", "domain.above", above=0.79)


def test_a_region_that_reaches_the_foot_is_refused():
    body = synthetic_body()
    low = dataclasses.replace(body, joint_centres=body.joint_centres.copy())
    low.joint_centres[2] += [0.0, -0.165, 0.0]
    fault = refuse(low, "domain.below", below=0.79)
    assert "lower domain.below" in fault.hint


def test_a_hole_in_the_region_is_refused_and_one_elsewhere_is_not():
    body = synthetic_body()
    centre = body.vertices[body.triangles].mean(axis=1)
    at_knee = np.linalg.norm(centre - (KNEE + np.array([0.06, 0.05, 0.0])), axis=1) < 0.03
    refuse(dataclasses.replace(body, triangles=body.triangles[~at_knee]), "1 hole", "fill the holes")
    on_chest = centre[:, 1] > 0.45
    assert on_chest.any()
    region_of(dataclasses.replace(body, triangles=body.triangles[~on_chest]))


def test_a_scan_that_ends_within_the_region_is_refused():
    body = synthetic_body()
    centre = body.vertices[body.triangles].mean(axis=1)
    scanned = centre[:, 1] < KNEE[1] + 0.3 * (HIP[1] - KNEE[1])
    refuse(
        dataclasses.replace(body, triangles=body.triangles[scanned]),
        "the skin ends",
        "domain.above",
        "on the skin",
    )


def test_torn_skin_is_refused():
    body = synthetic_body()
    centre = body.vertices[body.triangles].mean(axis=1)
    at = np.argsort(np.linalg.norm(centre - KNEE, axis=1))[:5]
    turned = body.triangles.copy()
    turned[at] = turned[at][:, ::-1]
    refuse(dataclasses.replace(body, triangles=turned), "torn", "repair")
    doubled = np.concatenate([body.triangles, body.triangles[at]])
    refuse(dataclasses.replace(body, triangles=doubled), "torn", "repair")


def test_skin_beside_the_axis_is_refused():
    body = synthetic_body()
    beside = dataclasses.replace(body, vertices=body.vertices + np.array([0.12, 0.0, 0.0]))
    refuse(beside, "does not go around", "one frame")


@pytest.mark.malformed
def test_a_body_without_a_joint_or_upside_down_is_refused():
    body = synthetic_body()
    short = dataclasses.replace(
        body, joint_names=body.joint_names[:-1], joint_centres=body.joint_centres[:-1]
    )
    with pytest.raises(GeometryError, match="ankle_l"):
        find_limb(short, "knee", "left")
    with pytest.raises(GeometryError, match="make no leg"):
        find_limb(dataclasses.replace(body, joint_centres=-body.joint_centres), "knee", "left")


def test_a_closed_surface_has_no_loops():
    ball = trimesh.creation.icosphere(subdivisions=1)
    with pytest.raises(GeometryError, match="this surface has 0"):
        loops_of(Surface(np.array(ball.vertices), np.array(ball.faces, np.int64)), upright_limb())
