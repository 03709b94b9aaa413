"""The user's SKEL file: converted once without running it, then a body like any other."""

from __future__ import annotations

import importlib
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hilbrace.body.build import body_of
from hilbrace.body.convert_skel import SKEL_BONES, convert, main, read_skel_pickle
from hilbrace.body.model import BodyModel
from hilbrace.body.posing import bone_transforms, posed_skin
from hilbrace.body.skel import SkelBody, load_skel
from hilbrace.config import BodySettings
from hilbrace.errors import ConfigError, InputError
from tests.unit.body_people import person, scales_of
from tests.unit.skel_file import TO_SMPL, write_skel

pytest.importorskip("body_models.skel.numpy", reason="the extra skel is not installed")


@pytest.fixture(scope="module")
def pickled(tmp_path_factory) -> Path:
    return write_skel(tmp_path_factory.mktemp("skel") / "skel_male.pkl")


@pytest.fixture(scope="module")
def converted(pickled) -> Path:
    path = pickled.with_suffix(".npz")
    convert(pickled, path)
    return path


@pytest.fixture(scope="module")
def body(converted):
    settings = BodySettings(model="skel", model_file=converted)
    return body_of(scales_of(1.75), 75.0, 1.75, settings)


def test_the_converted_skin_is_body_models_own_for_any_shape(pickled, converted):
    library = importlib.import_module("body_models.skel.numpy").SKEL(model_path=pickled, gender="male")
    model = load_skel(converted, "male")
    assert isinstance(model, BodyModel)
    shapes = np.random.default_rng(3).normal(0.0, 1.0, (4, 10)).astype(np.float32)
    pose = {"body_pose": np.zeros((4, 43), np.float32), "head_pose": np.zeros((4, 3), np.float32)}
    skin = library.forward_vertices(**pose, shape=shapes)
    joints = library.forward_skeleton(**pose, shape=shapes)[..., :3, 3]
    for k, shape in enumerate(shapes.astype(float)):
        np.testing.assert_allclose(model.vertices(shape) @ TO_SMPL.T, skin[k], atol=2e-5)
        own = model.joints(shape)
        for name, bone in (("hip_r", "femur_r"), ("knee_l", "tibia_l"), ("ankle_r", "talus_r")):
            np.testing.assert_allclose(TO_SMPL @ own[name], joints[k, SKEL_BONES.index(bone)], atol=2e-5)
    assert model.linear_error_mm < 0.1
    assert (model.gender, model.version) == ("male", "1.1.1")


def test_a_fitted_skel_body_has_the_persons_figures_and_the_skeletons_joints(body):
    assert body.model == "skel"
    assert len(body.shape) == 10
    assert np.ptp(body.vertices[:, 1]) == pytest.approx(1.75, abs=0.003)
    same = person()
    np.testing.assert_allclose(body.joint_centres, same.joint_centres)
    knee, ankle = (same.joint_centres[same.joint_names.index(n)][1] for n in ("knee_r", "ankle_r"))
    leg = (same.vertices[:, 1] < knee + 0.15) & (same.vertices[:, 1] > ankle)
    assert np.linalg.norm((body.vertices - same.vertices)[leg], axis=1).mean() < 0.01


@pytest.mark.parametrize("side", ["r", "l"])
@pytest.mark.parametrize("model", ["skel", "anny"])
def test_adduction_and_rotation_of_the_knee_move_the_shank_and_foot(body, side, model):
    body = body if model == "skel" else person()
    for coordinate in (f"knee_adduction_{side}", f"knee_rotation_{side}"):
        values = np.radians([[10.0]])
        posed = posed_skin(body, [coordinate], values)[0]
        rotations, translations = bone_transforms(body, [coordinate], values)
        bone = body.bones.index(f"tibia_{side}")
        turn = np.degrees(np.arccos((np.trace(rotations[0, bone]) - 1.0) / 2.0))
        assert turn == pytest.approx(10.0, abs=1e-6)
        shank = body.bone_weights[:, bone] > 0.9
        rigid = body.vertices[shank] @ rotations[0, bone].T + translations[0, bone]
        moved = np.linalg.norm(posed - body.vertices, axis=1)
        assert np.linalg.norm(posed[shank] - rigid, axis=1).max() < 0.006
        assert moved[body.bone_weights[:, body.bones.index(f"calcn_{side}")] > 0.8].max() > 0.02
        other = "l" if side == "r" else "r"
        assert moved[body.bone_weights[:, body.bones.index(f"tibia_{other}")] > 0.5].max() < 1e-6


