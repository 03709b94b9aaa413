"""The paper's designs on the built-in subject, each from its own run.toml.

Small and short here; at full size in the long test, which holds them to their promises.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hilbrace.cli import main
from hilbrace.config import read_config

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

HERE = Path(__file__).parent
WINDOWS = {"serve": "[1.2, 2.4]", "gait": "[0.4, 1.4]"}
DESIGNS = {
    "serve_left_knee": ("knee_l", "serve", 15.0),
    "serve_right_knee": ("knee_r", "serve", 15.0),
    "gait_left_knee": ("knee_l", "gait", 60.0),
    "gait_right_knee": ("knee_r", "gait", 60.0),
    "serve_left_ankle": ("ankle_l", "serve", 15.0),
}
"""Braced joint, motion, and frames a second that the design sees."""


def short(name: str) -> list[str]:
    """Settings that make a design of seconds."""
    return [
        *("--set", f"motion.window={WINDOWS[DESIGNS[name][1]]}"),
        *("--set", "domain.triangles=900"),
        *("--set", "optimize.iterations=10"),
    ]


@pytest.mark.parametrize("name", DESIGNS)
def test_every_file_names_its_joint_and_motion(name: str):
    joint, motion, rate = DESIGNS[name]
    config = read_config(HERE / name / "run.toml")
    assert f"{config.domain.joint}_{config.domain.side[0]}" == joint
    assert config.motion.synthetic == motion
    assert config.domain.frames_per_second == rate


@pytest.mark.parametrize("name", ["serve_left_knee", "gait_right_knee"])
def test_a_serve_and_a_gait_design_are_made_of_their_files(tmp_path: Path, name: str):
    joint, motion, rate = DESIGNS[name]
    file = HERE / name / "run.toml"
    assert main(["run", str(file), "--out", str(tmp_path), "--until", "optimize", *short(name)]) == 0
    found = json.loads((tmp_path / "metrics.json").read_text())
    assert found["domain"]["joint"] == joint
    assert found["motion"]["name"] == f"synthetic {motion}"
    assert found["domain"]["frames"] == pytest.approx(rate * (1.2 if motion == "serve" else 1.0), abs=3)
    assert found["domain"]["flipped_triangles"] == 0
    steps = found["optimize"]
    assert steps["normalised_final"]["total"] < steps["normalised_initial"]["total"]
    assert found["brace"]["stiffness_ratio_vs_uniform"] > 1.2


@pytest.mark.soak
@pytest.mark.parametrize("name", DESIGNS)
def test_every_design_at_full_size_keeps_its_promises(tmp_path: Path, name: str):
    folder = tmp_path / name
    assert main(["run", str(HERE / name / "run.toml"), "--out", str(folder)]) == 0
    found = json.loads((folder / "metrics.json").read_text())
    assert found["solid"]["watertight"]
    assert found["solid"]["parts"] == 1
    assert found["solid"]["min_strut_mm"] >= 1.5
    assert (folder / "report" / "index.html").stat().st_size > 1e6
    straight, bent = (_against_uniform(found["brace"], flexion) for flexion in (0.0, 60.0))
    if "knee" in name:
        assert straight[1] >= 6.0
        assert bent[1] >= 4.0
        assert bent[0] >= 0.95
    assert straight[0] >= 0.95
    assert straight[1] >= 1.5


def _against_uniform(brace: dict, flexion_deg: float) -> tuple[float, float]:
    """Frontal stiffness, and frontal over sagittal, in the nearest posture, over the uniform brace's."""
    posture = min(brace["postures"], key=lambda one: abs(one["flexion_deg"] - flexion_deg))
    frontal = posture["frontal_nm_per_deg"] / posture["frontal_uniform_nm_per_deg"]
    return frontal, frontal * posture["sagittal_uniform_nm_per_deg"] / posture["sagittal_nm_per_deg"]
