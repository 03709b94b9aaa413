"""Frames at any rate, their report, and the animated file as a viewer reads it."""

from __future__ import annotations

import json
import struct
from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.body.build import body_of
from hilbrace.body.crossings import crossing_triangles
from hilbrace.body.posing import bone_transforms
from hilbrace.body.skinning import SKINNINGS, bind, linear_skin, skin
from hilbrace.config import BodySettings, DomainSettings
from hilbrace.domain.animation import animation_bytes, vertex_normals, write_animation
from hilbrace.domain.deformation import deformation_gradients, folded
from hilbrace.domain.frame_report import report_frames, write_frame_report
from hilbrace.domain.frames import pose_in_distal
from hilbrace.domain.motion import moving_domain, resampled
from hilbrace.domain.rest import RestDomain, rest_domain
from hilbrace.errors import InputError
from tests.unit.body_people import person, scales_of
from tests.unit.domain_body import bending
from tests.unit.sleeve import sleeve_domain

KNEE = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 100.0, 110.0])
ANKLE = np.radians([-50.0, -40.0, -20.0, 0.0, 15.0, 30.0])
"""Angles of the ankle; negative is plantarflexion."""


@cache
def rest_of(joint: str, mass: float = 75.0, height: float = 1.75, triangles: int = 4000) -> RestDomain:
    return rest_domain(person(mass, height), DomainSettings(joint=joint, triangles=triangles))


def turned_over(rest: RestDomain, body, coordinate: str, angles: np.ndarray) -> np.ndarray:
    """Triangles that turn inside out: their normal opposes the way a point above them is carried."""
    normals = vertex_normals(rest.worn, rest.surface.triangles)
    both = np.concatenate([rest.worn, rest.worn + 0.01 * normals])
    posed = pose_in_distal(both, rest.joint, body, (coordinate,), angles[:, None])
    below, above = np.split(posed, 2, axis=1)
    corner, lift = below[:, rest.surface.triangles], (above - below)[:, rest.surface.triangles].mean(axis=2)
    normal = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
    return (normal * lift).sum(axis=-1) <= 0.0


def check_motion(rest: RestDomain, body, coordinate: str, angles: np.ndarray, clear: np.ndarray) -> None:
    """Area ratios within the limits everywhere, nothing inverted, no crossing where ``clear``."""
    triangles = rest.surface.triangles
    posed = pose_in_distal(rest.worn, rest.joint, body, (coordinate,), angles[:, None])
    area = np.linalg.det(deformation_gradients(rest.worn, posed, triangles))
    assert 0.25 <= area.min()
    assert area.max() <= 2.2
    assert not turned_over(rest, body, coordinate, angles).any()
    assert not folded(rest.worn, posed, triangles).any()
    for points in posed[clear]:
        assert not crossing_triangles(points, triangles).any()


def random_people(count: int, seed: int = 20) -> list[tuple[float, float]]:
    """Mass and height of people from short and thin to tall and heavy."""
    rng = np.random.default_rng(seed)
    heights = rng.permutation(np.linspace(1.50, 2.00, count))
    index = rng.permutation(np.linspace(18.0, 38.0, count))
    return [(round(float(i * h**2), 1), round(float(h), 3)) for i, h in zip(index, heights, strict=True)]


@pytest.mark.parametrize(("mass", "height"), [(75.0, 1.75), *random_people(3)])
def test_the_knee_bends_to_110_degrees_without_fold_or_inversion(mass, height):
    check_motion(
        rest_of("knee", mass, height), person(mass, height), "knee_angle_l", KNEE, np.degrees(KNEE) < 101.0
    )


@pytest.mark.soak
@pytest.mark.parametrize(("mass", "height"), random_people(10, seed=3))
def test_ten_people_bend_knee_and_ankle(mass, height):
    body = person(mass, height)
    check_motion(rest_of("knee", mass, height), body, "knee_angle_l", KNEE, np.degrees(KNEE) < 101.0)
    check_motion(rest_of("ankle", mass, height), body, "ankle_angle_l", ANKLE, ANKLE < 9.0)


def test_the_ankle_bends_from_50_degrees_plantarflexion_to_30_dorsiflexion():
    check_motion(rest_of("ankle"), person(), "ankle_angle_l", ANKLE, ANKLE < 9.0)


