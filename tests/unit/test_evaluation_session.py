"""What the operator may order, and what is on the disk afterwards."""

from __future__ import annotations

import json
import time
import tomllib

import numpy as np
import pytest

from evaluation.live import session as live_session
from evaluation.live.screen import session_state
from evaluation.live.session import LabSession
from evaluation.live.settings import LabSettings, read_lab
from evaluation.live.takes import StudyFile, Take, log_name
from evaluation.record.reading import read_log
from evaluation.sources.stream import Item, LabError, MarkerFrame, PlateInfo, PlateSamples, SourceInfo
from hilbrace.cli import main
from hilbrace.errors import ConfigError, InputError
from mocks import synthetic_study as made_up

SETTINGS = {
    "baseline": "Unbraced",
    "conditions": [{"name": "Unbraced"}, {"name": "Firm brace"}],
    "protocol": {"side": "left", "hip": {"model": "marker"}},
}

RAW = PlateInfo(
    "1", 1000.0, ("Fx", "Fy", "Fz", "Mx", "My", "Mz"), ("count",) * 6, 0.5 * np.eye(6), np.eye(3),
    np.zeros(3), np.full((4, 3), np.nan), zeroed=False,
)  # fmt: skip


class StandingLeg:
    """A leg that stands still on a plate that was never zeroed, as fast as it is asked for."""

    def __init__(self, offset: float = 40.0) -> None:
        self.name = "lab"
        self.table = made_up.standing_recording(1, made_up.Scatter(wobble_mm=0.0)).markers
        self.rng, self.offset, self.number = np.random.default_rng(4), offset, 0

    def open(self) -> SourceInfo:
        return SourceInfo("lab", "a leg", self.table.names, 200.0, "y", (RAW,))

    def read(self, timeout_s: float) -> list[Item]:
        time.sleep(0.005)
        items: list[Item] = []
        for _ in range(4):
            k, now, at = self.number, time.monotonic_ns(), self.number / 200
            counts = np.rint(self.rng.normal(0, 1.0, (5, 6)))
            counts[:, 1] += self.offset
            items += [
                MarkerFrame("lab", k, at, now, self.table.positions[k % len(self.table.time)]),
                PlateSamples("lab", "1", 5 * k, at, 0.001, now, counts),
            ]
            self.number += 1
        return items

    def close(self) -> None:
        pass


@pytest.fixture
def session(tmp_path):
    made = LabSession(LabSettings.model_validate(SETTINGS), tmp_path / "out", [StandingLeg()])
    made.start()
    until(lambda: made.analysis.frames > 0)
    yield made
    made.stop()


