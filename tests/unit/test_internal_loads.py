"""Muscles and contact of a whole motion: balances that must hold, and models that lack what is needed."""

from __future__ import annotations

import csv
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hilbrace.biomech.analysis import compute_joint_loads
from hilbrace.biomech.contact import COMPARTMENTS_M
from hilbrace.biomech.engine import Engine
from hilbrace.biomech.internal_loads import ARM_STEP, with_muscles
from hilbrace.biomech.joint_loads import JOINTS, JointLoads, without_muscles
from hilbrace.biomech.loads_csv import write_joint_loads_csv
from hilbrace.biomech.muscle_tables import write_muscle_tables
from hilbrace.biomech.subject_model import subject_model
from hilbrace.body.build import build_body
from hilbrace.config import BiomechSettings, BodySettings, MotionSettings
from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import read_marker_map
from hilbrace.motion.opensim_files import read_storage
from hilbrace.motion.synthetic.generate import generate
from hilbrace.motion.trial import Trial
from hilbrace.skeleton.table import load_table
from hilbrace.units import GRAVITY

ROOT = Path(__file__).resolve().parents[2]
INNER = slice(8, -8)


@pytest.fixture(scope="module")
def trial() -> Trial:
    """Half a second of the synthetic squat, on its way down."""
    truth, part = generate("squat", rate_hz=50.0), slice(50, 90)
    return Trial(
        name="squat",
        origin="synthetic",
        time=truth.time[part],
        rate_hz=truth.rate_hz,
        marker_names=truth.marker_names,
        markers=truth.markers[part],
        static_marker_names=truth.marker_names,
        static_markers=truth.static_markers,
        feet=("right", "left"),
        ground_force=truth.forces.force[part],
        centre_of_pressure=truth.forces.centre_of_pressure[part],
        free_torque=truth.forces.free_moment[part, :, None] * np.array([0.0, 1.0, 0.0]),
        mass_kg=truth.mass_kg,
        height_m=truth.height_m,
        marker_map="hilbrace",
        notes=(),
    )


@pytest.fixture(scope="module")
def body(trial):
    return build_body(trial, BodySettings())


def analyse(trial, body, **settings) -> JointLoads:
    return compute_joint_loads(
        trial, body, read_marker_map("hilbrace"), MotionSettings(), BiomechSettings(**settings)
    )


@pytest.fixture(scope="module")
def loads(trial, body) -> JointLoads:
    return analyse(trial, body)


def pull_of(loads: JointLoads) -> np.ndarray:
    return np.einsum("fjmi,fm->fji", loads.muscle_pull, loads.muscle_force)


def flexion_moment(loads: JointLoads, joint: int) -> np.ndarray:
    """Moment of the contact about a knee's flexion axis, by virtual work [N*m]."""
    jacobian = loads.distal_jacobian[:, joint, :, 0]
    return (jacobian[:, :3] * loads.contact_force[:, joint]).sum(axis=1) + (
        jacobian[:, 3:] * loads.contact_moment[:, joint]
    ).sum(axis=1)


def test_contact_and_muscles_add_up_to_the_net_force(loads):
    assert loads.convention == "intersegmental"
    assert np.allclose(loads.contact_force + pull_of(loads), loads.acting_force, atol=1e-9)


def test_muscles_supply_the_moments_within_their_bounds(loads):
    assert loads.muscle_activation.min() >= 0.01
    assert loads.muscle_activation.max() <= 1.0
    for name in ("hip_flexion_r", "knee_angle_r", "knee_angle_l", "ankle_angle_l"):
        k = loads.coordinate_names.index(name)
        assert np.abs(loads.reserve[INNER, k]).max() < 1.0, name
        assert np.abs(loads.joint_moment[INNER, k]).max() > 5.0, name


def test_the_knee_lets_flexion_pass(loads, trial, body):
    """Bones that touch cannot resist flexion: the contact has no moment about its axis but the reserve's."""
    pulley = analyse(trial, body, kneecap="pulley")
    for joint in (JOINTS.index("knee_r"), JOINTS.index("knee_l")):
        assert np.abs(flexion_moment(loads, joint)[INNER]).max() < 1.5
        assert np.abs(flexion_moment(pulley, joint)[INNER]).max() > 5.0


def test_contact_is_compression_of_physiological_size(loads):
    weight = loads.body_mass_kg * GRAVITY
    size = np.linalg.norm(loads.contact_force, axis=2)[INNER] / weight
    assert (loads.contact_force[INNER, :, 1] < 0.0).all()
    assert (size.max(axis=0) < 7.0).all()
    assert (size.max(axis=0) > 0.5).all()
    knees = [JOINTS.index("knee_r"), JOINTS.index("knee_l")]
    halves = loads.contact_medial[:, knees] + loads.contact_lateral[:, knees]
    assert np.allclose(halves, -loads.contact_force[:, knees, 1])
    for knee, to_the_right in (("knee_r", 1.0), ("knee_l", -1.0)):
        k = JOINTS.index(knee)
        tilt = to_the_right * COMPARTMENTS_M * (loads.contact_lateral[:, k] - loads.contact_medial[:, k])
        np.testing.assert_allclose(tilt / 2.0, loads.contact_moment[:, k, 0], rtol=1e-9, atol=1e-9)
    assert np.isnan(loads.contact_medial[:, JOINTS.index("ankle_r")]).all()