def test_the_checks_find_what_raw_linear_skinning_does():
    """Linear skinning without smoothing is on offer, and folds: the checks above can fail."""
    settings = BodySettings(skinning="linear", weight_smoothing_mm=0.0)
    body = body_of(scales_of(1.75), 75.0, 1.75, settings)
    rest = rest_of("knee")
    triangles = rest.surface.triangles
    posed = pose_in_distal(rest.worn, rest.joint, body, ("knee_angle_l",), KNEE[:, None])
    report = report_frames(
        rest.worn, posed, triangles, deformation_gradients(rest.worn, posed, triangles), KNEE
    )
    assert report.area_ratio_min[-1] < 0.15
    assert report.crossing[-1] > 0
    assert report.crossing[0] == report.folded[0] == 0
    figures = report.figures()
    assert figures["frames_outside_area_limits"] >= 2
    assert figures["crossing_triangles_max"] == report.crossing.max()


def test_linear_skinning_is_the_weighted_mean_of_rigid_motions():
    body = person()
    points = body.vertices[::500]
    weights = bind(points, body)
    motion = bone_transforms(body, ["knee_angle_r", "hip_flexion_l"], np.array([[1.2, 0.4], [0.0, 0.0]]))
    rotations, translations = motion
    expected = np.einsum("pb,fbij,pj->fpi", weights, rotations, points) + weights @ translations
    np.testing.assert_allclose(linear_skin(points, weights, *motion), expected, atol=1e-12)
    np.testing.assert_allclose(linear_skin(points, weights, *motion)[1], points, atol=1e-12)
    assert SKINNINGS["dual_quaternion"] is skin


def test_the_body_says_how_it_is_skinned_and_moves_so():
    plain, linear = person(), body_of(scales_of(1.75), 75.0, 1.75, BodySettings(skinning="linear"))
    assert (plain.skinning, linear.skinning) == ("dual_quaternion", "linear")
    rest = rest_of("knee")
    posed = [
        pose_in_distal(rest.worn, "knee_l", b, ("knee_angle_l",), KNEE[-1:, None]) for b in (plain, linear)
    ]
    far = np.linalg.norm(posed[0] - posed[1], axis=-1)
    assert 5.0 < far.max() < 60.0


@pytest.mark.parametrize("rate", [15.0, 60.0])
def test_frames_at_a_chosen_rate(rate):
    body, rest = person(), rest_of("knee", triangles=1000)
    loads = bending(body, np.linspace(0.0, 80.0, 76), "left")
    moving = moving_domain(rest, body, loads, rate)
    assert len(moving.time) == int(0.75 * rate) + 1
    np.testing.assert_allclose(np.diff(moving.time), 1.0 / rate)
    assert moving.posed.shape == (len(moving.time), len(rest.worn), 3)
    assert moving.deformation.shape == (len(moving.time), len(rest.surface.triangles), 2, 2)
    np.testing.assert_allclose(moving.posed[0], rest.worn, atol=1e-9)
    own = pose_in_distal(rest.worn, "knee_l", body, loads.coordinate_names, loads.coordinates[[40]])[0]
    np.testing.assert_allclose(moving.posed[int(0.4 * rate)], own, atol=1e-9)


@given(st.integers(2, 60), st.floats(3.0, 300.0))
def test_resampling_meets_the_recording_and_stays_inside_it(frames, rate):
    time = 2.0 + np.arange(frames) / 100.0
    values = np.column_stack([time**2, np.sin(time)])
    at, found = resampled(time, values, rate)
    assert at[0] == time[0]
    assert at[-1] <= time[-1] + 1e-9
    assert time[-1] - at[-1] < 1.0 / rate
    np.testing.assert_allclose(found[0], values[0])
    np.testing.assert_allclose(found[:, 0], at**2, atol=3e-5)


def test_resampling_refuses_gaps_and_rates_that_are_none():
    time = np.arange(5) / 100.0
    with pytest.raises(InputError, match="missing"):
        resampled(time, np.full((5, 1), np.nan), 15.0)
    with pytest.raises(InputError, match="rate"):
        resampled(time, np.zeros((5, 1)), 0.0)


