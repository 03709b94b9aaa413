"""Placement on a skeleton: joints land on joints, girths stay, an own skeleton changes no length."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.body.anny_lite import load_anny_lite
from hilbrace.body.neutral import joint_distances, place
from hilbrace.body.segments import BONES, JOINTS, SEGMENTS, skeleton_joints
from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.table import load_table


@pytest.fixture(scope="module")
def own():
    model = load_anny_lite()
    return model.joints(np.zeros(0))


@pytest.fixture(scope="module")
def target():
    return skeleton_joints(skeleton_from_table(load_table()))


def carried(placement, point, bone):
    weights = np.zeros((1, len(BONES)))
    weights[0, BONES.index(bone)] = 1.0
    return placement.apply(point[None], weights)[0]


@pytest.mark.parametrize("segment", SEGMENTS, ids=lambda s: s.start)
def test_both_ends_of_a_segment_land_on_the_skeleton(own, target, segment):
    placement = place(own, target)
    for side in "rl":
        for joint in (segment.start, segment.end):
            if joint == "shoulder":
                continue
            for bone in segment.bones:
                landed = carried(placement, own[f"{joint}_{side}"], f"{bone}_{side}")
                np.testing.assert_allclose(landed, target[f"{joint}_{side}"], atol=1e-12)


def test_shoulders_stay_with_the_trunk(own, target):
    placement = place(own, target)
    for side in "rl":
        joint = own[f"shoulder_{side}"]
        on_arm, on_trunk = (carried(placement, joint, bone) for bone in (f"humerus_{side}", "torso"))
        np.testing.assert_allclose(on_arm, on_trunk, atol=1e-12)


def test_segments_are_stretched_along_themselves_only(own, target):
    placement = place(own, target)
    row = BONES.index("tibia_r")
    axis = own["ankle_r"] - own["knee_r"]
    ratio = np.linalg.norm(target["ankle_r"] - target["knee_r"]) / np.linalg.norm(axis)
    np.testing.assert_allclose(placement.stretch[row] @ axis, ratio * axis, atol=1e-12)
    across = np.cross(axis, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(placement.stretch[row] @ across, across, atol=1e-12)


def test_rotations_are_proper_and_feet_stay_flat(own, target):
    placement = place(own, target)
    eye = placement.rotation @ np.swapaxes(placement.rotation, 1, 2)
    np.testing.assert_allclose(eye, np.broadcast_to(np.eye(3), eye.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(placement.rotation), 1.0, atol=1e-12)
    np.testing.assert_array_equal(placement.rotation[BONES.index("calcn_r")], np.eye(3))


def test_palms_look_forward_in_the_neutral_pose(own, target):
    turn = place(own, target).rotation[BONES.index("hand_r")]
    knuckles = turn @ (own["index_r"] - own["little_r"])
    assert knuckles[2] > 0.9 * np.linalg.norm(knuckles)


def test_distances_vanish_on_a_skeleton_of_the_same_lengths(own, target):
    legs = dict(target)
    shift = np.array([0.3, 0.1, 0.0])
    for side in "rl":
        hip, knee, ankle = (f"{joint}_{side}" for joint in ("hip", "knee", "ankle"))
        legs[hip] = own[hip] + shift
        for start, end in ((hip, knee), (knee, ankle)):
            length = np.linalg.norm(own[end] - own[start])
            legs[end] = legs[start] + [0.0, -length, 0.0]
    np.testing.assert_allclose(joint_distances(own, legs), 0.0, atol=1e-12)
    legs["knee_r"] = legs["knee_r"] - [0.0, 0.02, 0.0]
    assert joint_distances(own, legs)[JOINTS.index("knee_r")] == pytest.approx(0.02)
