"""The whole stage: a synthetic subject with known truth, a recorded drop jump, and what is refused."""

from __future__ import annotations

import csv
import dataclasses
import json

import numpy as np
import pytest

from hilbrace.biomech import dynamics
from hilbrace.biomech.analysis import _further_axis, compute_joint_loads, joint_of_model
from hilbrace.biomech.joint_loads import JOINTS, JointLoads
from hilbrace.biomech.loads_csv import write_joint_loads_csv
from hilbrace.body.body import Body
from hilbrace.config import BiomechSettings, MotionSettings, SubjectSettings
from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import read_marker_map
from hilbrace.motion.opensim_files import coordinates_rad, read_storage
from hilbrace.motion.synthetic.generate import generate
from hilbrace.motion.trial import Trial
from hilbrace.motion.trial_reader import read_trial
from hilbrace.run.records import pack
from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.scaling import segment_scales
from hilbrace.skeleton.table import load_table
from hilbrace.units import GRAVITY

CUTOFF_HZ = 12.0


def body_of(scales, mass_kg: float) -> Body:
    """A body without skin, which this stage does not look at."""
    nothing = np.zeros((0, 3))
    return Body(
        model="none",
        mass_kg=mass_kg,
        height_m=0.0,
        scaled_bodies=tuple(scales),
        segment_scales=np.array(list(scales.values())).reshape(-1, 3),
        shape=np.zeros(0),
        vertices=nothing,
        triangles=np.zeros((0, 3), int),
        bones=(),
        bone_weights=np.zeros((0, 0)),
        joint_names=(),
        joint_centres=nothing,
        fit_error_mm=np.zeros(0),
        height_error_mm=0.0,
    )


@pytest.fixture(scope="module")
def truth():
    return generate("squat", rate_hz=100.0)


@pytest.fixture(scope="module")
def trial(truth):
    feet = {"right": 0, "left": 1}
    return Trial(
        name="squat",
        origin="synthetic",
        time=truth.time,
        rate_hz=truth.rate_hz,
        marker_names=truth.marker_names,
        markers=truth.markers,
        static_marker_names=truth.marker_names,
        static_markers=truth.static_markers,
        feet=tuple(feet),
        ground_force=truth.forces.force,
        centre_of_pressure=truth.forces.centre_of_pressure,
        free_torque=truth.forces.free_moment[..., None] * np.array([0.0, 1.0, 0.0]),
        mass_kg=truth.mass_kg,
        height_m=truth.height_m,
        marker_map="hilbrace",
        notes=(),
    )


def analyse(trial, body, marker_map="hilbrace", model=None) -> JointLoads:
    return compute_joint_loads(
        trial,
        body,
        read_marker_map(marker_map),
        MotionSettings(cutoff_hz=CUTOFF_HZ),
        BiomechSettings(model=model),
    )


@pytest.fixture(scope="module")
def loads(trial) -> JointLoads:
    return analyse(trial, body_of({}, trial.mass_kg))


def inner(time) -> np.ndarray:
    """Frames away from the ends by a quarter of a second, where filter and splines lack neighbours."""
    return (time > time[0] + 0.25) & (time < time[-1] - 0.25)


def test_synthetic_angles_are_found(truth, loads):
    kept = inner(truth.time)
    for side in "rl":
        k = JOINTS.index(f"knee_{side}")
        for axis, (name, limit) in enumerate(
            [("knee_angle", 0.3), ("knee_adduction", 1.0), ("knee_rotation", 2.5)]
        ):
            error = np.degrees(loads.angles[:, k, axis] - truth.coordinates[f"{name}_{side}"])[kept]
            assert np.sqrt((error**2).mean()) < limit, (name, side)
    assert len(loads.coordinate_names) == 41
    assert loads.muscles == 80


def test_synthetic_loads_equal_those_of_the_true_motion(truth, trial, loads):
    """Newton-Euler on the true coordinates with our own kinematics, against the stage's result."""
    skeleton = skeleton_from_table(load_table())
    pose = skeleton.forward(truth.coordinates)
    segments = dynamics.momenta(
        np.stack([pose[b].rotation for b in skeleton.bodies], axis=1),
        np.stack([pose[b].origin for b in skeleton.bodies], axis=1),
        skeleton.masses,
        np.stack([skeleton.com[b] for b in skeleton.bodies]),
        skeleton.inertia,
        truth.rate_hz,
    )
    kept = inner(truth.time)
    weight = truth.mass_kg * GRAVITY
    for k, name in enumerate(JOINTS):
        joint = joint_of_model(name)
        foot = trial.feet.index(joint.foot)
        reaction = dynamics.GroundReaction(
            trial.ground_force[:, foot], trial.centre_of_pressure[:, foot], trial.free_torque[:, foot]
        )
        load = dynamics.net_load(
            segments,
            [skeleton.bodies.index(b) for b in joint.below],
            pose[joint.distal].origin,
            [reaction],
        )
        in_distal = np.einsum("fji,fj->fi", pose[joint.distal].rotation, load.force)
        error = np.linalg.norm(loads.acting_force[:, k] - in_distal, axis=1)[kept]
        assert np.sqrt((error**2).mean()) < 0.02 * weight, name
    assert np.abs(loads.pelvis_residual_force[kept]).mean() < 0.03 * weight


