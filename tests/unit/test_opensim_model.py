"""Models built by us against the source model, and users' models with freed knees. OpenSim runs apart."""

from __future__ import annotations

import copy
import functools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.splines import joint_function
from hilbrace.skeleton.table import free_coordinates, load_source_table, load_table
from tests.unit.opensim_oracle import ARMS, ROOT, STORED, ask, random_poses, source_model

POSITION = 2.5e-6  # the source's own frames carry six digits once OpenSim has upgraded its format
LENGTH = 5e-7


@functools.cache
def stored() -> dict[str, np.ndarray]:
    with np.load(STORED) as figures:
        return dict(figures)


def stored_poses() -> dict[str, np.ndarray]:
    return dict(zip(stored()["coordinates"].tolist(), stored()["poses"], strict=True))


def with_screw_home(poses: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same poses for free knees: the source's splines fed as adduction and rotation."""
    poses = dict(poses)
    for joint in load_source_table()["joints"]:
        if joint["name"].startswith("walker_knee"):
            side = joint["name"][-1]
            splines = [joint_function(axis["function"]) for axis in joint.get("transform", [])[1:3]]
            angle = poses[f"knee_angle_{side}"]
            poses[f"knee_adduction_{side}"] = splines[0](angle)
            poses[f"knee_rotation_{side}"] = splines[1](angle) * (-1.0 if side == "l" else 1.0)
    return poses


def largest(told: dict[str, np.ndarray], reference: dict[str, np.ndarray], field: str) -> float:
    return float(np.abs(told[field] - reference[field]).max())


@functools.cache
def coupled() -> dict[str, np.ndarray]:
    return ask(table=load_source_table(), poses=stored_poses(), arms=ARMS)


@functools.cache
def freed() -> dict[str, np.ndarray]:
    return ask(table=load_table(), poses=with_screw_home(stored_poses()), arms=ARMS)


def test_the_built_model_has_every_part():
    told = freed()
    table = load_table()
    assert len(told["coordinates"]) == 43
    assert told["bodies"].tolist() == list(table["bodies"])
    assert told["markers"].tolist() == list(table["markers"])
    assert told["muscles"].tolist() == list(table["muscles"])
    assert sorted(told["wraps"].tolist()) == sorted(table["wraps"])
    locked = [n for n, held in zip(told["coordinates"].tolist(), told["locked"], strict=True) if held]
    assert locked == [i["name"] for j in table["joints"] for i in j["coordinates"] if i["locked"]]
    ranges = [i["range"] for j in table["joints"] for i in j["coordinates"]]
    np.testing.assert_allclose(told["ranges"], ranges, rtol=0, atol=1e-12)
    force = [muscle["max_isometric_force"] for muscle in table["muscles"].values()]
    np.testing.assert_allclose(told["max_force"], force)


def test_with_coupled_knees_it_is_the_source_model():
    """Figures of the source model stored once: bodies, markers, muscles and their moment arms."""
    told, source = coupled(), stored()
    assert [n for n in told["coordinates"].tolist() if "beta" not in n] == source["coordinates"].tolist()
    assert float(told["mass"]) == pytest.approx(float(source["mass"]), abs=1e-9)
    for field in ("position", "marker", "com"):
        assert largest(told, source, field) < POSITION, field
    for field in ("length", "arm"):
        assert largest(told, source, field) < LENGTH, field


def test_free_knees_fed_the_coupling_are_the_source_model():
    """All but the arms about knee flexion, which no longer turn adduction and rotation along."""
    told, source = freed(), stored()
    for field in ("position", "marker", "com"):
        assert largest(told, source, field) < POSITION, field
    assert largest(told, source, "length") < LENGTH
    others = [i for i, name in enumerate(ARMS) if name != "knee_angle"]
    assert np.abs(told["arm"] - source["arm"])[..., others].max() < LENGTH
    knee = np.abs(told["arm"] - source["arm"])[..., ARMS.index("knee_angle")].max()
    assert 1e-3 < knee < 6e-3


def test_free_knees_held_straight_stay_within_the_known_distance():
    """What leaving the coupling out changes: 30 mm at the foot, 9 mm of muscle, nothing above the knee."""
    told, source = ask(table=load_table(), poses=stored_poses()), stored()
    bodies = told["bodies"].tolist()
    below = [b.startswith(("tibia", "talus", "calcn", "toes")) for b in bodies]
    apart = np.abs(told["position"] - source["position"]).max(axis=(0, 2))
    assert apart[~np.array(below)].max() < POSITION
    assert 0.005 < apart[below].max() < 0.032
    assert 0.002 < largest(told, source, "length") < 0.0095


def test_the_source_file_itself_in_other_poses():
    path = source_model()
    if path is None:
        pytest.skip("Rajagopal2015.osim absent: set HILBRACE_RAJAGOPAL_OSIM or install nimblephysics")
    table = load_source_table()
    q = {name: np.array(values) for name, values in random_poses(table, 12, seed=11).items()}
    source = ask(osim=str(path), poses=q, arms=ARMS)
    ours = ask(table=table, poses=q, arms=ARMS)
    freed_file = ask(user_osim=str(path), poses=with_screw_home(q))
    for told in (ours, freed_file):
        assert largest(told, source, "position") < POSITION
        assert largest(told, source, "length") < LENGTH
    assert largest(ours, source, "arm") < LENGTH
    np.testing.assert_allclose(ours["fibres"], source["fibres"], rtol=1e-12)
    np.testing.assert_allclose(ours["wrap_size"], source["wrap_size"], rtol=1e-12)
    built = ask(table=load_table())
    assert freed_file["coordinates"].tolist() == built["coordinates"].tolist()


def test_coordinates_can_be_unlocked():
    wanted = ["subtalar_angle_r", "subtalar_angle_l"]
    told = ask(table=load_table(), unlock=wanted)
    locked = [n for n, held in zip(told["coordinates"].tolist(), told["locked"], strict=True) if held]
    assert len(locked) == 6
    assert not set(wanted) & set(locked)
    refused = ask(table=load_table(), unlock=["subtalar_r"])
    assert refused["where"] == "subtalar_r"


USER_MODELS = {
    "opencap_subject4/models/manually_scaled.osim": 39,
    "opencap_subject5_raw/LaiArnoldModified2017_poly_withArms_weldHand_scaled.osim": 39,
    "rajagopal_walk/subject_walk_scaled.osim": 37,
    "gc5_instrumented_knee/models/Rajagopal2015-scaled.osim": 29,
}


@pytest.mark.parametrize("name", list(USER_MODELS))
def test_users_models_gain_knees_with_our_signs(shared_data, name):
    """On both sides the tibia turns about axes close to our model's, the same way round."""
    step = 0.05
    knees = ("knee_angle", "knee_adduction", "knee_rotation")
    q = {f"{c}_{s}": np.zeros(7) for c in knees for s in "rl"}
    for number, (coordinate, side) in enumerate((c, s) for s in "rl" for c in knees):
        q[f"{coordinate}_{side}"][number + 1] = step
    told = ask(user_osim=str(shared_data / name), poses=q)
    assert len(told["coordinates"]) == USER_MODELS[name]
    skeleton = skeleton_from_table(load_table())
    bodies = told["bodies"].tolist()
    for first, side in ((1, "r"), (4, "l")):
        ours = skeleton.joint_axes(f"tibia_{side}", {"knee_angle_r": 0.0})
        rest, *turned = told["rotation"][[0, first, first + 1, first + 2], bodies.index(f"tibia_{side}")]
        for coordinate, rotation in zip(knees, turned, strict=True):
            turn = rest.T @ rotation
            axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            axis /= 2 * np.sin(step)
            assert axis @ ours[f"{coordinate}_{side}"][0] > 0.95, (coordinate, side)


@pytest.fixture
def written(tmp_path):
    """Write a table's model as a file that a user could bring."""

    def write(table: object) -> Path:
        path = tmp_path / "user.osim"
        program = (
            "import json, sys\nfrom hilbrace.biomech.opensim_model import build_model\n"
            "build_model(json.load(sys.stdin)).printToXML(sys.argv[1])"
        )
        subprocess.run(
            [sys.executable, "-c", program, str(path)],
            input=json.dumps(table),
            text=True,
            check=True,
            cwd=ROOT,
            timeout=120,
        )
        return path

    return write


def test_knees_that_are_free_already_are_left_alone(written):
    table = load_table()
    q = random_poses(table, 3, seed=9)
    from_file, built = ask(user_osim=str(written(table)), poses=q), ask(table=table, poses=q)
    assert from_file["coordinates"].tolist() == built["coordinates"].tolist()
    assert largest(from_file, built, "position") < 1e-6


def test_models_without_such_knees_are_refused_by_name(written, tmp_path):
    backwards = load_source_table()
    for joint in backwards["joints"]:
        if joint["name"] == "walker_knee_l":
            joint["transform"][0]["function"] = {"linear": [-1.0, 0.0]}
    told = ask(user_osim=str(written(backwards)))
    assert "does not flex" in str(told["error"])
    assert str(told["where"]) == "walker_knee_l"

    renamed = copy.deepcopy(load_source_table())
    for joint in renamed["joints"]:
        if joint["name"] == "walker_knee_r":
            joint["coordinates"][0]["name"] = "knee_flexion_r"
            for axis in joint["transform"]:
                axis["of"] = axis["of"] and "knee_flexion_r"
    for coupler in renamed["couplers"]:
        coupler["independent"] = coupler["independent"].replace("knee_angle_r", "knee_flexion_r")
    told = ask(user_osim=str(written(renamed)))
    assert "no coordinate 'knee_angle_r'" in str(told["error"])

    broken = tmp_path / "broken.osim"
    broken.write_text("<OpenSimDocument")
    assert "cannot read" in str(ask(user_osim=str(broken))["error"])
    assert "no such model" in str(ask(user_osim=str(tmp_path / "absent.osim"))["error"])


@pytest.mark.parametrize(
    ("scales", "mass", "where"),
    [({"shin": [1, 1, 1]}, 60, "shin"), ({}, 0, "scale_model")],
)
def test_senseless_scales_are_refused(scales, mass, where):
    assert str(ask(table=load_table(), scales=scales, mass=mass)["where"]) == where


def test_the_built_model_has_41_free_coordinates():
    names = freed()["coordinates"].tolist()
    assert [n for n in names if not n.endswith("_beta")] == list(free_coordinates(load_table()))
