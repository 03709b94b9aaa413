from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilbrace.domain.frames import MAX_FRAMES, choose_frames, frames_of, pose_in_distal, to_bone
from hilbrace.errors import ConfigError, GeometryError, InputError
from tests.unit.domain_body import KNEE, LEFT, bending, synthetic_body


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(1, 800),
    rate=st.sampled_from([50.0, 100.0, 120.0]),
    wanted=st.floats(1.0, 200.0),
    seed=st.integers(0, 10**6),
)
def test_frames_are_even_few_and_hold_the_peaks(count, rate, wanted, seed):
    draw = np.random.default_rng(seed)
    time = 1.3 + np.arange(count) / rate
    flexion, force = draw.normal(size=count), draw.normal(size=(count, 3))
    frames = choose_frames(time, flexion, force, wanted)
    assert (np.diff(frames) > 0).all()
    assert frames[0] == 0
    assert frames[-1] < count
    assert len(frames) <= MAX_FRAMES
    assert np.argmax(flexion) in frames
    assert np.argmax(np.linalg.norm(force, axis=1)) in frames
    span = time[-1] - time[0]
    step = max(1.0 / wanted, 1.0 / rate, span / (MAX_FRAMES - 3))
    assert np.diff(time[frames], append=time[-1]).max() <= step + 1.0 / rate + 1e-9


def test_fifteen_frames_a_second():
    time = np.arange(151) / 100.0
    frames = choose_frames(time, time, np.ones((151, 3)), 15.0)
    assert np.allclose(time[frames][:-1], np.round(np.arange(23) / 15.0, 2))
    assert time[frames][-1] == 1.5


def test_loads_without_the_joint_are_refused():
    loads = dataclasses.replace(bending(synthetic_body(), [0.0]), joints=("a", "b", "c", "d"))
    with pytest.raises(ConfigError, match="knee_l") as caught:
        frames_of(loads, "knee_l", 15.0)
    assert "a, b, c, d" in caught.value.hint


def test_a_gap_in_the_recording_is_refused():
    loads = bending(synthetic_body(), np.zeros(10))
    frames_of(loads, "knee_l", 15.0)
    loads.coordinates[5] = np.nan
    with pytest.raises(InputError, match=r"missing in 1 frames .*at 0\.050 s"):
        frames_of(loads, "knee_l", 15.0)


def test_riding_on_a_bone_undoes_its_motion():
    turn = Rotation.random(5, rng=1).as_matrix()
    shift = np.random.default_rng(1).normal(size=(5, 3))
    points = np.random.default_rng(2).normal(size=(40, 3))
    moved = points @ np.swapaxes(turn, 1, 2) + shift[:, None, :]
    assert np.allclose(to_bone(moved, turn, shift), points, atol=1e-12)


@pytest.mark.parametrize("side", ["right", "left"])
def test_whole_body_motion_leaves_the_domain_at_rest(side):
    """The whole body moves, the knee does not: nothing is seen from the tibia."""
    body = synthetic_body()
    draw = np.random.default_rng(4)
    letter = side[0]
    names = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
    values = draw.uniform(-1.0, 1.0, size=(6, len(names)))
    rest = np.array([[60.0, 20.0, 0.0], [-50.0, -60.0, 10.0], [0.0, 0.0, 55.0]])
    posed = pose_in_distal(rest, f"knee_{letter}", body, names, values)
    assert np.allclose(posed, rest, atol=1e-9)


@pytest.mark.parametrize("side", ["right", "left"])
def test_seen_from_the_tibia_the_thigh_swings_back_in_flexion(side):
    """Far above the knee the skin is the femur's: a quarter turn carries up to back, the shank stays."""
    body = synthetic_body()
    joint = f"knee_{side[0]}"
    rest = np.array([[0.0, 250.0, 0.0], [0.0, -250.0, 0.0]])
    loads = bending(body, [0.0, 90.0], side)
    posed = pose_in_distal(rest, joint, body, loads.coordinate_names, loads.coordinates)
    assert np.allclose(posed[0], rest, atol=1e-6)
    # 30 mm: the thigh's point lies in skin that is not the femur's alone, and the knee's axis rolls.
    assert np.allclose(posed[1, 0], [-250.0, 0.0, 0.0], atol=30.0)
    assert np.allclose(posed[1, 1], rest[1], atol=5.0)
    assert np.allclose(
        body.joint_centres[body.joint_names.index(joint)], KNEE if side == "right" else KNEE * LEFT
    )


def test_a_body_without_the_tibia_is_refused():
    body = synthetic_body()
    renamed = tuple("femur_l" if name == "tibia_l" else name for name in body.bones)
    loads = bending(body, [0.0])
    with pytest.raises(GeometryError, match="tibia_l"):
        pose_in_distal(
            np.zeros((1, 3)),
            "knee_l",
            dataclasses.replace(body, bones=renamed),
            loads.coordinate_names,
            loads.coordinates,
        )
