"""Every standard knee gets a brace six times as selective as the uniform one, and firm enough.

The default design, at full size, of the built-in subject and of the recordings; only optimized, not drawn.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hilbrace.cli import main

pytestmark = [pytest.mark.soak, pytest.mark.timeout(900)]

HERE = Path(__file__).parent
BUILT_IN = [(motion, side) for motion in ("serve", "gait") for side in ("left", "right")]
RECORDED = ("drop_jump", "drop_jump_2", "squats", "walk", "rajagopal_walk")


@pytest.mark.parametrize(("motion", "side"), BUILT_IN)
def test_the_built_in_subject(tmp_path: Path, motion: str, side: str):
    options = ["--motion", motion, "--set", f"domain.side={side}", "--until", "optimize"]
    assert main(["demo", *options, "--out", str(tmp_path / "run")]) == 0
    _check(tmp_path / "run")


@pytest.mark.parametrize("name", RECORDED)
def test_recordings(shared_data: Path, tmp_path: Path, name: str):
    file = HERE / name / "run.toml"
    assert main(["run", str(file), "--until", "optimize", "--out", str(tmp_path / "run")]) == 0
    _check(tmp_path / "run")


def _check(run: Path) -> None:
    """At equal volume: six times the ratio when straight, four at 60 degrees, frontal stiffness kept."""
    brace = json.loads((run / "metrics.json").read_text())["brace"]
    assert brace["volume_fraction"] == pytest.approx(brace["volume_fraction_uniform"], abs=1e-4)
    postures = brace["postures"]
    for asked, least in ((0.0, 6.0), (60.0, 4.0)):
        posture = min(postures, key=lambda one: abs(one["flexion_deg"] - asked))
        assert abs(posture["flexion_deg"] - asked) < 10.0
        frontal = posture["frontal_nm_per_deg"] / posture["frontal_uniform_nm_per_deg"]
        sagittal = posture["sagittal_nm_per_deg"] / posture["sagittal_uniform_nm_per_deg"]
        assert frontal >= 0.95
        assert frontal / sagittal >= least
    rest, energy = brace["stiffness_sagittal_nm_per_deg"], brace["stiffness_sagittal_by_energy_nm_per_deg"]
    assert energy == pytest.approx(rest, rel=0.10)