def test_axes_turn_the_distal_body_and_inertia_is_physical(loads):
    assert np.allclose(np.linalg.norm(loads.joint_axes, axis=3), 1.0)
    knee_l, knee_r = JOINTS.index("knee_l"), JOINTS.index("knee_r")
    assert (
        loads.joint_axes[:, [knee_r, knee_l], 0, 2] < -0.95
    ).all()  # flexion: about the left-pointing axis
    assert (loads.joint_axes[:, knee_r, 1, 0] > 0.95).all()
    assert (loads.joint_axes[:, knee_l, 1, 0] < -0.95).all()
    assert np.allclose(loads.inertia, np.swapaxes(loads.inertia, -1, -2))
    assert (np.linalg.eigvalsh(loads.inertia) > 0).all()
    rotation = loads.distal_rotation
    assert np.allclose(rotation @ np.swapaxes(rotation, -1, -2), np.eye(3), atol=1e-9)


@pytest.mark.parametrize("joint", JOINTS)
def test_the_part_below_moves_as_its_jacobian_says_and_the_part_above_does_not(loads, joint):
    """Central differences of our own kinematics, at the material point in the joint's centre."""
    table = load_table()
    skeleton = skeleton_from_table(table)
    side, k, h = joint[-1], JOINTS.index(joint), 1e-5
    names = (
        ("knee_angle", "knee_adduction", "knee_rotation")
        if joint[0] == "k"
        else ("ankle_angle", "subtalar_angle")
    )
    above, distal, carrier = ("femur", "tibia", "tibia") if joint[0] == "k" else ("tibia", "talus", "calcn")
    child = f"{distal}_{side}"
    centre = np.array(next(item["child_frame"][0] for item in table["joints"] if item["child"] == child))
    q = dict(zip(loads.coordinate_names, loads.coordinates.T, strict=True))
    pose = skeleton.forward(q)
    place = pose[child].origin + pose[child].rotation @ centre
    body = pose[f"{carrier}_{side}"]
    material = np.einsum("fji,fj->fi", body.rotation, place - body.origin)
    for axis, name in enumerate(names):
        ahead, behind = (
            skeleton.forward({**q, f"{name}_{side}": q[f"{name}_{side}"] + step}) for step in (h, -h)
        )
        there, back = ahead[f"{carrier}_{side}"], behind[f"{carrier}_{side}"]
        shift = there.origin - back.origin + np.einsum("fij,fj->fi", there.rotation - back.rotation, material)
        spin = (there.rotation - back.rotation) @ np.swapaxes(body.rotation, 1, 2)
        turn = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        moved = np.concatenate(
            [np.einsum("fji,fj->fi", pose[child].rotation, part) for part in (shift, turn)], axis=1
        )
        np.testing.assert_allclose(loads.distal_jacobian[:, k, :, axis], moved / (2 * h), atol=1e-7)
        held, still = ahead[f"{above}_{side}"], behind[f"{above}_{side}"]
        np.testing.assert_array_equal(held.origin, still.origin)
        np.testing.assert_array_equal(held.rotation, still.rotation)


def test_the_same_input_gives_the_same_bytes(trial):
    short = dataclasses.replace(
        trial,
        **{
            name: getattr(trial, name)[100:130]
            for name in (
                "time",
                "markers",
                "ground_force",
                "centre_of_pressure",
                "free_torque",
            )
        },
    )
    body = body_of({}, trial.mass_kg)
    assert pack(analyse(short, body)) == pack(analyse(short, body))


def test_the_table_keeps_its_contract(loads, tmp_path):
    path = tmp_path / "joint_loads.csv"
    write_joint_loads_csv(loads, path)
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == len(loads.time)
    frame, left = 37, JOINTS.index("knee_l")
    row = {key: float(value) for key, value in rows[frame].items()}
    assert row["time_s"] == pytest.approx(loads.time[frame])
    assert row["knee_left_flexion_deg"] == pytest.approx(np.degrees(loads.angles[frame, left, 0]), rel=1e-4)
    assert row["knee_left_acting_force_y_n"] == pytest.approx(loads.acting_force[frame, left, 1], rel=1e-4)
    for name in ("knee_right_adduction_deg", "knee_left_rotation_deg", "ankle_right_dorsiflexion_deg"):
        assert name in row
    about = json.loads(path.with_suffix(".json").read_text())
    assert about["force_frame"] == {"knee": "tibia", "ankle": "talus"}


