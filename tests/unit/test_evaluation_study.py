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


def in_folders(folder: Path) -> Path:
    """The same study as laboratories store it: one folder per condition, T1, T2, ... in each."""
    for condition in ("none", "brace"):
        (folder / condition).mkdir()
        for number in (1, 2):
            (folder / condition / f"T{number}.c3d").touch()
    text = STUDY.replace('["u1.c3d", "u2.c3d"]', '"none/*.c3d"').replace('"b*.c3d"', '"brace/*.c3d"')
    path = folder / "folders.toml"
    path.write_text(text.replace('[events."u2.c3d"]', '[events."brace/T2.c3d"]'))
    return path


def test_files_of_one_name_in_several_folders_stay_apart(folder):
    study = read_study(in_folders(folder))
    assert [trial.name for trial in study.trials] == ["none_T1", "none_T2", "brace_T1", "brace_T2"]
    assert [trial.key for trial in study.trials][2:] == ["brace/T1.c3d", "brace/T2.c3d"]
    assert [trial.events.landing_s for trial in study.trials] == [None, None, None, 1.85]


def test_an_event_of_a_name_that_several_files_have_is_refused(folder):
    path = in_folders(folder)
    path.write_text(path.read_text().replace("brace/T2.c3d", "T2.c3d"))
    with pytest.raises(ConfigError, match=r"events = 'T2\.c3d'") as caught:
        read_study(path)
    assert "T2.c3d'" in caught.value.hint


def test_one_name_with_two_endings_is_refused(folder):
    (folder / "b1.trc").touch()
    with pytest.raises(ConfigError, match="listed twice"):
        read_study(edit(folder, '"b*.c3d"', '"b1.*"'))


@pytest.mark.parametrize("pattern", ["", "/no/such/folder/*.c3d", "**x/*.c3d"])
def test_a_pattern_that_finds_nothing_is_refused(folder, pattern):
    with pytest.raises(ConfigError, match="has no "):
        read_study(edit(folder, '"b*.c3d"', f'"{pattern}"'))


def test_a_pattern_may_name_its_folder_in_full_and_skips_hidden_copies(folder):
    (folder / "._b1.c3d").touch()
    pattern = f"{folder.as_posix()}/[._b]*.c3d"
    assert len(read_study(edit(folder, '"b*.c3d"', f'"{pattern}"')).trials) == 5


def test_no_trials_and_trials_of_another_kind_are_named(folder):
    with pytest.raises(ConfigError, match="'Brace' has no trials"):
        read_study(edit(folder, '"b*.c3d"', "[]"))
    with pytest.raises(ConfigError, match=r"'conditions\.1\.trials' = 3"):
        read_study(edit(folder, "trials = []", "trials = 3"))
