"""A bare mesh as a body: read in any unit and axes, refused by name when damaged, bent without a fold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from hilbrace.body.body import Body
from hilbrace.body.build import body_of
from hilbrace.body.crossings import crossing_triangles
from hilbrace.body.mesh_file import load_triangles, read_mesh
from hilbrace.body.mesh_joints import sections_at
from hilbrace.body.posing import posed_skin
from hilbrace.config import BodySettings
from hilbrace.domain.deformation import deformation_gradients
from hilbrace.errors import ConfigError, GeometryError, HilbraceError, InputError
from hilbrace.units import MESH_TO_M
from tests.unit.body_people import person, scales_of

KNEES = np.radians([0.0, 60.0, 90.0, 100.0, 110.0])


def write(folder: Path, vertices: np.ndarray, triangles: np.ndarray, name: str = "scan.ply") -> Path:
    path = folder / name
    trimesh.Trimesh(vertices, triangles, process=False).export(path)
    return path


@pytest.fixture(scope="module")
def standing() -> tuple[np.ndarray, np.ndarray]:
    """A person's surface in the file's default axes: x to the left, y up, z forward [m]."""
    body = person()
    return body.vertices[:, [2, 1, 0]] * [-1, 1, 1], body.triangles


def leg_of(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The right leg of the standing person up to the mid-thigh, open at the top."""
    keep = (vertices[:, 0] < -0.01) & (vertices[:, 1] < -0.25)
    kept = triangles[keep[triangles].all(axis=1)]
    used, flat = np.unique(kept, return_inverse=True)
    part = trimesh.Trimesh(vertices[used], flat.reshape(-1, 3), process=False)
    largest = max(part.split(only_watertight=False), key=lambda m: len(m.faces))
    return np.array(largest.vertices), np.array(largest.faces)


def mesh_body(path: Path, height: float = 1.75, **settings) -> Body:
    return body_of(scales_of(height), 75.0, height, BodySettings(model="mesh", model_file=path, **settings))


def around_knee(body: Body, side: str) -> np.ndarray:
    """Triangles of the sleeve from 40 % of the thigh to 38 % of the shank around the knee."""
    hip, knee, ankle = (
        body.joint_centres[body.joint_names.index(f"{j}_{side}")] for j in ("hip", "knee", "ankle")
    )
    leg = (
        body.bone_weights[:, [body.bones.index(f"{b}_{side}") for b in ("femur", "tibia")]].sum(axis=1) > 0.5
    )
    up = body.vertices[:, 1] - knee[1]
    near = leg & (up < 0.40 * (hip - knee)[1]) & (up > -0.38 * (knee - ankle)[1])
    return body.triangles[near[body.triangles].all(axis=1)]


def stays_whole(body: Body, side: str) -> np.ndarray:
    """Check the bent knee of a mesh body and return its area ratios."""
    triangles = around_knee(body, side)
    assert len(triangles) > 300
    posed = posed_skin(body, [f"knee_angle_{side}"], KNEES[:, None])
    ratio = np.linalg.det(deformation_gradients(body.vertices, posed, triangles))
    assert not any(crossing_triangles(points, triangles).any() for points in posed[:4])
    assert 0.25 < ratio.min()
    assert ratio.max() < 2.2
    return ratio


def test_a_persons_mesh_finds_the_persons_joints(tmp_path, standing):
    own = person()
    body = mesh_body(write(tmp_path, *standing))
    assert body.model == "mesh"
    assert body.fit_error_mm.max() < 10.0
    np.testing.assert_array_equal(body.joint_centres, own.joint_centres)
    assert np.linalg.norm(body.vertices[:, 1].max() - own.vertices[:, 1].max()) < 0.01
    for side in "rl":
        stays_whole(body, side)


def test_weights_of_a_mesh_are_about_those_of_the_embedded_body(tmp_path, standing):
    own, body = person(), mesh_body(write(tmp_path, *standing))
    order = [int(np.linalg.norm(own.vertices - v, axis=1).argmin()) for v in body.vertices[::40]]
    for bones in (("femur_r",), ("tibia_l",), ("calcn_r", "toes_r")):
        columns = [body.bones.index(bone) for bone in bones]
        mine, theirs = body.bone_weights[::40, columns], own.bone_weights[order][:, columns]
        assert np.abs(mine.sum(axis=1) - theirs.sum(axis=1)).max() < 0.35
    np.testing.assert_allclose(body.bone_weights.sum(axis=1), 1.0)


@pytest.mark.parametrize("unit", ["cm", "mm", "inch"])
def test_any_unit_axes_and_format_give_the_same_body(tmp_path, standing, unit):
    vertices, triangles = standing
    plain = mesh_body(write(tmp_path, vertices, triangles))
    turned = vertices[:, [2, 0, 1]] * [-1, -1, 1] / MESH_TO_M[unit]
    name = {"cm": "scan.obj", "mm": "scan.stl", "inch": "scan.ply"}[unit]
    body = mesh_body(
        write(tmp_path, turned, triangles, name), mesh_units=unit, mesh_up="z", mesh_forward="-x"
    )
    distance = np.abs(np.sort(body.vertices, axis=0) - np.sort(plain.vertices, axis=0)).max()
    assert distance < 5e-5
    assert len(body.triangles) == len(plain.triangles)


