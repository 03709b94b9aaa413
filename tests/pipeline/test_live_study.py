"""A study measured live gives the table that the same study gives from its C3D files."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib

import pytest

from evaluation.published import published_rows
from mocks import synthetic_study as made_up
from tests.pipeline.live_mocks import ROOT

REPEATS, SECONDS, RATE_HZ = 5, 4.0, 200


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The whole synthetic study as C3D files: six conditions, five repeats."""
    return made_up.write_study(tmp_path_factory.mktemp("study"), seed=11, seconds=SECONDS, repeats=REPEATS)


@pytest.fixture(scope="module")
def live(study, tmp_path_factory):
    """The same study, recorded take by take from a Vicon system's bytes."""
    folder = tmp_path_factory.mktemp("live")
    words = [str(study), str(folder), str(round(SECONDS * RATE_HZ))]
    done = subprocess.run(
        [sys.executable, "-m", "tests.pipeline.live_operator", *words],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder, json.loads(done.stdout)


def table_of(path):
    words = [sys.executable, "-m", "hilbrace", "evaluate", "table", str(path), "--json"]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout)


@pytest.mark.slow
def test_the_table_is_that_of_the_files(study, live):
    folder, said = live
    assert said["notes"] == [[]] * 6 * REPEATS
    ours, theirs = table_of(folder / "study.toml"), table_of(study)
    assert len(ours["cells"]) == len(theirs["cells"]) > 0
    for one, other in zip(ours["cells"], theirs["cells"], strict=True):
        for key, value in other.items():
            if isinstance(value, float):
                assert one[key] == pytest.approx(value, abs=1e-6), (one["condition"], key)
            else:
                assert one[key] == value


@pytest.mark.slow
def test_the_study_file_is_the_one_that_was_played(live):
    folder, _ = live
    written = tomllib.loads((folder / "study.toml").read_text())
    assert written["standing"] == "standing.c3d"
    assert [len(condition["trials"]) for condition in written["conditions"]] == [REPEATS] * 6
    assert written["protocol"]["processing"]["cutoff_hz"] == 12.0
    assert len(list(folder.glob("*.mcap"))) == 1 + 6 * REPEATS


@pytest.mark.slow
def test_the_tally_shows_while_measuring_what_the_table_says_later(live):
    """Live angles are unfiltered and the planted peaks scatter between five repeats."""
    planted = made_up.planted_angles()
    _, said = live
    assert [row["takes"] for row in said["tally"]] == [REPEATS] * 6
    for (key, row), shown in zip(published_rows().items(), said["tally"], strict=True):
        assert row.title == shown["condition"]
        for name, angles in zip(("bending", "landing"), planted[key], strict=True):
            assert shown[name]["flexion_deg"] == pytest.approx(-angles[0], abs=3.0)
            assert shown[name]["adduction_deg"] == pytest.approx(angles[1], abs=1.5)
