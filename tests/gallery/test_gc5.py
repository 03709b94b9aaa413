"""Contact forces against a knee that was measured from inside: two walks of the fifth Grand Challenge.

The subject's left knee implant measured the force on its tibial tray (Fregly et al. 2012, J. Orthop. Res.
30(4):503). The run files name raw recordings and a standing trial; which foot stood on which plate is found
from the data, and nothing is fitted to the measured force. The published model of the same walks (Modenese,
Barzan & Carty 2021) reaches r 0.92 and 0.87, RMSE 0.31 and 0.49 body weights; that is the floor. The goal is
r >= 0.90 and RMSE <= 0.40 on both.

What each step of the mechanics brought (r and RMSE in body weights over the whole recording, ss1 | ss3):

==================================================================  ============  ============
squared activations, foot by its heel marker (as first written)     0.93  0.53    0.87  0.66
standing feet level, subtalar joint balanced                        0.91  0.55    0.86  0.67
muscles never below their least activation of 0.01                  0.90  0.69    0.86  0.77
surfaces of knee and ankle in the criterion                         0.93  0.29    0.90  0.37
kneecap a lever, not a pulley (as delivered)                        0.93  0.29    0.91  0.34
==================================================================  ============  ============

The criterion brings most. Levelled feet and least activation alone move the force away from the measured one:
they mend the angle of the ankle (10 degrees beside the published kinematics) and what rests in swing, and are
right by themselves. Tried and left out, since worse: passive fibre forces of the generic model (RMSE above 1:
its fibres are too stiff at these lengths), compliant tendons (0.9 to 1.1), activations weighted by volume or
force (0.6 and more). The measured force trails ours by some 25 to 40 ms in both walks, and the ground
reaction likewise; no clock was moved.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.cli import main
from hilbrace.run.records import load
from hilbrace.units import GRAVITY

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

HERE = Path(__file__).parent
WEIGHT = 75.0 * GRAVITY
WALKS = ("ss1", "ss3")
PUBLISHED = {"ss1": (0.92, 0.31), "ss3": (0.87, 0.49)}
GOAL_R, GOAL_RMSE = 0.90, 0.40
PLAIN = ("--set", "biomech.muscle_criterion=activation", "--set", "biomech.kneecap=pulley")


def run_walk(walk: str, folder: Path, *options: str) -> Path:
    code = main(["run", str(HERE / f"gc5_{walk}.toml"), "--out", str(folder), "--until", "biomech", *options])
    assert code == 0
    return folder


@pytest.fixture(scope="module")
def folders(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("gc5")
    return {walk: run_walk(walk, root / walk) for walk in WALKS}


def in_vivo(shared_data: Path, walk: str) -> np.ndarray:
    """Per cent of the recording, medial, lateral and total force [N]."""
    path = shared_data / "gc5_instrumented_knee" / f"etibia_{walk}.csv"
    return np.loadtxt(path, delimiter=",", skiprows=1)


def column(folder: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    with (folder / "biomech" / "joint_loads.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    time = np.array([float(row["time_s"]) for row in rows])
    return time, np.array([float(row[name]) for row in rows])


def agreement(folder: Path, measured: np.ndarray, name: str, measure: int) -> tuple[float, float]:
    """Correlation, and RMS difference in body weights, over the whole recording."""
    time, force = column(folder, name)
    percent = 100.0 * (time - time[0]) / (time[-1] - time[0])
    ours, theirs = np.interp(measured[:, 0], percent, force), measured[:, measure]
    rmse = float(np.sqrt(((ours - theirs) ** 2).mean())) / WEIGHT
    return float(np.corrcoef(ours, theirs)[0, 1]), rmse


@pytest.mark.parametrize("walk", WALKS)
def test_total_force_reaches_the_floor_and_the_goal(folders, shared_data, walk):
    r, rmse = agreement(folders[walk], in_vivo(shared_data, walk), "knee_left_contact_force_n", 3)
    assert r >= max(PUBLISHED[walk][0], GOAL_R)
    assert rmse <= min(PUBLISHED[walk][1], GOAL_RMSE)


@pytest.mark.parametrize("walk", WALKS)
def test_the_medial_compartment_carries_what_it_was_measured_to(folders, shared_data, walk):
    measured = in_vivo(shared_data, walk)
    r, rmse = agreement(folders[walk], measured, "knee_left_contact_medial_n", 1)
    assert r >= 0.85
    assert rmse <= 0.35
    _, lateral = agreement(folders[walk], measured, "knee_left_contact_lateral_n", 2)
    assert lateral <= 0.35


@pytest.mark.parametrize("walk", WALKS)
def test_left_stance_is_the_left_foot_on_one_plate(folders, walk):
    """The plates are found: during left stance the left foot carries weight, and the loads are balanced."""
    loads = load(JointLoads, folders[walk] / "biomech" / "biomech.npz")
    stance = (loads.time > loads.time[0] + 0.15) & (loads.time < loads.time[0] + 0.5)
    left = loads.joints.index("ankle_l")
    assert (np.linalg.norm(loads.acting_force[stance, left], axis=1) > 0.7 * WEIGHT).all()
    assert np.sqrt((loads.pelvis_residual_force[stance] ** 2).sum(axis=1).mean()) < 0.2 * WEIGHT


@pytest.mark.parametrize("walk", WALKS)
def test_muscles_supply_the_moments(folders, walk):
    figures = json.loads((folders[walk] / "metrics.json").read_text())["biomech"]
    assert figures["muscle_activation_max"] <= 1.0
    assert figures["muscle_reserve_rms_nm"] < 0.5
    assert 1.5 < figures["contact_force_peak_bw"] < 3.5


def test_the_mechanics_and_not_the_data_bring_it(folders, shared_data, tmp_path):
    """Without surfaces in the criterion and with the kneecap as a pulley, both walks miss the floor."""
    for walk in WALKS:
        measured = in_vivo(shared_data, walk)
        plain = run_walk(walk, tmp_path / walk, *PLAIN)
        _, before = agreement(plain, measured, "knee_left_contact_force_n", 3)
        _, after = agreement(folders[walk], measured, "knee_left_contact_force_n", 3)
        assert before > PUBLISHED[walk][1]
        assert after < 0.6 * before