def test_an_inside_out_mesh_is_turned(tmp_path, standing):
    vertices, triangles = standing
    mixed = triangles.copy()
    mixed[::3] = mixed[::3, ::-1]
    for given in (triangles[:, ::-1], mixed):
        surface = read_mesh(BodySettings(model="mesh", model_file=write(tmp_path, vertices, given)))
        volume = trimesh.Trimesh(surface.vertices, surface.triangles, process=False).volume
        assert volume == pytest.approx(trimesh.Trimesh(vertices, triangles, process=False).volume, rel=1e-5)


def test_one_leg_alone_is_a_body(tmp_path, standing):
    path = write(tmp_path, *leg_of(*standing))
    body = mesh_body(path, mesh_legs="right")
    assert body.fit_error_mm.max() < 10.0
    assert (body.fit_error_mm[3:] == 0.0).all()
    assert body.height_m == 1.75
    assert body.height_error_mm == 0.0
    stays_whole(body, "r")
    with pytest.raises(GeometryError):
        mesh_body(path, mesh_legs="left", landmarks={"knee_l": (0.5, -0.5, 0.0)})


def test_landmarks_on_both_sides_of_the_knee_place_it(tmp_path, standing):
    path = write(tmp_path, *leg_of(*standing))
    own = person()
    knee = own.joint_centres[own.joint_names.index("knee_r")][[2, 1, 0]] * [-1, 1, 1]
    across = np.array([-0.05, 0.0, 0.004])
    sides = {
        "knee_r_lateral": tuple(knee + across),
        "knee_r_medial": tuple(knee - across),
    }
    body = mesh_body(path, mesh_legs="right", landmarks=sides)
    centre = mesh_body(path, mesh_legs="right", landmarks={"knee_r": tuple(knee)})
    np.testing.assert_allclose(body.vertices, centre.vertices, atol=1e-12)


def test_sections_of_a_tilted_box_have_its_centre_and_area(tmp_path):
    box = trimesh.creation.box((0.4, 1.0, 0.2))
    box.apply_translation((0.3, 0.0, -0.2))
    both = trimesh.util.concatenate([box, trimesh.creation.cylinder(0.1, 1.0, sections=90)])
    vertices = np.array(both.vertices)
    vertices[8:] = vertices[8:][:, [0, 2, 1]] * [1, 1, -1] + [-0.5, 0.0, 0.1]
    surface = read_mesh(
        BodySettings(model="mesh", model_file=write(tmp_path, vertices, both.faces), mesh_forward="x")
    )
    sections = sorted(sections_at(surface, 0.13), key=lambda one: one.area)
    assert [one.area for one in sections] == pytest.approx([np.pi * 0.01, 0.08], rel=2e-3)
    np.testing.assert_allclose(sections[0].centre, [-0.5, 0.13, 0.1], atol=1e-6)
    np.testing.assert_allclose(sections[1].centre, [0.3, 0.13, -0.2], atol=1e-6)
    assert sections_at(surface, 2.0) == []


def refused(path: Path, **settings) -> HilbraceError:
    with pytest.raises(HilbraceError) as caught:
        mesh_body(path, **settings)
    assert str(path) in caught.value.where or caught.value.where.startswith("body.")
    return caught.value


@pytest.mark.parametrize(("wrong", "right"), [("mm", "m"), ("inch", "m"), ("cm", "m")])
def test_metres_taken_for_another_unit_are_named(tmp_path, standing, wrong, right):
    error = refused(write(tmp_path, *standing), mesh_units=wrong)
    assert isinstance(error, InputError)
    assert f"taken as {wrong}" in error.what
    assert f"'{right}'" in error.hint


@pytest.mark.parametrize("true", ["mm", "inch", "cm"])
def test_other_units_taken_for_metres_are_named(tmp_path, standing, true):
    vertices, triangles = standing
    error = refused(write(tmp_path, vertices / MESH_TO_M[true], triangles))
    assert "m long when its figures are taken as m" in error.what
    assert f"'{true}'" in error.hint


def test_a_leg_in_inches_taken_for_centimetres_has_no_knee(tmp_path, standing):
    vertices, triangles = leg_of(*standing)
    error = refused(write(tmp_path, vertices / 0.0254, triangles), mesh_units="cm", mesh_legs="right")
    assert "mesh_units" in error.hint or "mesh_legs" in error.hint


