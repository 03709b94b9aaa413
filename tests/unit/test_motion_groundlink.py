"""Ground reactions of GroundLink: read without executing anything, in newtons and y up, or refused."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch

from hilbrace.config import SubjectSettings
from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.groundlink import check_clock, read_groundlink
from hilbrace.motion.trial_reader import read_trial
from hilbrace.units import GRAVITY
from tests.unit import motion_files as lab

RATE_HZ = 250.0


def write(path, frames=300, **changes):
    """A file as the data set's: left foot first, body weights, third axis up."""
    instants = np.arange(frames) / RATE_HZ
    share = lab.vertical(instants) / (lab.MASS_KG * GRAVITY)
    force = np.zeros((frames, 2, 3))
    force[:, :] = share[:, None, None] * lab.to_lab(np.array([0.05, 1.0, -0.1]))
    centres = np.array([lab.to_lab(np.array(lab.CENTRES[foot])) for foot in ("left", "right")])
    point = np.tile(centres, (frames, 1, 1))
    content = {"GRF": torch.tensor(force), "CoP": torch.tensor(point)} | changes
    torch.save({name: value for name, value in content.items() if value is not None}, path)
    return path


def test_the_recorded_hops_are_read(shared_data):
    """Peak 2.03 body weights, six flights, the left foot does the hopping (figures of the data's README)."""
    path = shared_data / "groundlink_hopping" / "s007_20220705_hopping_1.pth"
    plates = read_groundlink(path, RATE_HZ, 60.0)
    assert plates.names == ("left", "right")
    assert plates.force.shape == (4030, 2, 3)
    vertical = plates.force[:, :, 1].sum(axis=1) / (60.0 * GRAVITY)
    assert vertical.max() == pytest.approx(2.03, abs=0.01)
    aloft = (vertical < 0.05).astype(int)
    assert (np.diff(aloft[500:3400]) == 1).sum() >= 5
    assert np.abs(plates.point[:, :, 1]).max() == 0.0
    assert plates.time[-1] == pytest.approx(4029 / RATE_HZ)


def test_forces_of_tensors_join_markers_of_another_file(tmp_path):
    files = lab.write_files(tmp_path)
    expected = read_trial(files.settings(cutoff_hz=40.0), SubjectSettings(mass_kg=lab.MASS_KG))
    path = write(tmp_path / "move.pth")
    settings = files.settings(cutoff_hz=40.0, forces=path, forces_rate_hz=RATE_HZ)
    trial = read_trial(settings, SubjectSettings(mass_kg=lab.MASS_KG))
    assert trial.ground_force == pytest.approx(expected.ground_force, rel=0.01, abs=1.0)
    assert trial.centre_of_pressure == pytest.approx(expected.centre_of_pressure, abs=1e-6)
    assert any(note.startswith("Plate left: left foot") for note in trial.notes)


def test_the_rate_must_be_given_and_must_fit(tmp_path):
    files = lab.write_files(tmp_path)
    path = write(tmp_path / "move.pth")
    subject = SubjectSettings(mass_kg=lab.MASS_KG)
    with pytest.raises(ConfigError, match=r"needs motion\.forces_rate_hz"):
        read_trial(files.settings(forces=path), subject)
    with pytest.raises(ConfigError, match=r"needs subject\.mass_kg"):
        read_trial(files.settings(forces=path, forces_rate_hz=RATE_HZ), SubjectSettings())
    with pytest.raises(
        InputError, match=r"300 samples at 200 Hz last 1\.50 s, the markers 1\.20 s"
    ) as refused:
        read_trial(files.settings(forces=path, forces_rate_hz=200.0), subject)
    assert "250 Hz would fit" in refused.value.hint


def test_another_recording_s_length_is_refused(tmp_path):
    plates = read_groundlink(write(tmp_path / "long.pth", frames=900), RATE_HZ, 70.0)
    with pytest.raises(InputError, match=r"last 3\.60 s, the markers 1\.20 s"):
        check_clock(plates, lab.time(), lab.RATE_HZ)


class Trap:
    """What a hostile file would hold: unpickling it calls a function."""

    def __reduce__(self):
        return (open, ("sprung", "w"))


def test_nothing_in_a_file_is_executed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"GRF": Trap(), "CoP": Trap()}, tmp_path / "trap.pth")
    (tmp_path / "bare.pth").write_bytes(pickle.dumps(Trap(), protocol=2))
    for name in ("trap.pth", "bare.pth"):
        with pytest.raises(InputError, match=r"more than tensors|no file of tensors"):
            read_groundlink(tmp_path / name, RATE_HZ, 70.0)
    assert not (tmp_path / "sprung").exists()


FAULTS = {
    "no GRF": ({"GRF": None}, "there is no tensor 'GRF' among CoP"),
    "text": ({"GRF": "none"}, "there is no tensor 'GRF'"),
    "shape": ({"GRF": torch.zeros(5, 3)}, r"GRF has the shape \(5, 3\)"),
    "lengths": ({"CoP": torch.zeros(5, 2, 3)}, r"GRF has the shape \(300, 2, 3\), CoP \(5, 2, 3\)"),
    "newtons": ({"GRF": torch.full((300, 2, 3), 400.0)}, "peaks at 800 body weights"),
    "y up": ({"GRF": torch.zeros(300, 2, 3)}, "peaks at 0 body weights"),
    "NaN": ({"GRF": torch.full((300, 2, 3), float("nan"))}, "no number in sample 1"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_other_contents_are_refused_by_name(tmp_path, fault):
    changes, what = FAULTS[fault]
    with pytest.raises(InputError, match=what) as refused:
        read_groundlink(write(tmp_path / "x.pth", **changes), RATE_HZ, 70.0)
    assert "x.pth" in refused.value.where
    assert refused.value.hint


def test_a_damaged_file_is_read_or_refused(tmp_path):
    """120 mutations of a small file: an array of numbers or a named error, never something else."""
    random, path = np.random.default_rng(5), tmp_path / "x.pth"
    whole = write(path, frames=4).read_bytes()
    outcomes = set()
    for _ in range(120):
        content = bytearray(whole)
        for at in random.integers(0, len(whole), 6):
            content[at] = int(random.integers(0, 256))
        path.write_bytes(content)
        try:
            outcomes.add(read_groundlink(path, RATE_HZ, 70.0).force.shape)
        except InputError:
            outcomes.add("refused")
    assert outcomes == {(4, 2, 3), "refused"}


def test_missing_cut_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_groundlink(tmp_path / "none.pth", RATE_HZ, 70.0)
    whole = write(tmp_path / "cut.pth").read_bytes()
    (tmp_path / "cut.pth").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.pth").write_text("time\tforce\n")
    torch.save([1.0, 2.0], tmp_path / "list.pth")
    for name, what in (("cut", "cut short"), ("text", "no file of tensors"), ("list", "holds a list")):
        with pytest.raises(InputError, match=what):
            read_groundlink(tmp_path / f"{name}.pth", RATE_HZ, 70.0)
