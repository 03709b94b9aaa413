"""The user's own model: kept where it fits the subject, scaled where it does not, freed where locked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hilbrace.biomech.engine import Engine
from hilbrace.biomech.kinematics import follow
from hilbrace.biomech.subject_model import subject_model
from hilbrace.body.build import build_body
from hilbrace.config import BiomechSettings, BodySettings, MotionSettings, SubjectSettings
from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import read_marker_map
from hilbrace.motion.opensim_files import coordinates_rad, read_storage
from hilbrace.motion.trial_reader import read_trial
from hilbrace.run.progress import silent

pytestmark = pytest.mark.slow

WINDOW = (1.5, 1.8)


@pytest.fixture(scope="module")
def jump(shared_data):
    root = shared_data / "opencap_subject4"
    settings = MotionSettings(
        markers=root / "markers/DJ1.trc",
        forces=root / "grf/DJ1_grf.mot",
        static=root / "markers/static1.trc",
        marker_map="opencap",
        window=WINDOW,
    )
    trial = read_trial(settings, SubjectSettings(mass_kg=62.6))
    return trial, build_body(trial, BodySettings())


@pytest.fixture(scope="module")
def models(shared_data) -> Path:
    return shared_data / "opencap_subject4" / "models"


@pytest.fixture(scope="module")
def engine():
    with Engine() as running:
        yield running


def knees(engine, trial, model) -> np.ndarray:
    """Right and left knee flexion [deg]."""
    found = follow(engine, model.figures, trial, model.markers, model.start, 0.03, silent)
    return np.degrees(found.coordinates[:, model.figures.columns(["knee_angle_r", "knee_angle_l"])])


def published(shared_data, time) -> np.ndarray:
    path = shared_data / "opencap_subject4/ik_manual_scaling/DJ1_manual_scaling_ik.mot"
    columns = coordinates_rad(reference := read_storage(path))
    sides = [np.interp(time, reference.time, columns[f"knee_angle_{s}"]) for s in "rl"]
    return np.degrees(np.stack(sides, axis=1))


def test_a_scaled_model_keeps_its_size_and_markers(engine, jump, models, shared_data):
    trial, body = jump
    settings = BiomechSettings(model=models / "manually_scaled.osim")
    model = subject_model(engine, trial, body, read_marker_map("opencap"), settings)
    assert model.figures.mass_kg == pytest.approx(62.6, abs=0.01)
    assert any("used with its own size" in note for note in model.notes)
    assert any("markers are where the model has them" in note for note in model.notes)
    difference = knees(engine, trial, model) - published(shared_data, trial.time)
    assert np.sqrt((difference**2).mean(axis=0)).max() < 1.5


def test_a_generic_model_is_scaled_to_the_subject(engine, jump, models, shared_data):
    """The published generic model comes out within 1.5 deg of the publisher's own scaled one."""
    trial, body = jump
    settings = BiomechSettings(model=models / "unscaled_generic.osim")
    model = subject_model(engine, trial, body, read_marker_map("opencap"), settings)
    assert model.figures.mass_kg == pytest.approx(62.6, abs=0.01)
    assert any("75.3 kg is not the subject's: it was scaled to 62.6 kg" in note for note in model.notes)
    difference = knees(engine, trial, model) - published(shared_data, trial.time)
    assert np.sqrt((difference**2).mean(axis=0)).max() < 1.5
    joints = {name: k for k, name in enumerate(body.joint_names)}
    wanted = np.linalg.norm(body.joint_centres[joints["knee_r"]] - body.joint_centres[joints["ankle_r"]])
    frames = engine.call("poses", coordinates=np.zeros((1, len(model.figures.coordinates))))
    rows = model.figures.rows(["tibia_r", "talus_r"])
    ends = [
        frames["origins"][0, row] + frames["rotations"][0, row] @ model.figures.joint_centres[name]
        for row, name in zip(rows, ("tibia_r", "talus_r"), strict=True)
    ]
    assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(wanted, rel=0.01)


def test_locked_knees_and_hips_are_freed_and_told(engine, jump, models, tmp_path):
    trial, body = jump
    text = (models / "manually_scaled.osim").read_text()
    for name in ("knee_angle_l", "hip_flexion_r"):
        at = text.index(f'<Coordinate name="{name}">')
        end = text.index("</Coordinate>", at)
        part = text[at:end]
        assert "<locked>false</locked>" in part
        text = text[:at] + part.replace("<locked>false</locked>", "<locked>true</locked>") + text[end:]
    path = tmp_path / "locked.osim"
    path.write_text(text)
    marker_map = read_marker_map("opencap")
    model = subject_model(engine, trial, body, marker_map, BiomechSettings(model=path))
    assert set(model.figures.locked) >= {"knee_angle_l", "hip_flexion_r"}
    note = next(note for note in model.notes if "locks" in note)
    assert "knee_angle_l" in note
    assert "freed" in note
    assert np.ptp(knees(engine, trial, model)[:, 1]) > 15.0


def test_markers_under_other_names_are_placed_by_the_map(engine, jump, models, tmp_path):
    trial, body = jump
    text = (models / "manually_scaled.osim").read_text()
    for name in ("r_thigh1", "r_thigh2", "r_thigh3", "r_thigh4", "r_thigh5", "r_knee"):
        text = text.replace(f'<Marker name="{name}">', f'<Marker name="other_{name}">')
    path = tmp_path / "renamed.osim"
    path.write_text(text)
    model = subject_model(engine, trial, body, read_marker_map("opencap"), BiomechSettings(model=path))
    assert any("the right thigh has 0 of the 2 markers" in note for note in model.notes)
    assert "r_thigh1" in model.markers.names


def test_a_model_without_arms_leaves_their_markers_out(engine, shared_data):
    root = shared_data / "gc5_instrumented_knee"
    settings = MotionSettings(
        markers=root / "trc/PS_ngait_og_ss1.trc",
        forces=root / "grf/PS_ngait_og_ss1_kinetics.mot",
        static=root / "trc/Static_for_scaling.trc",
        marker_map="knee_challenge",
        window=(0.0, 0.2),
    )
    trial = read_trial(settings, SubjectSettings(mass_kg=75.0))
    own = BiomechSettings(model=root / "models/Rajagopal2015_no_arms.osim")
    body = build_body(trial, BodySettings())
    model = subject_model(engine, trial, body, read_marker_map("knee_challenge"), own)
    assert any("no bodies for the markers LElbow" in note for note in model.notes)
    assert any("scaled to 75.0 kg" in note for note in model.notes)
    assert "LElbow" not in model.markers.names


def test_a_model_without_ankles_is_refused_by_name(engine, jump, models, tmp_path):
    trial, body = jump
    text = (models / "manually_scaled.osim").read_text()
    path = tmp_path / "renamed.osim"
    path.write_text(text.replace("ankle_angle_r", "right_ankle"))
    with pytest.raises(InputError, match="the model has no ankle_angle_r") as refused:
        subject_model(engine, trial, body, read_marker_map("opencap"), BiomechSettings(model=path))
    assert "renamed.osim" in refused.value.where
