"""A person's body: the figures asked for, joints inside the limbs, left like right; recorded people."""

from __future__ import annotations

from pathlib import Path

import igl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.body import fit
from hilbrace.body.anny_lite import load_anny_lite
from hilbrace.body.body import Body
from hilbrace.body.build import MARKER_RADIUS, body_of, build_body, joint_breadths, standing_landmarks
from hilbrace.body.posing import body_skeleton
from hilbrace.config import BodySettings
from hilbrace.errors import InputError
from hilbrace.motion.opensim_files import read_trc
from hilbrace.motion.trial import Trial
from hilbrace.run import records
from tests.unit.body_people import mirror_of, person, scales_of


def trial_of(
    names: tuple[str, ...], places: np.ndarray, marker_map: str, mass: float, height: float
) -> Trial:
    empty = np.zeros((0, 2, 3))
    return Trial(
        name="standing",
        origin="recorded",
        time=np.zeros(0),
        rate_hz=100.0,
        marker_names=(),
        markers=np.zeros((0, 0, 3)),
        static_marker_names=names,
        static_markers=places,
        feet=("right", "left"),
        ground_force=empty,
        centre_of_pressure=empty,
        free_torque=empty,
        mass_kg=mass,
        height_m=height,
        marker_map=marker_map,
        notes=(),
    )


@pytest.fixture(scope="module")
def opencap(shared_data: Path) -> Trial:
    table = read_trc(shared_data / "opencap_subject4" / "markers" / "static1.trc")
    return trial_of(table.names, np.nanmean(table.positions, axis=0), "opencap", 60.0, 0.0)


@settings(max_examples=5, deadline=None)
@given(st.floats(50.0, 110.0), st.floats(1.5, 2.0))
def test_height_and_mass_are_those_of_the_person(mass, height):
    body = body_of(scales_of(height), mass, height, BodySettings())
    volume, _ = fit.enclosed_volume(body.vertices, body.triangles)
    assert np.ptp(body.vertices[:, 1]) == pytest.approx(height, abs=0.001)
    assert body.height_error_mm == pytest.approx((np.ptp(body.vertices[:, 1]) - height) * 1000)
    assert volume * fit.DENSITY == pytest.approx(mass, rel=0.002)
    assert body.fit_error_mm.max() < 20.0
    assert np.abs(body.shape[:16]).max() < 5.0


def test_joint_centres_are_the_skeletons_and_lie_inside_the_limbs():
    body = person()
    pose = body_skeleton(body).forward({})
    for name, origin in (("hip_r", "femur_r"), ("knee_l", "tibia_l"), ("ankle_l", "talus_l")):
        centre = body.joint_centres[body.joint_names.index(name)]
        np.testing.assert_allclose(centre, pose[origin].origin[0], atol=1e-12)
    inside = igl.fast_winding_number(body.vertices, body.triangles, body.joint_centres)
    np.testing.assert_allclose(inside, 1.0, atol=0.05)
    squared = igl.point_mesh_squared_distance(body.joint_centres, body.vertices, body.triangles)[0]
    depth = dict(zip(body.joint_names, np.sqrt(squared), strict=True))
    assert 0.04 < depth["knee_r"] < 0.08
    assert 0.02 < depth["ankle_r"] < 0.05
    assert 0.06 < depth["hip_r"] < 0.13


def test_left_mirrors_right():
    body = person()
    mirror = mirror_of(load_anny_lite().template)
    np.testing.assert_allclose(body.vertices[mirror], body.vertices * [1, 1, -1], atol=1e-9)


def test_the_person_stands_flat_and_faces_forward():
    body = person()
    low = body.vertices[body.vertices[:, 1] < body.vertices[:, 1].min() + 0.01]
    assert np.ptp(low[:, 0]) > 0.12
    ankle = body.joint_centres[body.joint_names.index("ankle_r")]
    assert low[:, 0].max() - ankle[0] > 0.1
    shank = body.joint_centres[1] - body.joint_centres[2]
    assert shank[1] > 0.99 * np.linalg.norm(shank)


def test_without_a_height_the_segments_decide():
    body = body_of(scales_of(1.80), 80.0, 0.0, BodySettings())
    assert body.height_m == pytest.approx(1.80, abs=0.06)
    assert body.height_error_mm == 0.0


