"""The table against the publication's figures, the file it came from, and its own symmetry."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from importlib import resources

import numpy as np
import pytest

from hilbrace.errors import InputError
from hilbrace.skeleton.table import (
    KNEE_EXTRA,
    coordinate_ranges,
    free_coordinates,
    load_source_table,
    load_table,
)
from hilbrace.skeleton.transcribe import one_record_a_line, transcribe
from tests.unit.opensim_oracle import ROOT, source_model

MINIMAL = """<OpenSimDocument Version="30000"><Model name="m">
<credits>c</credits><publications>p</publications><gravity>0 -9.8 0</gravity>
<BodySet><objects>
<Body name="ground"><Joint/><WrapObjectSet><objects/></WrapObjectSet></Body>
<Body name="shank"><mass>3</mass><mass_center>0 -0.2 0</mass_center>
<inertia_xx>1</inertia_xx><inertia_yy>2</inertia_yy><inertia_zz>3</inertia_zz>
<inertia_xy>0</inertia_xy><inertia_xz>0</inertia_xz><inertia_yz>0</inertia_yz>
<Joint><CustomJoint name="knee"><parent_body>ground</parent_body><reverse>false</reverse>
<location_in_parent>0 1 0</location_in_parent><orientation_in_parent>0 0 0</orientation_in_parent>
<location>0 0 0</location><orientation>0 0 0</orientation>
<CoordinateSet><objects><Coordinate name="flexion"><default_value>0</default_value><range>-1 2</range>
<clamped>true</clamped><locked>false</locked><prescribed>false</prescribed></Coordinate></objects></CoordinateSet>
<SpatialTransform><TransformAxis name="rotation1"><coordinates>flexion</coordinates><axis>0 0 1</axis>
<function>{function}</function></TransformAxis></SpatialTransform>
</CustomJoint></Joint><WrapObjectSet><objects/></WrapObjectSet></Body>
</objects></BodySet>
<ConstraintSet><objects/></ConstraintSet><ForceSet><objects/></ForceSet><MarkerSet><objects/></MarkerSet>
</Model></OpenSimDocument>"""


def test_the_model_has_the_published_size():
    table = load_table()
    assert len(table["bodies"]) == 22
    assert len(table["muscles"]) == 80
    assert len(table["wraps"]) == 40
    assert len(free_coordinates(table)) == 41
    assert len(free_coordinates(load_source_table())) == 37
    assert len(coordinate_ranges(table)) == 43
    assert sum(body["mass"] for body in table["bodies"].values()) == pytest.approx(75.337, abs=1e-9)


def test_knees_gain_adduction_and_rotation_with_their_ranges():
    ranges = {item.name: item for item in coordinate_ranges(load_table())}
    for side in "rl":
        for extra in KNEE_EXTRA:
            item = ranges[f"{extra.name}_{side}"]
            assert (item.low, item.high, item.locked, item.follows) == (
                -extra.limit,
                extra.limit,
                False,
                None,
            )
        assert ranges[f"knee_angle_{side}_beta"].follows == f"knee_angle_{side}"
        assert ranges[f"knee_angle_{side}"].high == pytest.approx(math.radians(120), abs=1e-4)
    names = [item.name for item in coordinate_ranges(load_table())]
    start = names.index("knee_angle_r")
    assert names[start : start + 3] == ["knee_angle_r", "knee_adduction_r", "knee_rotation_r"]


def test_locked_coordinates_are_those_of_the_source():
    locked = {item.name for item in coordinate_ranges(load_table()) if item.locked}
    pairs = ("subtalar_angle", "mtp_angle", "wrist_flex", "wrist_dev")
    assert locked == {f"{name}_{side}" for name in pairs for side in "rl"}


def test_left_and_right_are_mirror_images():
    table = load_table()
    bodies = table["bodies"]
    for name in bodies:
        if name.endswith("_r"):
            right, left = bodies[name], bodies[f"{name[:-1]}l"]
            assert right["mass"] == left["mass"]
            np.testing.assert_allclose(right["com"], np.array(left["com"]) * [1, 1, -1], atol=1e-12)
    joints = {joint["name"]: joint for joint in table["joints"]}
    for name in joints:
        if name.endswith("_r"):
            right, left = joints[name]["parent_frame"][0], joints[f"{name[:-1]}l"]["parent_frame"][0]
            np.testing.assert_allclose(right, np.array(left) * [1, 1, -1], atol=1e-12)
    for name, muscle in table["muscles"].items():
        if name.endswith("_r"):
            twin = table["muscles"][f"{name[:-1]}l"]
            assert muscle["max_isometric_force"] == twin["max_isometric_force"]
            for (_, right), (_, left) in zip(muscle["points"], twin["points"], strict=True):
                np.testing.assert_allclose(right, np.array(left) * [1, 1, -1], atol=2e-4)


def test_every_reference_in_the_table_resolves():
    table = load_table()
    places = {"ground", *table["bodies"]}
    names = {item.name for item in coordinate_ranges(table)}
    for joint in table["joints"]:
        assert {joint["parent"], joint["child"]} <= places
        own = {item["name"] for item in joint["coordinates"]}
        assert {axis["of"] for axis in joint.get("transform", [])} - {None} <= own
    for muscle in table["muscles"].values():
        assert {body for body, _ in muscle["points"]} <= places
        assert {wrap for wrap, _, _ in muscle["wraps"]} <= set(table["wraps"])
    assert {actuator["coordinate"] for actuator in table["actuators"].values()} <= names
    assert {entry[0] for entry in table["markers"].values()} <= places


def test_the_caller_owns_its_copy():
    table = load_table()
    table["bodies"]["pelvis"]["mass"] = 0.0
    assert load_table()["bodies"]["pelvis"]["mass"] > 10


def test_the_shipped_table_is_strict_json_one_record_a_line():
    text = resources.files("hilbrace.skeleton").joinpath("rajagopal.json").read_text("utf-8")

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    assert one_record_a_line(json.loads(text, parse_constant=refuse)) == text
    assert sum(line.startswith('"glmax1_r"') for line in text.splitlines()) == 1


def test_transcription_of_the_source_is_the_shipped_table(tmp_path):
    source = source_model()
    if source is None:
        pytest.skip("Rajagopal2015.osim absent: set HILBRACE_RAJAGOPAL_OSIM or install nimblephysics")
    out = tmp_path / "table.json"
    command = [sys.executable, "-m", "hilbrace.skeleton.transcribe", str(source), str(out)]
    subprocess.run(command, cwd=ROOT, check=True, timeout=60)
    assert json.loads(out.read_text("utf-8")) == load_source_table()


def test_transcription_reads_each_kind_of_function(tmp_path):
    kinds = {
        "<LinearFunction><coefficients>2 1</coefficients></LinearFunction>": {"linear": [2.0, 1.0]},
        "<Constant><value>0.5</value></Constant>": {"constant": 0.5},
        "<SimmSpline><x>0 1</x><y>2 3</y></SimmSpline>": {"spline": [[0.0, 1.0], [2.0, 3.0]]},
    }
    for text, figures in kinds.items():
        path = tmp_path / "model.osim"
        path.write_text(MINIMAL.format(function=text))
        joint = transcribe(path)["joints"][0]
        assert joint["transform"] == [{"axis": [0.0, 0.0, 1.0], "of": "flexion", "function": figures}]
        assert (joint["parent"], joint["child"]) == ("ground", "shank")


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ("no xml", "cannot read"),
        ("<OpenSimDocument/>", "no bodies"),
        (MINIMAL.format(function="<PiecewiseLinearFunction/>"), "PiecewiseLinearFunction"),
        (MINIMAL.format(function="").replace("<function></function>", ""), "without one function"),
        (MINIMAL.format(function="").replace("false</reverse>", "true</reverse>"), "reversed"),
        (MINIMAL.format(function="").replace("<mass>3</mass>", ""), "no <mass>"),
    ],
)
def test_transcription_refuses_what_the_table_cannot_express(tmp_path, content, what):
    path = tmp_path / "model.osim"
    path.write_text(content)
    with pytest.raises(InputError, match=what):
        transcribe(path)
