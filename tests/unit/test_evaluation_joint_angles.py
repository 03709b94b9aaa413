"""The angle core against known rotations, Grood and Suntay's axes, mirrors and signs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from evaluation.conventions import CONVENTIONS, anatomical_degrees, in_convention
from evaluation.joint_angles import (
    cardan_angles,
    grood_suntay_angles,
    relative_rotation,
    rotation_from_cardan,
)
from evaluation.segment_frames import foot_frame, long_bone_frame
from hilbrace.errors import GeometryError

ANGLES = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
MIRROR = np.diag([1.0, 1.0, -1.0])


@given(ANGLES)
@settings(max_examples=200, deadline=None)
def test_angles_come_back_from_their_rotation(angles):
    rotation = rotation_from_cardan(np.array([angles]))
    assert cardan_angles(rotation)[0] == pytest.approx(angles, abs=1e-12 + 1e-13 / np.cos(angles[1]) ** 2)


@given(ANGLES)
@settings(max_examples=50, deadline=None)
def test_the_sequence_is_scipys_intrinsic_z_x_y(angles):
    expected = Rotation.from_euler("ZXY", angles).as_matrix()
    assert rotation_from_cardan(np.array(angles)) == pytest.approx(expected, abs=1e-14)


@given(ANGLES, st.integers(0, 2**31))
@settings(max_examples=100, deadline=None)
def test_grood_suntay_is_cardan_in_any_laboratory(angles, seed):
    laboratory = Rotation.random(random_state=seed).as_matrix()
    distal = laboratory @ rotation_from_cardan(np.array(angles))
    cardan = cardan_angles(relative_rotation(laboratory, distal))
    near_lock = np.cos(angles[1]) ** -2
    difference = (grood_suntay_angles(laboratory, distal) - cardan + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(np.rad2deg(difference)).max() < 1e-9 * near_lock


def test_turning_the_laboratory_changes_nothing():
    rng = np.random.default_rng(3)
    thigh, shank, turned = (Rotation.random(50, random_state=k).as_matrix() for k in rng.integers(0, 99, 3))
    plain = cardan_angles(relative_rotation(thigh, shank))
    other = cardan_angles(relative_rotation(turned @ thigh, turned @ shank))
    assert np.abs(np.rad2deg(other - plain)).max() < 1e-9


def test_one_plain_turn_gives_one_angle():
    for plane in range(3):
        angles = np.zeros(3)
        angles[plane] = 0.4
        assert cardan_angles(rotation_from_cardan(angles)) == pytest.approx(angles, abs=1e-15)


def knee(side: str, ankle: tuple[float, float, float]) -> np.ndarray:
    """Knee angles [deg] of a leg whose thigh hangs down and whose ankle is at a place under the knee."""
    out = 0.05 if side == "right" else -0.05
    centre, hip, ankle_at = np.array([0.0, 0.5, 0.0]), np.array([0.0, 0.9, 0.0]), np.array(ankle)
    lateral, medial = np.array([0.0, 0.0, out]), np.array([0.0, 0.0, -out])
    thigh = long_bone_frame(hip, centre, centre + lateral, centre + medial, side, "thigh")
    shank = long_bone_frame(centre, ankle_at, ankle_at + lateral, ankle_at + medial, side, "shank")
    return anatomical_degrees(cardan_angles(relative_rotation(thigh, shank)), side)


@pytest.mark.parametrize("side", ["left", "right"])
def test_signs_as_the_papers_caption_says(side):
    """Foot behind: flexed, negative. Foot towards the other leg: adducted, positive."""
    midline = -1.0 if side == "right" else 1.0
    flexed = in_convention(knee(side, (-0.2, 0.2, 0.0)), side, "paper")
    adducted = in_convention(knee(side, (0.0, 0.1, 0.05 * midline)), side, "paper")
    assert flexed[0] == pytest.approx(-np.rad2deg(np.arctan2(0.2, 0.3)), abs=1e-9)
    assert adducted[1] == pytest.approx(np.rad2deg(np.arctan2(0.05, 0.4)), abs=1e-9)
    assert in_convention(knee(side, (-0.2, 0.2, 0.0)), side, "plug_in_gait")[0] > 30


def test_conventions_differ_in_signs_alone():
    angles = np.array([[-30.0, 4.0, 6.0]])
    right = {name: in_convention(angles, "right", name)[0].tolist() for name in CONVENTIONS}
    left = {name: in_convention(angles, "left", name)[0].tolist() for name in CONVENTIONS}
    assert right == {"paper": [-30, 4, 6], "visual3d": [-30, 4, 6], "plug_in_gait": [30, 4, 6]}
    assert left == {"paper": [-30, 4, 6], "visual3d": [-30, -4, -6], "plug_in_gait": [30, 4, 6]}


def test_visual3ds_left_leg_is_the_plain_sequence():
    cardan = np.array([0.3, -0.2, 0.1])
    visual3d = in_convention(anatomical_degrees(cardan, "left"), "left", "visual3d")
    assert visual3d == pytest.approx(np.rad2deg(cardan), abs=1e-12)


@given(ANGLES)
@settings(max_examples=50, deadline=None)
def test_mirrored_legs_have_the_same_angles(angles):
    """A mirror image of thigh and shank, built again from mirrored landmarks, is the other leg."""
    rotation = rotation_from_cardan(np.array(angles))
    mirrored = MIRROR @ rotation @ MIRROR
    right = anatomical_degrees(cardan_angles(rotation), "right")
    left = anatomical_degrees(cardan_angles(mirrored), "left")
    assert np.abs((left - right + 180) % 360 - 180).max() < 1e-9


def test_landmarks_on_one_line_are_refused():
    points = [np.array([0.0, y, 0.0]) for y in (0.9, 0.5, 0.55, 0.45)]
    with pytest.raises(GeometryError, match="landmarks of the thigh lie on one line"):
        long_bone_frame(*points, "left", "thigh")


def test_a_foot_that_stands_flat_has_the_laboratorys_vertical():
    frame = foot_frame(np.array([0.0, 0.05, 0.0]), np.array([0.2, 0.02, 0.1]), np.array([0.0, 1.0, 0.0]))
    assert frame[:, 1].tolist() == [0, 1, 0]
    assert frame[:, 0] == pytest.approx([0.2 / 0.05**0.5, 0, 0.1 / 0.05**0.5])
    assert np.linalg.det(frame) == pytest.approx(1.0)
