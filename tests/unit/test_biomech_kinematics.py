"""Poses and inverse kinematics of the engine, against our own kinematics and OpenSim's own solver."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hilbrace.biomech import dynamics
from hilbrace.biomech.analysis import joint_of_model
from hilbrace.biomech.engine import Engine
from hilbrace.biomech.joint_loads import JOINTS
from hilbrace.biomech.kinematics import KNEE_FRONTAL, follow, own_markers
from hilbrace.biomech.markers import PlacedMarkers
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.errors import InputError
from hilbrace.motion.trial import Trial
from hilbrace.run.progress import silent
from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.scaling import scaled_table
from hilbrace.skeleton.table import load_table
from tests.unit.biomech_oracle import ask

MASS = 70.0
SCALES = {"femur_l": np.array([1.0, 1.05, 1.0]), "tibia_r": np.array([0.95, 0.97, 1.0])}


@pytest.fixture(scope="module")
def engine():
    with Engine() as running:
        yield running


def built(engine: Engine, scales=None) -> ModelFigures:
    scales = scales or {}
    rows = np.array(list(scales.values())).reshape(-1, 3)
    return ModelFigures(**engine.call("build_model", bodies=tuple(scales), scales=rows, mass_kg=MASS))


def motion(figures: ModelFigures, frames: int, seed: int, rate_hz: float = 100.0) -> np.ndarray:
    """Smooth arbitrary coordinates, the knees bent, the locked ones still."""
    random = np.random.default_rng(seed)
    time = np.arange(frames) / rate_hz
    values = np.zeros((frames, len(figures.coordinates)))
    for k, name in enumerate(figures.coordinates):
        if name not in figures.locked:
            frequency, phase = 1.0 + random.random(), 6.0 * random.random()
            values[:, k] = 0.15 * np.sin(2 * np.pi * frequency * time + phase)
        if name.startswith("knee_angle"):
            values[:, k] += 0.6
    values[:, figures.coordinates.index("pelvis_ty")] += 1.0
    return values


def model_markers(engine: Engine, markers: PlacedMarkers, figures: ModelFigures, values) -> np.ndarray:
    poses = engine.call("poses", coordinates=values)
    rows = figures.rows(markers.bodies)
    arms = np.einsum("fmij,mj->fmi", poses["rotations"][:, rows], markers.locations)
    return poses["origins"][:, rows] + arms


def trial_of(markers: PlacedMarkers, places: np.ndarray) -> Trial:
    frames = len(places)
    nothing = np.zeros((frames, 2, 3))
    return Trial(
        name="test",
        origin="synthetic",
        time=np.arange(frames) / 100.0,
        rate_hz=100.0,
        marker_names=markers.names,
        markers=places,
        static_marker_names=(),
        static_markers=np.zeros((0, 3)),
        feet=("right", "left"),
        ground_force=nothing,
        centre_of_pressure=nothing,
        free_torque=nothing,
        mass_kg=MASS,
        height_m=0.0,
        marker_map="hilbrace",
        notes=(),
    )


def test_poses_equal_our_own_kinematics(engine):
    figures = built(engine, SCALES)
    values = motion(figures, 5, seed=1)
    poses = engine.call("poses", coordinates=values)
    skeleton = skeleton_from_table(scaled_table(load_table(), SCALES, MASS))
    own = skeleton.forward(dict(zip(figures.coordinates, values.T, strict=True)))
    assert len(figures.coordinates) == 41
    for k, body in enumerate(figures.bodies):
        assert np.allclose(poses["rotations"][:, k], own[body].rotation, atol=1e-9), body
        assert np.allclose(poses["origins"][:, k], own[body].origin, atol=1e-9), body
    assert np.allclose(figures.masses, skeleton.masses)


def test_partial_velocities_are_derivatives_of_the_poses(engine):
    figures = built(engine)
    values = motion(figures, 2, seed=2)
    moving, bodies = ("knee_angle_r", "knee_rotation_l", "ankle_angle_r"), ("tibia_r", "toes_r", "tibia_l")
    partial = engine.call("partial_velocities", coordinates=values, moving=moving, bodies=bodies)
    rows, step = figures.rows(bodies), 1e-5
    for k, name in enumerate(moving):
        shift = np.zeros(len(figures.coordinates))
        shift[figures.coordinates.index(name)] = step
        after, before = (engine.call("poses", coordinates=values + sign * shift) for sign in (1, -1))
        velocity = (after["origins"] - before["origins"])[:, rows] / (2 * step)
        turning = (after["rotations"] - before["rotations"])[:, rows] / (2 * step)
        spin = turning @ np.swapaxes(engine.call("poses", coordinates=values)["rotations"][:, rows], -1, -2)
        assert np.allclose(partial[:, :, 1, :, k], velocity, atol=1e-8)
        assert np.allclose(partial[:, :, 0, 0, k], spin[..., 2, 1], atol=1e-8)
        assert np.allclose(partial[:, :, 0, 1, k], spin[..., 0, 2], atol=1e-8)


def test_exact_markers_give_the_coordinates_back_beyond_the_model_s_ranges(engine):
    """Ranges are not enforced: an ankle at 45 deg is found where a clamped one would stop at 30."""
    figures = built(engine, SCALES)
    markers, start = own_markers(figures)
    values = motion(figures, 12, seed=3)
    values[:, figures.coordinates.index("ankle_angle_l")] += np.radians(40.0)
    places = model_markers(engine, markers, figures, values)
    places[4:7, markers.names.index("LTB2")] = np.nan
    found = follow(engine, figures, trial_of(markers, places), markers, start, 0.0, silent)
    error = np.degrees(np.abs(found.coordinates - values).max(axis=0))
    assert (
        error[figures.columns([n for n in figures.coordinates if n.startswith(("hip", "knee"))])].max() < 0.04
    )
    assert error[figures.columns(["ankle_angle_l", "lumbar_extension", "elbow_flex_r"])].max() < 0.05
    assert np.isnan(found.marker_error[4:7, markers.names.index("LTB2")]).all()
    assert np.nanmax(found.marker_error) < 1e-4
    assert np.isfinite(np.delete(found.marker_error, markers.names.index("LTB2"), axis=1)).all()


def test_any_heading_of_the_subject_is_found(engine):
    figures = built(engine)
    markers, start = own_markers(figures)
    values = motion(figures, 2, seed=4)
    values[:, figures.columns(["pelvis_rotation", "pelvis_tx"])] += [3.0, 2.0]
    places = model_markers(engine, markers, figures, values)
    found = follow(engine, figures, trial_of(markers, places), markers, start, 0.0, silent)
    knees = figures.columns(["knee_angle_r", "knee_angle_l", "hip_flexion_l"])
    assert np.abs(found.coordinates - values)[:, knees].max() < np.radians(0.02)


@pytest.mark.slow
def test_noisy_markers_give_the_poses_of_opensim_s_own_solver(engine):
    figures = built(engine)
    markers, start = own_markers(figures)
    values = motion(figures, 6, seed=5)
    random = np.random.default_rng(0)
    places = model_markers(engine, markers, figures, values)
    places += random.normal(0.0, 0.01, places.shape)
    fitted = engine.call(
        "inverse_kinematics",
        bodies=markers.bodies,
        locations=markers.locations,
        weights=markers.weights,
        measured=places,
        start=start + np.where(np.array(figures.coordinates) == "pelvis_ty", 1.0, 0.0),
        fixed=figures.locked,
    )
    theirs = ask(
        "inverse_kinematics",
        mass_kg=np.array(MASS),
        locked=np.array(figures.locked),
        markers=np.array(markers.names),
        measured=places,
        start_names=np.array(figures.coordinates),
        start=values[0],
    )
    columns = [theirs["names"].tolist().index(name) for name in figures.coordinates]
    their_places = model_markers(engine, markers, figures, theirs["coordinates"][:, columns])
    their_cost = ((their_places - places) ** 2).sum(axis=(1, 2))
    assert ((fitted["errors"] ** 2).sum(axis=1) <= their_cost * (1 + 1e-6)).all()
    legs = [k for k, n in enumerate(figures.coordinates) if n.startswith(("hip", "knee", "ankle"))]
    difference = fitted["coordinates"] - theirs["coordinates"][:, columns]
    assert np.abs(difference[:, legs]).max() < np.radians(0.1)


def test_the_hold_draws_knee_adduction_and_rotation_to_the_start(engine):
    figures = built(engine)
    markers, start = own_markers(figures)
    values = motion(figures, 2, seed=6)
    places = model_markers(engine, markers, figures, values)
    places += np.random.default_rng(6).normal(0.0, 0.01, places.shape)  # as much as on skin
    columns = figures.columns(KNEE_FRONTAL)
    sizes = []
    for hold in (0.0, 0.1, 1e4):
        found = follow(engine, figures, trial_of(markers, places), markers, start, hold, silent)
        sizes.append(np.abs(found.coordinates[:, columns] - start[columns]).max())
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] < 1e-4


@pytest.fixture
def hidden_leg(engine):
    """A motion whose left shank and foot are hidden in some frames."""

    def make(frames: slice):
        figures = built(engine)
        markers, start = own_markers(figures)
        values = motion(figures, 40, seed=7)
        places = model_markers(engine, markers, figures, values)
        below = [k for k, body in enumerate(markers.bodies) if body in ("tibia_l", "talus_l", "calcn_l")]
        places[frames, np.array(below)[:, None]] = np.nan
        return figures, markers, start, values, trial_of(markers, places)

    return make


def test_a_short_gap_of_a_whole_segment_is_bridged_and_told(engine, hidden_leg):
    figures, markers, start, values, trial = hidden_leg(slice(10, 14))
    found = follow(engine, figures, trial, markers, start, 0.0, silent)
    knee = figures.coordinates.index("knee_angle_l")
    assert np.abs(found.coordinates - values)[:, knee].max() < np.radians(1.5)
    assert any("knee_angle_l: 4 frames" in note for note in found.notes)


@pytest.mark.parametrize(("frames", "named"), [(slice(10, 30), "11 to 30"), (slice(0, 3), "1 to 3")])
def test_a_long_or_open_gap_is_refused_with_its_frames(engine, hidden_leg, frames, named):
    figures, markers, start, _, trial = hidden_leg(frames)
    with pytest.raises(InputError, match=f"in frames {named}"):
        follow(engine, figures, trial, markers, start, 0.0, silent)


def test_a_segment_without_markers_is_refused_by_name(engine):
    figures = built(engine)
    markers, start = own_markers(figures)
    places = model_markers(engine, markers, figures, motion(figures, 3, seed=8))
    trial = trial_of(markers, places)
    renamed = tuple(
        n.replace("RTH", "XTH").replace("RLFC", "XLFC").replace("RMFC", "X") for n in markers.names
    )
    renamed = tuple("hip" if n == "RHJC" else n for n in renamed)
    with pytest.raises(InputError, match="right thigh has 0 of the 2") as refused:
        follow(engine, figures, dataclasses.replace(trial, marker_names=renamed), markers, start, 0.0, silent)
    assert "XTH1" in str(refused.value)


@pytest.mark.slow
def test_net_loads_and_inertia_equal_opensim_s(engine):
    """Force and moment across knees and ankles equal the reactions of the prescribed model, to 10 mN."""
    figures = built(engine)
    values = motion(figures, 101, seed=9)
    poses = engine.call("poses", coordinates=values)
    segments = dynamics.momenta(
        poses["rotations"], poses["origins"], figures.masses, figures.centres, figures.inertias, 100.0
    )
    frames = np.array([30, 50, 71])
    theirs = ask(
        "reactions",
        mass_kg=np.array(MASS),
        names=np.array(figures.coordinates),
        time=np.arange(101) / 100.0,
        coordinates=values,
        frames=frames,
    )
    for k, name in enumerate(JOINTS):
        joint = joint_of_model(name)
        body = figures.bodies.index(joint.distal)
        centre = poses["origins"][:, body] + poses["rotations"][:, body] @ figures.joint_centres[joint.distal]
        load = dynamics.net_load(segments, figures.rows(joint.below), centre, [])
        assert np.allclose(load.force[frames], theirs["force"][:, k], atol=0.01), name
        assert np.allclose(load.moment[frames], theirs["moment"][:, k], atol=0.01), name
        columns = figures.columns(joint.coordinates)
        partial = engine.call(
            "partial_velocities", coordinates=values[frames], moving=joint.coordinates, bodies=joint.below
        )
        rows = figures.rows(joint.below)
        arms = segments.centres[frames][:, rows] - poses["origins"][frames][:, rows]
        shift = partial[:, :, 1] + np.cross(partial[:, :, 0], arms[..., None], axis=2)
        tensors = dynamics.inertia_in_ground(poses["rotations"][frames][:, rows], figures.inertias[rows])
        inertia = dynamics.generalised_inertia(partial[:, :, 0], shift, figures.masses[rows], tensors)
        expected = theirs["inertia"][:, columns][:, :, columns]
        assert np.allclose(inertia, expected, atol=1e-6), name
