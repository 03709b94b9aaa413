"""Views merged and meshed: moves recovered, the mesh on the true surface, what is open said."""

from __future__ import annotations

from functools import cache

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from hilbrace.errors import GeometryError
from hilbrace.scan.calibration import Lens
from hilbrace.scan.clean import clean_mesh, inner_holes
from hilbrace.scan.fuse import fuse_views
from hilbrace.scan.merge import Move, limb_middle, merge_views
from hilbrace.scan.point_cloud import UPRIGHT, PointCloud, joined, smooth_view, view_cloud, write_cloud
from hilbrace.scan.triangulate import RangePicture
from mocks.scan_studio import LOOK_AT, leg_scene, look
from tests.unit.scan_scenes import distances, known, rms, small_rig

TURNS = (0.0, 45.0, 90.0)
AXIS = np.array([0.0, 0.0, -LOOK_AT])


@cache
def perfect_view(turn, noise=0.1):
    """What a view of a turned leg gives without a decoder, with noise along the rays [mm]."""
    points = look(leg_scene(turn), small_rig()).points
    random = np.random.default_rng(int(turn))
    depth = 1.0 + noise * random.standard_normal(points.shape[:2])[..., None] / LOOK_AT
    size = points.shape[:2]
    return RangePicture(
        points=(points * depth).astype(np.float32),
        error=np.full(size, noise, dtype=np.float32),
        colours=np.full((*size, 3), 120, dtype=np.uint8),
        off_line_px=0.0,
        left_out=0,
    )


def cloud(turn):
    view = perfect_view(turn)
    return view_cloud(view, smooth_view(view))


def off_true(move, turn, points):
    """Mean distance of points from where they belong [mm]."""
    true = Rotation.from_euler("y", -turn, degrees=True).as_matrix()
    return np.linalg.norm(
        points @ (move.rotation - true).T + move.shift - (AXIS - true @ AXIS), axis=1
    ).mean()


def test_normals_face_the_camera_and_follow_the_surface():
    view = perfect_view(0.0)
    own = view_cloud(view, smooth_view(view))
    assert np.abs(np.linalg.norm(own.normals, axis=1) - 1).max() < 1e-4
    assert (np.einsum("ij,ij->i", own.normals, own.points) < 0).all()
    scene = leg_scene(0.0)
    squared, triangle, _ = igl.point_mesh_squared_distance(
        (own.points @ UPRIGHT).astype(float),
        scene.solid.vertices.astype(float),
        scene.solid.faces.astype(np.int64),
    )
    true = scene.solid.face_normals[triangle] @ UPRIGHT
    cosine = np.einsum("ij,ij->i", own.normals, true)
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 6.0
    assert rms(np.sqrt(squared)) < 0.15


@pytest.mark.parametrize("off", [0.0, 7.0])
def test_turned_views_come_together(off):
    clouds = [cloud(turn) for turn in TURNS]
    told = [0.0, 45.0 + off, 90.0 - off]
    moves = merge_views(clouds, ["front", "left", "back"], told)
    for move, turn, own in zip(moves, TURNS, clouds, strict=True):
        assert off_true(move, turn, own.points) < 0.4
    assert moves[0] == Move(moves[0].rotation, moves[0].shift)
    assert max(move.misfit_mm for move in moves) < 0.3
    assert min(move.overlap for move in moves) > 0.5


def test_views_that_barely_moved_need_no_turns():
    own = cloud(0.0)
    rotation = Rotation.from_euler("yx", [6.0, 2.0], degrees=True).as_matrix()
    moved = own.moved(rotation, AXIS - rotation @ AXIS + [3.0, -2.0, 4.0])
    move = merge_views([own, moved], ["a", "b"], None)[1]
    back = moved.points @ move.rotation.T + move.shift
    assert np.linalg.norm(back - own.points, axis=1).mean() < 0.2


def test_views_of_opposite_sides_are_refused_by_name():
    with pytest.raises(GeometryError) as fault:
        merge_views(
            [cloud(0.0), cloud(0.0).moved(np.eye(3), np.array([0.0, 900.0, 0.0]))], ["front", "back"], None
        )
    assert fault.value.where == "back"
    assert "--turn" in fault.value.hint


def test_the_middle_of_a_limb_is_found():
    angle = np.linspace(-1.2, 1.2, 60)[:, None]
    height = np.linspace(-100, 100, 40)[None, :]
    radius = 60 + 0.1 * height
    x, y, z = radius * np.sin(angle) + 12, height + 0 * angle, radius * np.cos(angle) - 600
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    own = PointCloud(points, points, np.zeros(points.shape, np.uint8), np.ones(len(points), np.float32))
    np.testing.assert_allclose(limb_middle(own), [12, 0, -600], atol=1.0)


