from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.domain.limb import Limb, find_limb, limb_skin, skin_order
from hilbrace.errors import GeometryError
from tests.unit.domain_body import ANKLE, KNEE, LEFT, make_body, mirrored_body, synthetic_body


def bent_limb() -> Limb:
    """A shank along y and a foot along x that meet at a right angle."""
    return Limb(
        "ankle",
        "right",
        upper=np.array([0.0, 400.0, 0.0]),
        lower=np.array([200.0, 0.0, 0.0]),
        distal=np.array([1.0, 0.0, 0.0]),
        other=np.array([0.0, 0.0, -150.0]),
        centre_m=np.zeros(3),
    )


@settings(max_examples=30, deadline=None)
@given(height=st.floats(60.0, 390.0), angle=st.floats(-179.0, 179.0), radius=st.floats(5.0, 50.0))
def test_azimuth_and_distance_around_shank_and_foot(height, angle, radius):
    """Around the shank 0 is to the front, around the foot up; both turn to lateral."""
    limb = bent_limb()
    turn = np.radians(angle)
    shank = np.array([radius * np.cos(turn), height, radius * np.sin(turn)])
    foot = np.array([height, radius * np.cos(turn), radius * np.sin(turn)])
    assert np.allclose(np.degrees(limb.azimuth(np.stack([shank, foot]))), angle, atol=1e-9)
    assert np.allclose(limb.distance(np.stack([shank, foot])), radius, atol=1e-9)


def test_behind_the_bend_the_heel_is_at_180_degrees_and_azimuth_does_not_jump():
    limb = bent_limb()
    turn = np.radians(np.linspace(180.0, 270.0, 91))
    heel = np.stack([60.0 * np.cos(turn), 60.0 * np.sin(turn), np.full(91, 1e-9)], axis=1)
    assert np.allclose(np.degrees(limb.azimuth(heel)), 180.0)
    assert np.allclose(limb.distance(heel), 60.0)
    beside = heel * [0.5, 0.5, 0.0] + [0.0, 0.0, 30.0]
    assert np.abs(np.diff(np.degrees(limb.azimuth(beside)))).max() < 2.0
    assert np.allclose(np.degrees(limb.azimuth(np.array([[-1e-9, -1e-9, 40.0]]))), 90.0)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_foot_is_found_from_the_skin(side):
    """Ends of the foot's cone (`domain_body.CONES`): heel 65 mm behind the ankle, toes 170 mm before it."""
    limb = find_limb(synthetic_body(), "ankle", side)
    assert limb.joint == f"ankle_{side[0]}"
    assert np.allclose(limb.upper, (KNEE - ANKLE) * 1000.0, atol=1e-3)
    assert np.allclose(limb.distal @ [1.0, 0.0, 0.0], 1.0, atol=0.01)
    assert np.isclose(limb.lower @ limb.distal, 170.0, atol=6.0)
    # The axis goes from the ankle through the middle of the foot's section, 45 mm below it.
    assert np.isclose(0.45 * limb.lower[1], -45.0, atol=5.0)


def test_toes_that_point_outwards_turn_the_sole():
    body = synthetic_body()
    turn = np.radians(15.0)
    out = np.array([[np.cos(turn), 0.0, -np.sin(turn)], [0.0, 1.0, 0.0], [np.sin(turn), 0.0, np.cos(turn)]])
    foot = (body.vertices[:, 1] < ANKLE[1]) & (body.vertices[:, 2] > 0.0)
    vertices = np.where(foot[:, None], (body.vertices - ANKLE) @ out.T + ANKLE, body.vertices)
    limb = find_limb(dataclasses.replace(body, vertices=vertices), "ankle", "right")
    assert np.isclose(np.degrees(np.arctan2(limb.distal[2], limb.distal[0])), 15.0, atol=3.0)


def test_a_body_without_a_foot_has_no_ankle_brace():
    body = synthetic_body()
    keep = (body.vertices[:, 1] > ANKLE[1] + 0.02)[body.triangles].all(axis=1)
    with pytest.raises(GeometryError, match="no foot in front of the left ankle"):
        find_limb(dataclasses.replace(body, triangles=body.triangles[keep]), "ankle", "left")
    used = np.unique(body.triangles[keep])
    number = np.full(len(body.vertices), -1)
    number[used] = np.arange(len(used))
    cropped = make_body(body.vertices[used], number[body.triangles[keep]], body.joint_centres)
    with pytest.raises(GeometryError, match="no foot"):
        find_limb(cropped, "ankle", "left")


@pytest.mark.parametrize("joint", ["knee", "ankle"])
def test_both_legs_of_a_symmetric_body_have_the_same_skin_bit_by_bit(joint):
    body = synthetic_body()
    # One half of it and that half in the mirror, with the noise that computing both has.
    half = body.triangles[(body.vertices[:, 2] > 0.005)[body.triangles].all(axis=1)]
    used, corners = np.unique(half, return_inverse=True)
    half = corners.reshape(-1, 3)
    points = body.vertices[used]
    both = dataclasses.replace(
        body,
        vertices=np.concatenate([points, points * LEFT]),
        triangles=np.concatenate([half, half[:, [0, 2, 1]] + len(points)]),
        bone_weights=np.concatenate([body.bone_weights[used]] * 2),
    )
    shaken = dataclasses.replace(
        both, vertices=both.vertices + np.random.default_rng(1).normal(0.0, 1e-16, both.vertices.shape)
    )
    skins = [limb_skin(shaken, find_limb(shaken, joint, side)) for side in ("left", "right")]
    assert skins[0].vertices.tobytes() == skins[1].vertices.tobytes()
    assert skins[0].triangles.tobytes() == skins[1].triangles.tobytes()
    limb = find_limb(body, joint, "right")
    order = skin_order(body, limb)
    assert np.array_equal(limb.inwards(body.vertices)[order], limb_skin(body, limb).vertices)
    assert np.array_equal(
        limb_skin(mirrored_body(body), find_limb(mirrored_body(body), joint, "left")).triangles,
        limb_skin(body, limb).triangles,
    )
