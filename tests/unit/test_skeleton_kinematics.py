"""Kinematics against OpenSim: figures stored from the source model, and a live comparison to 1e-12 m."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilbrace.errors import InputError
from hilbrace.skeleton.kinematics import (
    LEG,
    body_fixed_xyz,
    inertia_tensor,
    rotation_about,
    skeleton_from_table,
)
from hilbrace.skeleton.table import coordinate_ranges, free_coordinates, load_source_table, load_table
from tests.unit.opensim_oracle import STORED, ask, random_poses

TABLE = load_table()
SKELETON = skeleton_from_table(TABLE)
DIGITS_OF_THE_SOURCE = 2.5e-6  # OpenSim turns its old format's frame angles into texts of six digits


def poses(count: int, seed: int) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in random_poses(TABLE, count, seed).items()}


def test_stored_figures_of_the_source_model_are_met():
    skeleton = skeleton_from_table(load_source_table())
    with np.load(STORED) as stored:
        q = dict(zip(stored["coordinates"].tolist(), stored["poses"], strict=True))
        pose = skeleton.forward(q)
        assert tuple(stored["bodies"]) == skeleton.bodies
        assert skeleton.mass == pytest.approx(float(stored["mass"]), abs=1e-9)
        for index, body in enumerate(skeleton.bodies):
            np.testing.assert_allclose(
                pose[body].origin, stored["position"][:, index], atol=DIGITS_OF_THE_SOURCE
            )
            np.testing.assert_allclose(pose[body].rotation, stored["rotation"][:, index], atol=1e-5)
        markers = skeleton.markers(pose, stored["markers"].tolist())
        np.testing.assert_allclose(markers, stored["marker"], atol=DIGITS_OF_THE_SOURCE)
        np.testing.assert_allclose(skeleton.centre(pose), stored["com"], atol=DIGITS_OF_THE_SOURCE)


def test_equal_to_opensim_to_rounding():
    q = poses(20, seed=1)
    told = ask(table=TABLE, poses=q)
    assert tuple(told["coordinates"]) == SKELETON.coordinates
    assert tuple(told["bodies"]) == SKELETON.bodies
    assert tuple(told["markers"]) == tuple(SKELETON.marker_body)
    pose = SKELETON.forward(q)
    for index, body in enumerate(SKELETON.bodies):
        np.testing.assert_allclose(pose[body].origin, told["position"][:, index], rtol=0, atol=1e-12)
        np.testing.assert_allclose(pose[body].rotation, told["rotation"][:, index], rtol=0, atol=1e-12)
    np.testing.assert_allclose(SKELETON.centre(pose), told["com"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(SKELETON.markers(pose), told["marker"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(SKELETON.masses, told["body_mass"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        SKELETON.inertia,
        [inertia_tensor({"mass": 0.0, "com": [], "inertia": row}) for row in told["body_inertia"].tolist()],
        atol=1e-15,
    )


@pytest.mark.parametrize("side", ["r", "l"])
def test_positive_knee_angles_mean_the_same_on_both_sides(side):
    """Adduction carries the ankle to the midline, internal rotation turns the toes in, flexion lifts back."""
    towards_midline = -1.0 if side == "r" else 1.0
    frames = np.array([0.0, 0.1])

    def moved(coordinate: str, marker: str) -> np.ndarray:
        start, end = SKELETON.markers(SKELETON.forward({f"{coordinate}_{side}": frames}), [marker])[:, 0]
        return end - start

    name = side.upper()
    assert moved("knee_adduction", f"{name}AJC")[2] * towards_midline > 0.03
    toe_in = moved("knee_rotation", f"{name}TOE") - moved("knee_rotation", f"{name}CAL")
    assert toe_in[2] * towards_midline > 0.02
    assert moved("knee_angle", f"{name}AJC")[0] < -0.03


@pytest.mark.parametrize("side", ["r", "l"])
@pytest.mark.parametrize("body", ["tibia", "talus", "femur", "patella", "hand"])
def test_joint_axes_are_the_angular_velocities(body, side):
    child = f"{body}_{side}"
    q = SKELETON.complete(poses(6, seed=4))
    step = 1e-6
    axes = SKELETON.joint_axes(child, q)
    assert tuple(axes) == SKELETON.joints[child].coordinates
    parent = SKELETON.joints[child].parent
    for coordinate, axis in axes.items():
        low, high = (
            np.swapaxes(pose[parent].rotation, 1, 2) @ pose[child].rotation
            for pose in (SKELETON.forward({**q, coordinate: q[coordinate] + d}) for d in (-step, step))
        )
        turn = np.swapaxes(low, 1, 2) @ high
        spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        spin -= np.stack([turn[:, 1, 2], turn[:, 2, 0], turn[:, 0, 1]], axis=1)
        np.testing.assert_allclose(axis, spin / (4 * step), atol=1e-8)


def test_axes_of_the_right_knee_are_those_measured_in_opensim():
    axes = SKELETON.joint_axes("tibia_r", {"knee_angle_r": np.radians([0.0, 45.0, 90.0])})
    np.testing.assert_allclose(axes["knee_adduction_r"], [[0.992, 0.124, -0.009]] * 3, atol=6e-4)
    np.testing.assert_allclose(axes["knee_rotation_r"], [[-0.124, 0.99, -0.07]] * 3, atol=6e-4)


def test_a_renewed_leg_is_the_whole_model_evaluated_anew():
    q = SKELETON.complete(poses(7, seed=5))
    pose = SKELETON.forward(q)
    bent = {**q, "hip_flexion_l": q["hip_flexion_l"] + 0.2, "knee_adduction_l": q["knee_adduction_l"] - 0.1}
    renewed, whole = SKELETON.leg(bent, "l", pose), SKELETON.forward(bent)
    for body in LEG:
        np.testing.assert_array_equal(renewed[f"{body}_l"].origin, whole[f"{body}_l"].origin)
        np.testing.assert_array_equal(renewed[f"{body}_l"].rotation, whole[f"{body}_l"].rotation)
    np.testing.assert_array_equal(pose["tibia_l"].origin, SKELETON.forward(q)["tibia_l"].origin)


def test_all_frames_at_once_are_the_frames_one_by_one():
    q = poses(5, seed=6)
    together = SKELETON.forward(q)
    for frame in range(5):
        alone = SKELETON.forward({name: values[frame] for name, values in q.items()})
        np.testing.assert_allclose(alone["toes_l"].origin[0], together["toes_l"].origin[frame], atol=1e-15)


@given(st.integers(0, 10_000))
def test_frames_stay_orthonormal_and_bones_keep_their_length(seed):
    pose = SKELETON.forward(poses(2, seed))
    for rotation, _ in pose.values():
        np.testing.assert_allclose(
            rotation @ np.swapaxes(rotation, 1, 2), np.tile(np.eye(3), (2, 1, 1)), atol=1e-12
        )
        np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-12)
    thigh = np.linalg.norm(SKELETON.markers(pose, ["RLFC"])[:, 0] - pose["femur_r"].origin, axis=1)
    np.testing.assert_allclose(thigh, np.hypot(0.404, 0.05), atol=1e-12)


def test_coordinates_left_out_are_zero_and_kneecaps_follow():
    bent = SKELETON.forward({"knee_angle_r": np.array([0.3, 0.9])})
    told = SKELETON.forward(
        {
            "knee_angle_r": np.array([0.3, 0.9]),
            "knee_angle_r_beta": np.array([0.3, 0.9]),
            "hip_flexion_l": 0.0,
        }
    )
    np.testing.assert_array_equal(bent["patella_r"].origin, told["patella_r"].origin)
    assert len(SKELETON.forward({})["pelvis"].origin) == 1
    full = SKELETON.complete({})
    assert set(full) == {item.name for item in coordinate_ranges(TABLE)}
    assert not any(value.any() for value in full.values())


def test_centre_of_mass_is_the_weighted_mean():
    pose = SKELETON.forward(poses(3, seed=8))
    by_hand = sum(
        TABLE["bodies"][b]["mass"] * SKELETON.point(pose, b, TABLE["bodies"][b]["com"])
        for b in SKELETON.bodies
    )
    np.testing.assert_allclose(SKELETON.centre(pose), by_hand / SKELETON.mass, atol=1e-14)
    assert SKELETON.centres(pose).shape == (3, 22, 3)


@given(st.floats(-3, 3), st.integers(0, 100))
def test_rotation_about_an_axis(angle, seed):
    direction = np.random.default_rng(seed).normal(size=3)
    direction /= np.linalg.norm(direction)
    expected = Rotation.from_rotvec(angle * direction).as_matrix()
    np.testing.assert_allclose(rotation_about(direction, np.array(angle)), expected, atol=1e-14)


def test_orientations_are_body_fixed_x_y_z():
    angles = [0.3, -0.7, 1.1]
    np.testing.assert_allclose(
        body_fixed_xyz(angles), Rotation.from_euler("XYZ", angles).as_matrix(), atol=1e-14
    )


@pytest.mark.malformed
def test_wrong_names_and_lengths_are_named():
    with pytest.raises(InputError, match="knee_flexion_r"):
        SKELETON.forward({"knee_flexion_r": np.zeros(2)})
    with pytest.raises(InputError, match=r"\[2, 3\] frames"):
        SKELETON.forward({"knee_angle_r": np.zeros(2), "knee_angle_l": np.zeros(3)})
    with pytest.raises(InputError, match="frames"):
        SKELETON.forward({"knee_angle_r": np.zeros((2, 2))})
    with pytest.raises(InputError, match="NOSE"):
        SKELETON.markers(SKELETON.forward({}), ["NOSE"])


def test_free_coordinates_drive_everything():
    assert len(free_coordinates(TABLE)) == len(SKELETON.coordinates) - len(SKELETON.couplers) == 41