def test_the_mesh_of_known_views_lies_on_the_leg():
    turns = (0.0, 90.0, 180.0, 270.0)
    moves = []
    for turn in turns:
        rotation = Rotation.from_euler("y", -turn, degrees=True).as_matrix()
        moves.append(Move(rotation, AXIS - rotation @ AXIS))
    views = [smooth_view(perfect_view(turn)) for turn in turns]
    camera = known(small_rig()).camera
    mesh = clean_mesh(*fuse_views(views, moves, camera, 4.0), "leg")
    assert rms(distances(mesh.vertices @ UPRIGHT, leg_scene(0.0))) < 0.3
    surface = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    outward = np.einsum("ij,ij->i", surface.face_normals, (surface.triangles_center - AXIS) * [1, 0, 1])
    assert (outward > 0).mean() > 0.98
    assert igl.is_edge_manifold(mesh.triangles)
    assert len(mesh.holes) >= 2
    assert inner_holes(mesh) == ()


def test_depth_limits_leave_out_the_background():
    view = perfect_view(0.0)
    depth = view.points[..., 2]
    near = smooth_view(view, (0.0, 580.0))
    assert 0 < near.valid.sum() < smooth_view(view).valid.sum()
    assert np.nanmax(depth[near.valid]) <= 580.0


def test_too_fine_a_grid_is_refused():
    view = smooth_view(perfect_view(0.0))
    far = Move(np.eye(3), np.array([50_000.0, 0.0, 50_000.0]))
    with pytest.raises(GeometryError, match="too fine"):
        fuse_views([view, view], [Move(np.eye(3), np.zeros(3)), far], known(small_rig()).camera, 0.5)


def test_nothing_seen_is_no_mesh():
    empty = perfect_view(0.0)
    empty = RangePicture(np.full_like(empty.points, np.nan), empty.error, empty.colours, 0.0, 0)
    lens = Lens((480, 360), np.eye(3), np.zeros(5), 0.0)
    with pytest.raises(GeometryError, match="no surface"):
        fuse_views([smooth_view(empty)], [Move(np.eye(3), np.zeros(3))], lens, 2.0)


def test_the_largest_piece_stays_and_holes_are_reported():
    around, along = 120, 101
    angle, height = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.linspace(-150, 150, along))
    vertices = np.stack([50 * np.sin(angle), height, 50 * np.cos(angle)], axis=-1).reshape(-1, 3)
    k = (np.arange(along - 1)[:, None] * around + np.arange(around)).ravel()
    right = k - k % around + (k + 1) % around
    faces = np.concatenate(
        [np.stack([k, right, right + around], 1), np.stack([k, right + around, k + around], 1)]
    )
    window = np.linalg.norm(vertices[faces].mean(axis=1) - [0, 20, 50], axis=1) > 25.0
    crumb = trimesh.creation.icosphere(1, 5.0)
    all_vertices = np.concatenate([vertices, crumb.vertices + np.array([200, 0, 0])])
    triangles = np.concatenate([faces[window], crumb.faces + len(vertices)])
    mesh = clean_mesh(all_vertices, triangles, "tube")
    assert mesh.pieces_dropped == 1
    assert 0.0 < mesh.area_dropped < 0.02
    assert mesh.second_part == pytest.approx(mesh.area_dropped, rel=0.05)
    np.testing.assert_allclose(np.array(mesh.second_middle), [200, 0, 0], atol=0.1)
    assert len(mesh.holes) == 3
    (hole,) = inner_holes(mesh)
    assert np.linalg.norm(np.array(hole.middle) - [0, 20, 47]) < 2.0
    assert hole.across_mm == pytest.approx(50.0, abs=6.0)
    assert 150.0 < hole.length_mm < 260.0
    assert len(np.unique(mesh.triangles)) == len(mesh.vertices)


def test_sheets_that_touch_in_a_point_are_parted():
    square = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 1, 0], [2, 2, 0], [1, 2, 0]], dtype=float
    )
    triangles = np.array([[0, 1, 2], [0, 2, 3], [2, 4, 5], [2, 5, 6]])
    mesh = clean_mesh(square, triangles, "squares")
    assert len(mesh.triangles) == 2
    with pytest.raises(GeometryError, match="empty"):
        clean_mesh(square, triangles[:0], "squares")


def test_a_cloud_is_written_as_ply_that_others_read(tmp_path):
    own = cloud(0.0)
    write_cloud(own, tmp_path / "cloud.ply")
    read = trimesh.load(tmp_path / "cloud.ply", process=False)
    np.testing.assert_array_equal(np.asarray(read.vertices, np.float32), own.points)
    assert (np.asarray(read.colors)[:, :3] == own.colours).all()
    assert b"comment unit mm" in (tmp_path / "cloud.ply").read_bytes()[:300]
    assert len(joined([own, own]).points) == 2 * len(own.points)
    assert len(own.thinned(100).points) <= 100