def until(condition, seconds=60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def record_for(session, frames: int) -> None:
    wanted = session.analysis.frames + frames
    until(lambda: session.analysis.frames >= wanted)


def test_a_session_from_standing_to_the_study_file(session):
    assert "recorded" in session.record_standing().result(60)
    until(lambda: session.analysis.readings().knee_deg is not None)
    assert np.allclose(session.analysis.readings().knee_deg, 0.0, atol=2.0)
    assert session.begin_take() == "Recording unbraced_1.mcap"
    with pytest.raises(InputError, match="a take is running"):
        session.begin_take()
    with pytest.raises(InputError, match="a take is running"):
        session.record_standing()
    record_for(session, 100)
    assert "unbraced_1.c3d is written (Unbraced)" in session.end_take()
    assert session.choose_condition("Firm brace") == "Firm brace is next"
    session.begin_take()
    record_for(session, 100)
    session.end_take()
    with pytest.raises(InputError, match="no take is running"):
        session.end_take()
    with pytest.raises(InputError, match="no condition"):
        session.choose_condition("Other")
    assert [(row.condition, row.takes) for row in session.tally()] == [("Unbraced", 1), ("Firm brace", 1)]
    study = tomllib.loads((session.folder / "study.toml").read_text())
    assert study["standing"] == "standing.c3d"
    assert study["conditions"] == [
        {"name": "Unbraced", "trials": ["unbraced_1.c3d"]},
        {"name": "Firm brace", "trials": ["firm_brace_1.c3d"]},
    ]
    assert main(["evaluate", "angles", str(session.folder / "study.toml"), "--json"]) == 0
    state = session_state(session)
    assert json.loads(json.dumps(state, allow_nan=False))["fault"] == ""


def test_the_zero_of_a_plate_lands_in_the_recording_and_on_the_screen(session):
    until(lambda: session.analysis.readings().force_n is not None)
    assert session.analysis.readings().force_n == pytest.approx(20.0, abs=3.0)
    assert session.zero_plates().result(60) == "1 plate zeroed"
    until(lambda: abs(session.analysis.readings().force_n) < 3.0)
    session.begin_take()
    record_for(session, 100)
    session.end_take()
    recorded = read_log(session.takes[0].log)
    (zero,) = [mark for mark in recorded.marks if mark.kind == "zero"]
    assert zero.content["channels"][1] == pytest.approx(40.0, abs=0.5)
    assert not any("never zeroed" in note for note in session.takes[0].notes)
    counts = np.concatenate([i.values for i in recorded.items if isinstance(i, PlateSamples)])
    assert counts[:, 1].mean() == pytest.approx(40.0, abs=0.5)


def test_a_take_without_a_zero_says_so(session):
    session.begin_take()
    record_for(session, 60)
    assert "never zeroed" in session.end_take()


def test_a_session_that_ends_finishes_its_take(tmp_path):
    session = LabSession(LabSettings.model_validate(SETTINGS), tmp_path, [StandingLeg()])
    session.start()
    until(lambda: session.analysis.frames > 0)
    session.begin_take()
    record_for(session, 60)
    session.stop()
    assert read_log(tmp_path / "unbraced_1.mcap").finished
    assert (tmp_path / "unbraced_1.c3d").is_file()


def test_standing_needs_markers_that_come(tmp_path, monkeypatch):
    session = LabSession(LabSettings.model_validate(SETTINGS), tmp_path, [])
    session.start()
    with pytest.raises(LabError, match="no device sends markers"):
        session.record_standing()
    assert "zero themselves" in session.zero_plates().result(20)
    session.stop()
    silent = LabSession(LabSettings.model_validate(SETTINGS), tmp_path, [Mute()])
    monkeypatch.setattr(live_session, "LATEST_S", 0.1)
    silent.start()
    until(lambda: silent.analysis.marker_source() is not None)
    with pytest.raises(InputError, match="no markers"):
        silent.record_standing().result(20)
    assert silent.busy == ""
    silent.stop()


class Mute(StandingLeg):
    def read(self, timeout_s: float) -> list[Item]:
        time.sleep(0.01)
        return []


def test_a_study_goes_on_where_it_was_left(tmp_path):
    settings = LabSettings.model_validate(SETTINGS)
    study = StudyFile(tmp_path, settings)
    study.add(Take("Unbraced", tmp_path / "a.mcap", tmp_path / "a.c3d", ()))
    assert not study.path.exists()
    study.add(Take("standing", tmp_path / "s.mcap", tmp_path / "s.c3d", ()))
    by_hand = study.path.read_text() + '\n[events."a.c3d"]\nbending_s = 1.5\n'
    study.path.write_text(by_hand)
    again = StudyFile(tmp_path, settings)
    assert again.counts == {"Unbraced": 1, "Firm brace": 0}
    assert again.standing == tmp_path / "s.c3d"
    again.add(Take("Firm brace", tmp_path / "b.mcap", tmp_path / "b.c3d", ()))
    content = tomllib.loads(study.path.read_text())
    assert content["events"] == {"a.c3d": {"bending_s": 1.5}}
    assert [c["trials"] for c in content["conditions"]] == [["a.c3d"], ["b.c3d"]]


@pytest.mark.parametrize("content", ["name = ", '[[conditions]]\nname = "Other"\ntrials = []\n'])
def test_a_study_that_is_another_is_left_alone(tmp_path, content):
    (tmp_path / "study.toml").write_text(content)
    with pytest.raises(ConfigError):
        StudyFile(tmp_path, LabSettings.model_validate(SETTINGS))
    assert (tmp_path / "study.toml").read_text() == content


def test_names_of_takes(tmp_path):
    assert log_name(tmp_path, "Unopt. (Voronoi)").name == "unopt_voronoi_1.mcap"
    (tmp_path / "unopt_voronoi_1.c3d").touch()
    assert log_name(tmp_path, "Unopt. (Voronoi)").name == "unopt_voronoi_2.mcap"
    assert log_name(tmp_path, "\u00e4\u00f6").name == "take_1.mcap"
    assert log_name(tmp_path, "../../etc").parent == tmp_path


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"baseline": "None"}, "no condition"),
        ({"conditions": [{"name": "A"}, {"name": "A"}], "baseline": "A"}, "listed twice"),
        ({"conditions": [{"name": "Unbraced", "published": "x"}]}, "no row"),
        ({"protocol": {"hip": {"model": "marker"}}}, "'protocol.side' is missing"),
        ({"device": []}, "unknown key 'device'"),
        ({"conditions": []}, "'conditions'"),
    ],
)
def test_mistakes_in_the_lab_s_file_are_named(tmp_path, change, what):
    import tomli_w

    path = tmp_path / "lab.toml"
    path.write_text(tomli_w.dumps(SETTINGS))
    assert read_lab(path).names == ("Unbraced", "Firm brace")
    path.write_text(tomli_w.dumps(SETTINGS | change))
    with pytest.raises(ConfigError, match=what.replace("(", r"\(")):
        read_lab(path)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_lab(tmp_path / "absent.toml")
    (tmp_path / "lab.toml").write_text("a = = 1")
    with pytest.raises(ConfigError, match="not valid TOML"):
        read_lab(tmp_path / "lab.toml")