def test_breadths_widen_the_knee():
    lean, broad = (
        body_of(scales_of(1.75), 75.0, 1.75, BodySettings(), {"knee breadth": b}) for b in (0.095, 0.125)
    )
    model = load_anny_lite()
    widths = [fit.measure(model, body.shape)["knee breadth"].value for body in (lean, broad)]
    assert widths[1] - widths[0] > 0.01


def test_breadth_is_between_the_markers_less_their_radii():
    marks = {"RLFC": np.array([0.0, 0.5, 0.16]), "RMFC": np.array([0.0, 0.5, 0.04]), "LLMAL": np.zeros(3)}
    assert joint_breadths(marks) == {"knee breadth": pytest.approx(0.12 - 2 * MARKER_RADIUS)}


def test_hidden_and_unknown_markers_are_left_out():
    names = ("r_knee", "L_knee", "no such marker")
    places = np.array([[0.0, 0.5, 0.1], [np.nan, 0.5, -0.1], [1.0, 1.0, 1.0]])
    marks = standing_landmarks(trial_of(names, places, "opencap", 70.0, 1.7))
    assert list(marks) == ["RLFC"]


def test_a_person_without_mass_is_refused():
    with pytest.raises(InputError, match="mass"):
        body_of(scales_of(1.7), 0.0, 1.7, BodySettings())


def test_girths_are_those_of_an_independent_average_body(shared_data):
    """Calf, knee and thigh of another model's average man and woman: within 10 %, the low calf 15 %."""
    for name, height in (("man", 1.791), ("woman", 1.658)):
        vertices, triangles = read_obj(shared_data / "body_meshes" / f"human_{name}.obj")
        other = vertices[:, [2, 1, 0]] * [1, 1, -1]
        mass = abs(fit.enclosed_volume(other, triangles)[0]) * fit.DENSITY
        body = body_of(scales_of(height), mass, height, BodySettings())
        for level in (0.15, 0.21, 0.27, 0.33, 0.38):
            ours, theirs = (
                girth(v, t, v[:, 1].min() + level * height)
                for v, t in ((body.vertices, body.triangles), (other, triangles))
            )
            assert ours == pytest.approx(theirs, rel=0.15 if level < 0.2 else 0.10), (name, level)


def test_a_recorded_person_has_the_measured_knees(opencap):
    body = build_body(opencap, BodySettings())
    assert body.height_m == pytest.approx(1.70, abs=0.06)
    marks = standing_landmarks(opencap)
    breadth = joint_breadths(marks)["knee breadth"]
    knee = body.joint_centres[body.joint_names.index("knee_r")]
    level = (np.abs(body.vertices[:, 1] - knee[1]) < 0.012) & (body.vertices[:, 2] > 0.0)
    assert np.ptp(body.vertices[level, 2]) == pytest.approx(breadth, abs=0.006)
    assert np.ptp(body.segment_scales[body.scaled_bodies.index("femur_r")]) == pytest.approx(0.0)


def test_the_record_survives_the_disk_and_is_the_same_twice(tmp_path):
    body = person()
    again = body_of(scales_of(1.75), 75.0, 1.75, BodySettings())
    assert records.pack(body) == records.pack(again)
    records.save(body, tmp_path / "body.npz")
    back = records.load(Body, tmp_path / "body.npz")
    np.testing.assert_array_equal(back.bone_weights, body.bone_weights)
    assert records.pack(back) == records.pack(body)


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    rows = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([row[1:4] for row in rows if row[:1] == ["v"]], float)
    faces = [[int(cell.split("/")[0]) - 1 for cell in row[1:4]] for row in rows if row[:1] == ["f"]]
    return vertices, np.array(faces)


def girth(vertices: np.ndarray, triangles: np.ndarray, height: float) -> float:
    """Length of the cut through the leg at z > 0 at one height."""
    side = vertices[triangles][:, :, 1] - height
    cut = (side.min(axis=1) < 0) & (side.max(axis=1) > 0)
    ends = []
    for corner in range(3):
        a, b = side[cut, corner], side[cut, (corner + 1) % 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(a * b < 0, a / (a - b), np.nan)[:, None]
        p, q = (vertices[triangles[cut, k % 3]] for k in (corner, corner + 1))
        ends.append(p + share * (q - p))
    points = np.stack(ends, axis=1)
    crossing = ~np.isnan(points[:, :, 0])
    pairs = points[crossing].reshape(-1, 2, 3)
    pairs = pairs[pairs[:, :, 2].mean(axis=1) > 0]
    return float(np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1).sum())