def test_a_dozen_muscles_cross_each_knee_and_none_of_the_other_side(loads):
    for k, joint in enumerate(JOINTS):
        crossing = np.abs(loads.muscle_pull[:, k]).max(axis=(0, 2)) > 0.0
        names = [name for name, found in zip(loads.muscle_names, crossing, strict=True) if found]
        assert all(name.endswith(joint[-2:]) for name in names)
        assert len(names) == (13 if joint.startswith("knee") else 11), joint
        still = np.abs(loads.muscle_arms[:, k]).max(axis=(0, 1))
        assert (still[~crossing] < 1e-9).all()
    assert np.allclose(loads.geometric_stiffness, np.swapaxes(loads.geometric_stiffness, 2, 3))
    assert np.abs(loads.geometric_stiffness).max() > 1.0


LENGTHS = """
import json, sys
import opensim as osim
osim.Logger.setLevelString("Off")
order = json.load(sys.stdin)
model = osim.Model(order["model"])
coordinates, muscles = model.getCoordinateSet(), model.getMuscles()
for k in range(coordinates.getSize()):
    coordinates.get(k).setDefaultClamped(False)
    coordinates.get(k).setDefaultLocked(False)
state = model.initSystem()
def lengths(values):
    for name, value in values.items():
        coordinates.get(name).setValue(state, value, False)
    for side in "rl":
        coordinates.get(f"knee_angle_{side}_beta").setValue(state, values[f"knee_angle_{side}"], False)
    model.realizePosition(state)
    return [muscles.get(k).getLength(state) for k in range(muscles.getSize())]
json.dump([lengths(values) for values in order["poses"]], sys.stdout)
"""


def test_geometric_stiffness_is_the_curvature_of_the_muscles_lengths(loads, trial, body, tmp_path):
    """OpenSim's lengths L at posed angles: the stiffness is sum F d2L/dq2, probed over the same step."""
    with Engine() as engine:
        subject_model(engine, trial, body, read_marker_map("hilbrace"), BiomechSettings())
        engine.call("write_model", path=str(tmp_path / "subject.osim"))
    frame, small = 0, 1e-4
    pose = dict(zip(loads.coordinate_names, loads.coordinates[frame].tolist(), strict=True))
    names = [f"{name}_l" for name in ("knee_angle", "knee_adduction", "knee_rotation", "ankle_angle")]
    offsets = [far + near for far in (ARM_STEP, -ARM_STEP) for near in (small, -small)]
    poses = [pose | {name: pose[name] + offset} for name in names for offset in offsets]
    found = subprocess.run(
        [sys.executable, "-c", LENGTHS],
        input=json.dumps({"model": str(tmp_path / "subject.osim"), "poses": poses}),
        text=True,
        check=True,
        capture_output=True,
        cwd=tmp_path,
        timeout=120,
    )
    lengths = np.array(json.loads(found.stdout)).reshape(len(names), 2, 2, -1)
    slopes = (lengths[:, :, 0] - lengths[:, :, 1]) / (2.0 * small)
    expected = (slopes[:, 0] - slopes[:, 1]) / (2.0 * ARM_STEP) @ loads.muscle_force[frame]
    knee, ankle = (loads.joints.index(joint) for joint in ("knee_l", "ankle_l"))
    ours = [*np.diag(loads.geometric_stiffness[frame, knee]), loads.geometric_stiffness[frame, ankle, 0, 0]]
    assert np.abs(expected).max() > 1.0
    assert ours == pytest.approx(expected.tolist(), rel=1e-3, abs=1e-3)


def test_the_literal_convention_counts_the_pull_on_the_distal_bone(loads, trial, body):
    literal = analyse(trial, body, convention="paper_literal")
    assert np.allclose(literal.acting_force, loads.contact_force - pull_of(loads), atol=1e-6)
    assert np.allclose(literal.contact_force, loads.contact_force, atol=1e-9)


def test_the_criterion_of_opensim_presses_more(loads, trial, body):
    plain = analyse(trial, body, muscle_criterion="activation")
    size = [np.linalg.norm(each.contact_force[INNER, :2], axis=2).mean() for each in (loads, plain)]
    assert size[0] < size[1]


def test_tables_hold_contact_and_muscles(loads, tmp_path):
    path = tmp_path / "joint_loads.csv"
    write_joint_loads_csv(loads, path)
    row = list(csv.DictReader(path.read_text().splitlines()))[9]
    left = JOINTS.index("knee_l")
    size = np.linalg.norm(loads.contact_force[9, left])
    assert float(row["knee_left_contact_force_n"]) == pytest.approx(size, rel=1e-4)
    weight = loads.body_mass_kg * GRAVITY
    assert float(row["knee_left_contact_force_bw"]) == pytest.approx(size / weight, rel=1e-4)
    assert float(row["knee_left_contact_medial_n"]) == pytest.approx(loads.contact_medial[9, left], rel=1e-4)
    assert "ankle_right_contact_force_bw" in row
    forces, activations = write_muscle_tables(loads, tmp_path)
    table = read_storage(forces)
    k = loads.muscle_names.index("soleus_l")
    assert np.allclose(table.columns["soleus_l"], loads.muscle_force[:, k], atol=1e-4)
    assert "knee_angle_l_reserve" in table.columns
    assert read_storage(activations).columns["soleus_l"].max() <= 1.0


