"""The paper's designs on the built-in subject, each from its own run.toml.

Small and short here; at full size in the long test, which holds them to their promises.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hilbrace.cli import main
from hilbrace.config import read_config
from hilbrace.run.reuse import reuse_stages

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


@pytest.fixture(scope="module")
def metrics(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict]:
    root = tmp_path_factory.mktemp("designs")
    made: dict[str, dict] = {}
    for name, (_, motion, _) in DESIGNS.items():
        folder = root / name
        for other in made:
            if DESIGNS[other][1] == motion:
                reuse_stages(root / other, folder, ("motion", "body", "biomech"))
                break
        file = HERE / name / "run.toml"
        assert main(["run", str(file), "--out", str(folder), "--until", "optimize", *short(name)]) == 0
        made[name] = json.loads((folder / "metrics.json").read_text())
    return made


@pytest.mark.parametrize("name", DESIGNS)
def test_every_design_is_made_of_its_own_file(metrics: dict, name: str):
    joint, motion, rate = DESIGNS[name]
    found = metrics[name]
    assert found["domain"]["joint"] == joint
    assert found["motion"]["name"] == f"synthetic {motion}"
    assert read_config(HERE / name / "run.toml").domain.frames_per_second == rate
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
    brace = found["brace"]
    assert brace["stiffness_ratio_vs_uniform"] > (4.0 if "knee" in name else 1.5)
    own, plain = brace["stiffness_frontal_nm_per_deg"], brace["stiffness_frontal_uniform_nm_per_deg"]
    assert own >= 0.95 * plain
