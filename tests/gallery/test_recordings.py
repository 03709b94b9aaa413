"""Recordings of three people become joint loads without a setup made by hand, and a verdict on them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.cli import main
from hilbrace.motion.opensim_files import coordinates_rad, read_storage
from hilbrace.run.records import load

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

HERE = Path(__file__).parent
OPENCAP = "opencap_subject4/ik_manual_scaling"
RUNS = {
    "drop_jump_2": (f"{OPENCAP}/DJ2_manual_scaling_ik.mot", 1.6),
    "drop_jump_asymmetric": (f"{OPENCAP}/DJAsym1_manual_scaling_ik.mot", 1.6),
    "squats": (f"{OPENCAP}/squats1_manual_scaling_ik.mot", 1.6),
    "walk": (f"{OPENCAP}/walking1_manual_scaling_ik.mot", 1.6),
    "drop_jump_no_static": ("opencap_subject5_raw/DJ1.mot", 4.0),
    "rajagopal_walk": (None, 0.0),
}
"""Published angles of the knees, and how far ours may be off [deg RMS]."""


@pytest.fixture(scope="module", params=RUNS)
def run(request, shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp("gallery") / request.param
    settings = HERE / request.param / "run.toml"
    assert main(["run", str(settings), "--out", str(folder), "--until", "biomech"]) == 0
    return request.param, folder


def test_a_recording_becomes_joint_loads_with_a_verdict(run, shared_data: Path):
    name, folder = run
    figures = json.loads((folder / "metrics.json").read_text())["biomech"]
    loads = load(JointLoads, folder / "biomech" / "biomech.npz")
    notes = " ".join(figures["notes"])
    assert figures["marker_legs_rms_mm"] < 20.0
    assert figures["residual_frames"] > 50
    assert figures["residual_force_rms_n"] < 0.35 * loads.body_mass_kg * 9.81
    assert figures["residual_force_limit_n"] > 0.0
    for words in (
        "markers of pelvis and legs",
        "OpenSim's checklist",
        "residual moment",
        "Hicks et al. 2015",
    ):
        assert words in notes, words
    assert ("no standing trial" in notes) == (name in ("drop_jump_no_static", "rajagopal_walk"))
    rows = (folder / "biomech" / "marker_errors.csv").read_text().splitlines()
    assert len(rows) == len(loads.time) + 3
    told = " ".join(json.loads((folder / "metrics.json").read_text())["motion"]["notes"])
    assert "right foot" in told
    assert "left foot" in told


def test_knee_flexion_is_near_the_published(run, shared_data: Path):
    name, folder = run
    path, limit = RUNS[name]
    if path is None:
        pytest.skip("the published angles were changed by residual reduction")
    loads = load(JointLoads, folder / "biomech" / "biomech.npz")
    reference = read_storage(shared_data / path)
    columns = coordinates_rad(reference)
    covered = (loads.time >= reference.time[0]) & (loads.time <= reference.time[-1])
    assert covered.sum() > 50
    for side in "rl":
        theirs = np.interp(loads.time, reference.time, columns[f"knee_angle_{side}"])
        ours = loads.angles[:, loads.joints.index(f"knee_{side}"), 0]
        error = np.degrees(ours - theirs)[covered]
        assert np.sqrt((error**2).mean()) < limit, side
