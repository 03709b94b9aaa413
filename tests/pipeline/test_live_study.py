"""A study measured live gives the table that the same study gives from its C3D files."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

from evaluation.published import published_rows
from mocks import synthetic_study as made_up
from tests.pipeline.live_mocks import ROOT

SECONDS, RATE_HZ = 4.0, 200


@dataclass(frozen=True)
class Measured:
    """A study measured twice: from files, and live."""

    repeats: int
    files: Path
    folder: Path
    said: dict


def measure(folder: Path, repeats: int) -> Measured:
    """Write a study as C3D files, and record it take by take from a Vicon system's bytes."""
    study = made_up.write_study(folder / "files", seed=11, seconds=SECONDS, repeats=repeats)
    words = [str(study), str(folder / "live"), str(round(SECONDS * RATE_HZ))]
    done = subprocess.run(
        [sys.executable, "-m", "tests.pipeline.live_operator", *words],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return Measured(repeats, study, folder / "live", json.loads(done.stdout))


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """All six conditions, with two repeats each."""
    return measure(tmp_path_factory.mktemp("study"), 2)


def assert_same_table(measured: Measured) -> None:
    assert measured.said["notes"] == [[]] * 6 * measured.repeats
    assert len(measured.said["files"]) > 0
    for one, other in zip(measured.said["live"], measured.said["files"], strict=True):
        for key, value in other.items():
            if isinstance(value, float):
                assert one[key] == pytest.approx(value, abs=1e-6), (one["condition"], key)
            else:
                assert one[key] == value


@pytest.mark.slow
def test_the_table_is_that_of_the_files(measured):
    assert_same_table(measured)


@pytest.mark.slow
def test_the_study_file_is_the_one_that_was_played(measured):
    written = tomllib.loads((measured.folder / "study.toml").read_text())
    assert written["standing"] == "standing.c3d"
    assert [len(c["trials"]) for c in written["conditions"]] == [measured.repeats] * 6
    assert written["protocol"]["processing"]["cutoff_hz"] == 12.0
    assert len(list(measured.folder.glob("*.mcap"))) == 1 + 6 * measured.repeats


@pytest.mark.slow
def test_the_tally_shows_while_measuring_what_the_table_says_later(measured):
    """Live angles are unfiltered and the planted peaks scatter between repeats."""
    planted = made_up.planted_angles()
    tally = measured.said["tally"]
    assert [row["takes"] for row in tally] == [measured.repeats] * 6
    for (key, row), shown in zip(published_rows().items(), tally, strict=True):
        assert row.title == shown["condition"]
        for name, angles in zip(("bending", "landing"), planted[key], strict=True):
            assert shown[name]["flexion_deg"] == pytest.approx(-angles[0], abs=6.0)
            assert shown[name]["adduction_deg"] == pytest.approx(angles[1], abs=2.0)


@pytest.mark.soak
def test_the_table_of_five_repeats_is_that_of_the_files(tmp_path):
    assert_same_table(measure(tmp_path, 5))