def test_strange_and_missing_markers_are_listed_both_ways(trial):
    renamed = tuple("LKNEE" if name == "LLFC" else name for name in trial.marker_names)
    other = dataclasses.replace(trial, marker_names=renamed, static_marker_names=renamed)
    with pytest.raises(InputError) as refused:
        analyse(other, body_of({}, trial.mass_kg))
    assert "LKNEE" in str(refused.value)
    assert "LLFC" in str(refused.value)


@pytest.fixture(scope="module")
def drop_jump(shared_data) -> tuple[Trial, MotionSettings]:
    folder = shared_data / "opencap_subject4"
    settings = MotionSettings(
        markers=folder / "markers" / "DJ1.trc",
        forces=folder / "grf" / "DJ1_grf.mot",
        static=folder / "markers" / "static1.trc",
        marker_map="opencap",
        plates={"1": "right", "2": "left", "3": "unused"},
        window=(1.11, 2.19),
        cutoff_hz=CUTOFF_HZ,
    )
    return read_trial(settings, SubjectSettings(mass_kg=62.6, height_m=1.68)), settings


def knee_difference(loads: JointLoads, reference) -> np.ndarray:
    """RMS difference of right and left knee flexion from reference coordinates [deg]."""
    columns = coordinates_rad(reference)
    found = [
        loads.angles[:, k, 0] - np.interp(loads.time, reference.time, columns[f"knee_angle_{side}"])
        for k, side in enumerate("rl")
    ]  # fmt: skip
    return np.degrees(np.sqrt((np.array(found) ** 2).mean(axis=1)))


@pytest.mark.slow
def test_recorded_drop_jump_against_published_kinematics(drop_jump, shared_data):
    """The built-in model, scaled from the standing trial, within 1.5 deg of the publisher's own fit."""
    trial, _ = drop_jump
    table = load_table()
    marker_map = read_marker_map("opencap")
    place = dict(zip(trial.static_marker_names, trial.static_markers, strict=True))
    landmarks = {mark: place[name] for name, mark in marker_map.landmarks.items() if name in place}
    loads = analyse(trial, body_of(segment_scales(landmarks, table), trial.mass_kg), "opencap")
    folder = shared_data / "opencap_subject4" / "ik_manual_scaling"
    assert (knee_difference(loads, read_storage(folder / "DJ1_manual_scaling_ik.mot")) < 1.5).all()
    legs = [
        k
        for k, name in enumerate(loads.marker_names)
        if name[:3] in ("r_s", "L_s", "r_k", "L_k", "r_t", "L_t")
    ]
    assert np.sqrt(np.nanmean(loads.marker_error[:, legs] ** 2)) < 0.02
    weight = trial.mass_kg * GRAVITY
    peaks = np.linalg.norm(loads.acting_force, axis=2).max(axis=0) / weight
    assert ((peaks > 0.9) & (peaks < 3.5)).all()
    crouched = (loads.time > 1.6) & (loads.time < 2.05)
    assert np.abs(loads.pelvis_residual_force[crouched, 1]).max() < 0.2 * weight
    adduction = loads.angles[:, :2, 1]
    assert np.degrees(np.ptp(adduction, axis=0)).max() < 12.0


@pytest.mark.slow
def test_a_model_of_the_user_brings_its_own_markers(drop_jump, shared_data):
    trial, _ = drop_jump
    folder = shared_data / "opencap_subject4"
    loads = analyse(trial, body_of({}, trial.mass_kg), "opencap", folder / "models" / "manually_scaled.osim")
    reference = read_storage(folder / "ik_manual_scaling" / "DJ1_manual_scaling_ik.mot")
    assert (knee_difference(loads, reference) < 1.5).all()
    assert "knee_adduction_l" in loads.coordinate_names
    assert any("used with its own size" in note for note in loads.notes)


def test_a_model_with_stiff_subtalar_joints_has_unit_axes_and_a_definite_inertia(loads):
    """Axes that a model lacks are filled in, so that nobody downstream divides by zero."""
    flexion = loads.joint_axes[:, JOINTS.index("ankle_r"), 0]
    anterior = np.broadcast_to([1.0, 0.0, 0.0], flexion.shape)
    second = _further_axis([flexion], anterior)
    third = _further_axis([flexion, second], anterior)
    frame = np.stack([flexion, second, third], axis=1)
    assert np.allclose(frame @ np.swapaxes(frame, 1, 2), np.eye(3), atol=1e-9)
    assert (second[:, 0] > 0.5).all()
    assert joint_of_model("ankle_l", inversion=False).coordinates == ("ankle_angle_l",)