def test_a_hole_is_named_with_its_width_and_place(tmp_path, standing):
    vertices, triangles = standing
    knee = np.array([-0.09, -0.49, 0.04])
    hole = np.linalg.norm(vertices[triangles].mean(axis=1) - knee, axis=1) > 0.06
    error = refused(write(tmp_path, vertices, triangles[hole]))
    assert isinstance(error, GeometryError)
    assert "1 holes, the widest" in error.what
    assert "close the holes" in error.hint


def test_non_manifold_edges_and_loose_parts_are_named(tmp_path, standing):
    vertices, triangles = standing
    edge = triangles[5, :2]
    fin = np.concatenate([vertices, vertices[edge].mean(axis=0, keepdims=True) + 0.02])
    error = refused(write(tmp_path, fin, np.concatenate([triangles, [[*edge, len(vertices)]]])))
    assert "1 edges of the surface belong to more than two triangles" in error.what
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    both = trimesh.util.concatenate([trimesh.Trimesh(vertices, triangles, process=False), ball])
    error = refused(write(tmp_path, np.array(both.vertices), np.array(both.faces)))
    assert "consists of 2 parts" in error.what


@pytest.mark.parametrize(
    ("settings", "kind", "message"),
    [
        ({"mesh_forward": "-z"}, InputError, "toes of the mesh point backward"),
        ({"mesh_forward": "y"}, ConfigError, "are one axis"),
        ({"mesh_up": "x"}, HilbraceError, ""),
        ({"mesh_up": "-y"}, HilbraceError, ""),
        ({"mesh_up": "z", "mesh_forward": "x"}, InputError, "tall and the person"),
        ({"landmarks": {"knee_left": (0.0, 0.0, 0.0)}}, ConfigError, "no landmark is called 'knee_left'"),
        ({"landmarks": {"knee_r_medial": (0.0, 0.0, 0.0)}}, ConfigError, "on one side only"),
        ({"landmarks": {"knee_r": (0.0, 0.9, 0.0)}}, GeometryError, "knee_r"),
        ({"height": 1.2}, InputError, "1.75 m tall and the person 1.20 m"),
        (
            {"landmarks": {"knee_r": (-0.09, -0.49, 0.0), "ankle_r": (-0.09, -0.7, 0.0)}},
            GeometryError,
            "the shank (r) is 210 mm long in the mesh",
        ),
    ],
)
def test_wrong_settings_are_named(tmp_path, standing, settings, kind, message):
    error = refused(write(tmp_path, *standing), **settings)
    assert isinstance(error, kind)
    assert message in error.what


def test_files_that_are_no_meshes_are_refused(tmp_path):
    cloud = tmp_path / "cloud.ply"
    trimesh.PointCloud(np.random.default_rng(0).random((50, 3))).export(cloud)
    torn = write(tmp_path, *[np.array(a) for a in (np.eye(3), [[0, 1, 2]])], name="torn.stl")
    torn.write_bytes(torn.read_bytes()[:100])
    text, empty = tmp_path / "notes.obj", tmp_path / "empty.ply"
    text.write_text("not a mesh")
    empty.write_bytes(b"")
    for path in (cloud, torn, text, empty, tmp_path / "scan.txt", tmp_path / "absent.ply"):
        with pytest.raises(InputError) as caught:
            load_triangles(path)
        assert str(path) in caught.value.where
    with pytest.raises(ConfigError, match="no mesh is named"):
        read_mesh(BodySettings(model="mesh"))


@pytest.mark.parametrize(("name", "height"), [("man", 1.791), ("woman", 1.658)])
def test_average_man_and_woman_bend_both_knees_without_a_fold(shared_data, name, height):
    body = mesh_body(shared_data / "body_meshes" / f"human_{name}.obj", height)
    assert body.height_error_mm == pytest.approx(0.0, abs=5.0)
    assert body.fit_error_mm.max() < 10.0
    for side in "rl":
        stays_whole(body, side)


@pytest.mark.parametrize("name", ["residual_limb_scan", "residual_limb_scan_2"])
def test_real_scans_of_a_residual_limb_are_bodies(shared_data, name):
    """Millimetres, z up, the hollow of the knee towards +y: one landmark tells the knee."""
    path = shared_data / "body_meshes" / f"{name}.stl"
    axes = {"mesh_units": "mm", "mesh_up": "z", "mesh_forward": "-y", "mesh_legs": "left"}
    body = mesh_body(path, landmarks={"knee_l": (2.0, 2.0, 5.0)}, **axes)
    assert len(body.triangles) > 14_000
    low = body.joint_centres[body.joint_names.index("knee_l")][1] - body.vertices[:, 1].min()
    assert low == pytest.approx(0.218, abs=0.003)
    posed = posed_skin(body, ["knee_angle_l"], KNEES[:, None])
    ratio = np.linalg.det(deformation_gradients(body.vertices, posed, body.triangles))
    assert 0.25 < ratio.min() < ratio.max() < 2.2
    assert not crossing_triangles(posed[3], body.triangles).any()
    error = refused(path, **axes)
    assert "does not end in a foot" in error.what
    assert "knee_l" in error.hint