def read_glb(content: bytes) -> tuple[dict, list[np.ndarray]]:
    """Document and accessors of a binary glTF file, checked as a loader checks them."""
    magic, version, total = struct.unpack_from("<4sII", content)
    assert (magic, version, total) == (b"glTF", 2, len(content))
    length, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON"
    assert length % 4 == 0
    document = json.loads(content[20 : 20 + length])
    size, kind = struct.unpack_from("<I4s", content, 20 + length)
    assert kind == b"BIN\0"
    binary = content[28 + length :]
    assert len(binary) == size == document["buffers"][0]["byteLength"]
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        columns = {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        values = np.frombuffer(binary, kind, accessor["count"] * columns, view["byteOffset"])
        assert values.nbytes == view["byteLength"]
        arrays.append(values.reshape(-1, columns))
        if "min" in accessor:
            np.testing.assert_array_equal(arrays[-1].min(axis=0), np.float32(accessor["min"]))
            np.testing.assert_array_equal(arrays[-1].max(axis=0), np.float32(accessor["max"]))
    return document, arrays


@pytest.fixture(scope="module")
def dance():
    domain = sleeve_domain(20, 12)
    rest, triangles = domain.vertices, domain.triangles
    time = np.array([0.5, 0.7, 1.1])
    posed = np.stack([rest, rest * [1.0, 1.1, 1.0], rest + np.array([5.0, 0.0, 2.0])])
    return rest, triangles, posed, time


def test_the_animation_plays_the_frames(dance):
    rest, triangles, posed, time = dance
    document, arrays = read_glb(animation_bytes(rest, triangles, posed, time))
    primitive = document["meshes"][0]["primitives"][0]
    base = arrays[primitive["attributes"]["POSITION"]]
    targets = np.stack([arrays[target["POSITION"]] for target in primitive["targets"]])
    sampler = document["animations"][0]["samplers"][0]
    channel = document["animations"][0]["channels"][0]["target"]
    clock, weights = arrays[sampler["input"]][:, 0], arrays[sampler["output"]].reshape(len(time), -1)
    assert (channel["path"], document["nodes"][channel["node"]]["mesh"]) == ("weights", 0)
    assert len(document["meshes"][0]["weights"]) == len(targets) == len(time)
    np.testing.assert_allclose(clock, time - time[0], atol=1e-6)
    np.testing.assert_allclose(base + np.tensordot(weights, targets, 1), posed, atol=2e-5)
    np.testing.assert_array_equal(arrays[primitive["indices"]].reshape(-1, 3), triangles)
    normals = [arrays[primitive["attributes"]["NORMAL"]] + arrays[t["NORMAL"]] for t in primitive["targets"]]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-5)


def test_an_independent_reader_finds_the_surface_in_metres_facing_front(dance, tmp_path):
    rest, triangles, posed, time = dance
    write_animation(tmp_path / "motion.glb", rest, triangles, posed, time)
    scene = trimesh.load(tmp_path / "motion.glb", process=False)
    mesh = scene.to_mesh()
    np.testing.assert_array_equal(mesh.faces, triangles)
    x, y, z = rest.T / 1000.0
    np.testing.assert_allclose(mesh.vertices, np.column_stack([-z, y, x]), atol=1e-6)


def test_the_bytes_are_the_same_twice_and_odd_frames_are_refused(dance):
    rest, triangles, posed, time = dance
    assert animation_bytes(rest, triangles, posed, time) == animation_bytes(rest, triangles, posed, time)
    with pytest.raises(InputError, match="do not ascend"):
        animation_bytes(rest, triangles, posed, time[[0, 0, 1]])
    with pytest.raises(InputError, match="0 frames"):
        animation_bytes(rest, triangles, posed[:0], time[:0])


def test_the_table_of_frames_holds_the_report(dance, tmp_path):
    rest, triangles, posed, time = dance
    report = report_frames(rest, posed, triangles, deformation_gradients(rest, posed, triangles), time)
    write_frame_report(report, tmp_path / "frames.csv")
    lines = (tmp_path / "frames.csv").read_text("ascii").splitlines()
    assert lines[0].startswith("time_s,area_ratio_min,area_ratio_max,stretch_min,stretch_max,")
    table = np.array([[float(x) for x in line.split(",")] for line in lines[1:]])
    np.testing.assert_allclose(table[:, 0], time)
    np.testing.assert_allclose(table[1, 3:5], [1.0, 1.1], atol=0.005)
    assert not table[:, 5:].any()
