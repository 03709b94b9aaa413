"""The recorded drop jump becomes a brace: angles against the published ones, and the solid's promises.

The gallery's configuration at a smaller size; the figures of the full size stand in the README.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.cli import main
from hilbrace.motion.opensim_files import read_storage
from hilbrace.run.records import load
from hilbrace.units import GRAVITY

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

HERE = Path(__file__).parent
SMALLER = (
    *("--set", "domain.triangles=1500"),
    *("--set", "domain.frames_per_second=10"),
    *("--set", "optimize.iterations=30"),
)


@pytest.fixture(scope="module")
def run(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gallery") / "drop_jump"
    code = main(["run", str(HERE / "drop_jump" / "run.toml"), "--out", str(folder), *SMALLER])
    assert code == 0
    return folder


@pytest.fixture(scope="module")
def metrics(run: Path) -> dict:
    return json.loads((run / "metrics.json").read_text())


@pytest.mark.parametrize("side", ["r", "l"])
def test_knee_flexion_is_that_of_the_reference(run: Path, shared_data: Path, side: str):
    """Within 1.5 degrees RMS of the published inverse kinematics of another, manually scaled model."""
    loads = load(JointLoads, run / "biomech" / "biomech.npz")
    published = shared_data / "opencap_subject4" / "ik_manual_scaling" / "DJ1_manual_scaling_ik.mot"
    reference = read_storage(published)
    assert reference.degrees
    expected = np.interp(loads.time, reference.time, reference.columns[f"knee_angle_{side}"])
    own = np.rad2deg(loads.angles[:, loads.joints.index(f"knee_{side}"), 0])
    assert np.sqrt(((own - expected) ** 2).mean()) < 1.5


def test_the_model_is_the_whole_one(metrics: dict):
    assert metrics["biomech"]["coordinates"] == 41
    assert metrics["biomech"]["muscles"] == 80


def test_loads_are_those_of_a_landing(run: Path, metrics: dict):
    assert 0.8 < metrics["biomech"]["acting_force_peak_bw"] < 4.0
    assert 5.0 < metrics["biomech"]["marker_rms_mm"] < 30.0
    loads = load(JointLoads, run / "biomech" / "biomech.npz")
    before = loads.time < 1.30  # first contact is at 1.42 s; the filter reaches back some hundredths
    swinging = np.linalg.norm(loads.acting_force[before], axis=-1) / (loads.body_mass_kg * GRAVITY)
    assert swinging[:, :2].max() < 0.25


def test_the_design_beats_the_uniform_brace(metrics: dict):
    brace = metrics["brace"]
    assert brace["stiffness_frontal_nm_per_deg"] > 0.95 * brace["stiffness_frontal_uniform_nm_per_deg"]
    assert brace["stiffness_ratio_vs_uniform"] > 2.5  # after 30 of 100 iterations
    assert brace["volume_fraction"] == pytest.approx(brace["volume_fraction_uniform"], abs=1e-4)
    assert (
        metrics["optimize"]["normalised_final"]["total"] < metrics["optimize"]["normalised_initial"]["total"]
    )


def test_the_solid_can_be_cast(run: Path, metrics: dict):
    solid = metrics["solid"]
    assert solid["watertight"]
    assert solid["parts"] == 1
    assert solid["manifold_status"] == "NoError"
    assert solid["min_strut_mm"] >= 1.5
    assert abs(solid["volume_error"]) < 0.03
    to_ml = {"brace.stl": 1e-3, "brace.ply": 1e-3, "brace.glb": 1e6}  # mm; glTF is in metres by definition
    for name, factor in to_ml.items():
        mesh = trimesh.load_mesh(run / "solid" / name)
        assert mesh.is_watertight, name
        assert mesh.volume * factor == pytest.approx(solid["volume_ml"], rel=1e-3), name


def test_the_report_is_one_page_that_needs_nothing_else(run: Path):
    page = (run / "report" / "index.html").read_text()
    assert "Research software, not a medical device" in page
    assert "recorded motion" in page
    outside = [part for part in page.split('"') if part.startswith(("http://", "https://"))]
    assert not [link for link in outside if link.endswith((".js", ".css", ".png"))]


def test_tables_open_anywhere(run: Path):
    header = (run / "biomech" / "joint_loads.csv").read_text().splitlines()[0].split(",")
    assert header[0] == "time_s"
    for name in ("knee_left_flexion_deg", "knee_left_adduction_deg", "knee_left_acting_force_x_n"):
        assert any(column.startswith(name) for column in header), name