def test_conversion_is_the_same_twice(pickled, converted, tmp_path):
    convert(pickled, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == converted.read_bytes()


SMALL = np.zeros((1, 3, 207))
"""Correctives of the pose that no test of damaged files needs in full."""


class Runs:
    """Pickles as a call that makes a folder."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


class Stranger:
    """Pickles as an object of a class that the reader does not know."""

    def __init__(self):
        self.value = 3


def test_a_file_that_would_run_code_is_refused_and_runs_nothing(tmp_path):
    trap = tmp_path / "made by the pickle"
    path = write_skel(tmp_path / "skel_male.pkl", version=Runs(trap), posedirs=SMALL)
    with pytest.raises(InputError, match=r"asks to run (posix|nt)\.mkdir"):
        read_skel_pickle(path)
    assert not trap.exists()


def test_unknown_objects_that_are_not_needed_are_skipped_and_needed_ones_named(tmp_path):
    path = write_skel(tmp_path / "skel_male.pkl", extra=Stranger(), posedirs=SMALL)
    assert read_skel_pickle(path)["version"] == "1.1.1"
    path = write_skel(tmp_path / "skel_male.pkl", shapedirs=Stranger(), posedirs=SMALL)
    with pytest.raises(InputError, match="'shapedirs' is no array"):
        read_skel_pickle(path)


@pytest.mark.parametrize(
    ("changes", "message", "mend"),
    [
        ({"version": "1.0"}, "version 1.0, and 1.1.1 is understood", "download"),
        ({"version": None}, "version unknown", "download"),
        ({"J_regressor_osim": None}, "lacks J_regressor_osim", "skel_male.pkl"),
        ({"skin_weights": None, "v_template": np.zeros((6890, 3))}, "it is an SMPL file", "skel_male.pkl"),
        ({"apose_rel_transfo": np.zeros((22, 4, 4))}, r"shape \(22, 4, 4\)", "SKEL"),
        ({"posedirs": np.array([[np.nan]])}, "'posedirs' is no array of numbers", "download"),
    ],
)
def test_wrong_files_are_named(tmp_path, changes, message, mend):
    path = write_skel(tmp_path / "skel_male.pkl", **({"posedirs": SMALL} | changes))
    with pytest.raises(InputError, match=message) as caught:
        read_skel_pickle(path)
    assert mend in caught.value.hint
    assert str(path) in caught.value.where


@pytest.mark.parametrize("content", [b"", b"no pickle", b"\x80\x04\x95", pickle.dumps([1, 2])])
def test_damaged_files_are_refused(tmp_path, content):
    path = tmp_path / "skel_male.pkl"
    path.write_bytes(content)
    with pytest.raises(InputError):
        read_skel_pickle(path)


def test_runs_never_open_a_pickle_and_say_how_to_convert(pickled):
    with pytest.raises(InputError, match="pickle can run any code") as caught:
        body_of(scales_of(1.75), 75.0, 1.75, BodySettings(model="skel", model_file=pickled))
    assert "python -m hilbrace.body.convert_skel" in caught.value.hint
    with pytest.raises(ConfigError, match="no SKEL file is named"):
        load_skel(None)
    with pytest.raises(InputError, match="no such file"):
        load_skel(Path("nowhere.npz"))


def test_the_wrong_gender_is_named(converted, pickled, tmp_path):
    settings = BodySettings(model="skel", model_file=converted, gender="female")
    with pytest.raises(ConfigError, match=r"is male and body\.gender asks"):
        body_of(scales_of(1.75), 75.0, 1.75, settings)
    with pytest.raises(ConfigError, match="the file is male and female is asked for"):
        convert(pickled, tmp_path / "x.npz", "female")
    plain = tmp_path / "model.pkl"
    plain.write_bytes(pickled.read_bytes())
    with pytest.raises(ConfigError, match="tells the gender"):
        convert(plain, tmp_path / "x.npz")
    assert convert(plain, tmp_path / "x.npz", "female").gender == "female"


def test_a_record_of_another_kind_is_no_skel_file(tmp_path):
    from hilbrace.run import records

    records.save(person(), tmp_path / "body.npz")
    with pytest.raises(InputError, match="holds a Body, not a SkelBody"):
        load_skel(tmp_path / "body.npz")


def test_the_command_converts_and_reports(pickled, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "hilbrace.body.convert_skel", pickled, tmp_path / "out.npz"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "SKEL 1.1.1, male" in done.stderr
    assert isinstance(load_skel(tmp_path / "out.npz"), SkelBody)


def test_the_command_fails_in_two_lines(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "none.pkl"), str(tmp_path / "out.npz")])
    assert ended.value.code == InputError.exit_code
    assert len(capsys.readouterr().err.strip().splitlines()) == 2
