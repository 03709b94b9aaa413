"""The study file: what is wrong in it is named, with what mends it."""

from __future__ import annotations

from pathlib import Path

import pytest

from evaluation.study import read_study
from hilbrace.errors import ConfigError

STUDY = """
name = "Serve"
standing = "standing.c3d"
baseline = "Unbraced"

[protocol]
side = "left"

[protocol.hip]
model = "trochanter"
trochanter_width_m = 0.36

[[conditions]]
name = "Unbraced"
published = "unbraced"
trials = ["u1.c3d", "u2.c3d"]

[[conditions]]
name = "Brace"
trials = "b*.c3d"

[events."u2.c3d"]
landing_s = 1.85
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("standing", "u1", "u2", "b1", "b2", "b3"):
        (tmp_path / f"{name}.c3d").touch()
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


def edit(folder: Path, old: str, new: str) -> Path:
    path = folder / "study.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    return path


def test_trials_and_paths_are_found(folder):
    study = read_study(folder / "study.toml")
    assert study.names == ("Unbraced", "Brace")
    assert study.baseline == 0
    assert [trial.path.name for trial in study.trials] == ["u1.c3d", "u2.c3d", "b1.c3d", "b2.c3d", "b3.c3d"]
    assert [trial.condition for trial in study.trials] == [0, 0, 1, 1, 1]
    assert study.trials[1].events.landing_s == 1.85
    assert study.settings.standing == folder / "standing.c3d"
    assert study.settings.protocol.markers.thigh == ("TH1", "TH2", "TH3", "TH4")


WRONG = {
    "misspelt key": ("baseline =", "basline =", "unknown key 'basline'", "did you mean 'baseline'?"),
    "misspelt hip": ('model = "trochanter"', 'model = "trochantor"', "protocol.hip.model", "correct"),
    "no hip": ('model = "trochanter"\n', "", "'protocol.hip.model' is missing", "trochanter"),
    "no side": ('side = "left"\n', "", "'protocol.side' is missing", "which leg"),
    "other baseline": ('baseline = "Unbraced"', 'baseline = "Unbrace"', "baseline = 'Unbrace'", "'Unbraced'"),
    "missing file": ('"u2.c3d"]', '"u9.c3d"]', "has no file u9.c3d", "correct 'trials'"),
    "empty pattern": ('"b*.c3d"', '"c*.c3d"', "has no files 'c*.c3d'", "correct 'trials'"),
    "twice": ('name = "Brace"', 'name = "Unbraced"', "condition 'Unbraced' is listed twice", "once"),
    "trial twice": ('"b*.c3d"', '"*1.c3d"', "u1.c3d' is listed twice", "once"),
    "published": ('"unbraced"', '"unbracd"', "published = 'unbracd'", "'unbraced'"),
    "events": ('[events."u2.c3d"]', '[events."u3.c3d"]', "events = 'u3.c3d'", "did you mean"),
    "toml": ('name = "Serve"', 'name = Serve"', "not valid TOML", "line"),
    "cutoff": (
        "[protocol.hip]", "[protocol.processing]\ncutoff_hz = -1\n[protocol.hip]", "cutoff", "correct"),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_wrong_is_named(folder, fault):
    old, new, what, mend = WRONG[fault]
    with pytest.raises(ConfigError) as caught:
        read_study(edit(folder, old, new))
    assert what in caught.value.what
    assert mend in caught.value.hint
    assert str(folder / "study.toml") in caught.value.where


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="no such study file"):
        read_study(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="this is a folder"):
        read_study(tmp_path)