@pytest.fixture(scope="module")
def bare_model(trial, body, tmp_path_factory) -> Path:
    """The built-in model without a muscle, of the subject's mass, as a user's file."""
    path = tmp_path_factory.mktemp("bare") / "bare.osim"
    table = load_table() | {"muscles": {}}
    program = (
        "import json, sys\n"
        "from hilbrace.biomech.opensim_model import build_model, scale_model\n"
        "model = scale_model(build_model(json.load(sys.stdin)), {}, float(sys.argv[2]))\n"
        "model.printToXML(sys.argv[1])"
    )
    subprocess.run(
        [sys.executable, "-c", program, str(path), str(trial.mass_kg)],
        input=json.dumps(table),
        text=True,
        check=True,
        cwd=ROOT,
        timeout=120,
    )
    return path


def test_a_model_without_muscles_still_gives_net_loads(trial, body, bare_model, loads, tmp_path):
    found = analyse(trial, body, model=bare_model)
    assert any("has no muscles" in note for note in found.notes)
    assert found.muscle_names == ()
    assert np.isnan(found.contact_force).all()
    apart = np.linalg.norm(found.acting_force - loads.acting_force, axis=2)[INNER]
    assert apart.max() < 0.1 * found.body_mass_kg * GRAVITY
    assert np.isfinite(found.joint_moment).all()
    write_joint_loads_csv(found, tmp_path / "joint_loads.csv")
    row = next(csv.DictReader((tmp_path / "joint_loads.csv").read_text().splitlines()))
    assert row["knee_left_contact_force_n"] == ""
    assert row["knee_left_acting_force_x_n"] != ""
    assert write_muscle_tables(found, tmp_path) == ()


def test_the_literal_convention_needs_muscles(trial, body, bare_model):
    with pytest.raises(InputError, match="no muscle of the model crosses knee_r"):
        analyse(trial, body, model=bare_model, convention="paper_literal")


class CannedEngine(Engine):
    """Answers of an engine for a model with one muscle, at the right knee; remembers what arms it gave."""

    probed: tuple[tuple[str, ...], ...] = ()

    def call(self, task, *, progress=None, **arguments):
        frames = len(arguments.get("coordinates", ()))
        if task == "muscle_figures":
            ones = np.ones(1)
            return {
                "names": ("vasti_r",),
                "max_force": 5000.0 * ones,
                "optimal_length": 0.1 * ones,
                "slack_length": 0.2 * ones,
                "least_activation": 0.01 * ones,
            }
        if task == "inverse_dynamics":
            return np.zeros_like(arguments["coordinates"])
        if task == "moment_arms":
            self.probed = (*self.probed, tuple(arguments["rows"]))
            return np.zeros((frames, len(arguments["rows"]), 1))
        arms = np.zeros((frames, len(arguments["rows"]), 1))
        arms[:, arguments["rows"].index("knee_angle_r")] = -0.04
        pulls = np.zeros((frames, 4, 1, 6))
        pulls[:, 0, 0, 1] = 1.0
        return {"capacity": np.full((frames, 1), 5000.0), "arms": arms, "pulls": pulls}


def test_joints_without_muscles_and_locked_coordinates_are_named(loads):
    names = ("knee_angle_r", "knee_angle_l", "subtalar_angle_r", "subtalar_angle_l")
    values = np.zeros((len(loads.time), 4))
    values[:, :2] = np.linspace(0.0, 0.5, len(loads.time))[:, None]
    bare = dataclasses.replace(
        loads,
        coordinate_names=names,
        coordinates=values,
        notes=(),
        **without_muscles(len(values), len(JOINTS), len(names)),
    )
    engine = CannedEngine()
    found = with_muscles(
        engine,
        bare,
        50.0,
        parts=[("tibia_r",), ("tibia_l",), ("talus_r",), ("talus_l",)],
        angles=[("knee_angle_r",), ("knee_angle_l",), ("subtalar_angle_r",), ("subtalar_angle_l",)],
        centres=np.zeros((len(loads.time), 4, 3)),
        reactions={},
        settings=BiomechSettings(kneecap="pulley"),
    )
    assert np.isfinite(found.contact_force[:, 0]).all()
    assert np.isnan(found.contact_force[:, 1:]).all()
    text = " ".join(found.notes)
    assert "no muscle of the model crosses knee_l, ankle_r, ankle_l" in text
    assert "subtalar_angle_r, subtalar_angle_l: locked" in text
    assert engine.probed == (("knee_angle_r", "knee_angle_l"),) * 2
