"""Scans from files: units, islands, holes, strays, thinning."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from hilbrace.errors import InputError
from hilbrace.scan.surface_scan import describe_holes, read_scan, thinned


def tube(length_mm: float = 400.0, radius_mm: float = 60.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.cylinder(radius_mm, length_mm, sections=64).subdivide_to_size(8.0)
    mesh.merge_vertices()
    keep = np.abs(mesh.triangles_center[:, 2]) < 0.499 * length_mm
    mesh.update_faces(keep)
    mesh.remove_unreferenced_vertices()
    return mesh


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "mm"), (1e-3, "m")])
def test_millimetres_and_metres_are_told_by_size(tmp_path, scale, unit):
    mesh = tube()
    mesh.apply_scale(scale)
    mesh.export(tmp_path / "leg.ply")
    scan = read_scan(tmp_path / "leg.ply")
    assert scan.unit == unit
    assert np.ptp(scan.points, axis=0).max() == pytest.approx(0.4, rel=0.02)
    assert [hole.end for hole in scan.holes] == [True, True]
    np.testing.assert_allclose(np.linalg.norm(scan.points[:, :2], axis=1), 0.06, rtol=0.01)
    assert ((scan.normals[:, :2] * scan.points[:, :2]).sum(axis=1) > 0.05).all()


@pytest.mark.parametrize("wound", ["inwards", "some", "most"])
def test_meshes_wound_in_any_way_face_outward(tmp_path, wound):
    mesh = tube()
    faces = np.array(mesh.faces)
    share = {"inwards": 1.0, "some": 0.1, "most": 0.9}[wound]
    turned = np.random.default_rng(0).random(len(faces)) < share
    faces[turned] = faces[turned][:, ::-1]
    front = mesh.vertices[faces].mean(axis=1)[:, 0] > 0.0  # A single view: half a tube.
    trimesh.Trimesh(mesh.vertices, faces[front], process=False).export(tmp_path / "leg.ply")
    scan = read_scan(tmp_path / "leg.ply")
    assert scan.oriented
    assert ((scan.normals[:, :2] * scan.points[:, :2]).sum(axis=1) > 0.05).all()


def test_inches_must_be_named(tmp_path):
    mesh = tube()
    mesh.apply_scale(1 / 25.4)
    mesh.export(tmp_path / "leg.stl")
    with pytest.raises(InputError, match="no limb in millimetres or metres") as told:
        read_scan(tmp_path / "leg.stl")
    assert "--units inch (0.40 m)" in told.value.hint
    assert read_scan(tmp_path / "leg.stl", "inch").unit == "inch"
    with pytest.raises(InputError, match="long in mm"):
        read_scan(tmp_path / "leg.stl", "mm")


def test_holes_are_told_and_islands_dropped(tmp_path):
    mesh = tube()
    centre = np.array([60.0, 0.0, 20.0])
    mesh.update_faces(np.linalg.norm(mesh.triangles_center - centre, axis=1) > 20.0)
    mesh.remove_unreferenced_vertices()
    dust = trimesh.creation.icosphere(subdivisions=1, radius=4.0)
    dust.apply_translation([150.0, 0.0, 0.0])
    trimesh.util.concatenate([mesh, dust]).export(tmp_path / "leg.ply")
    scan = read_scan(tmp_path / "leg.ply")
    assert scan.dropped == 1
    assert len(scan.gaps) == 1
    np.testing.assert_allclose(1000 * scan.gaps[0].centre, centre, atol=12.0)
    assert any(line.startswith("hole, ") and "(5" in line for line in describe_holes(scan))


def test_a_cloud_gets_normals_and_loses_strays(tmp_path):
    draw = np.random.default_rng(0)
    points = np.asarray(trimesh.sample.sample_surface(tube(), 20000, seed=0)[0])
    points = np.concatenate([points, draw.uniform(-300, 300, (40, 3))])
    trimesh.PointCloud(points).export(tmp_path / "leg.ply")
    scan = read_scan(tmp_path / "leg.ply", "mm")
    assert not scan.oriented
    assert 20 <= scan.dropped <= 60
    outward = scan.points[:, :2] / np.linalg.norm(scan.points[:, :2], axis=1, keepdims=True)
    facing = np.abs((scan.normals[:, :2] * outward).sum(axis=1))
    assert np.median(facing) > 0.98


def test_thinned_points_are_means_of_cells():
    points = np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [5.0, 5.0, 5.0]])
    np.testing.assert_allclose(thinned(points, 1.0), [[0.2, 0.1, 0.1], [5.0, 5.0, 5.0]])


@pytest.mark.parametrize("name", ["leg.xyz", "missing.ply", "empty.ply"])
def test_files_that_are_no_scans(tmp_path, name):
    if not name.startswith("missing"):
        (tmp_path / name).write_text("nothing")
    with pytest.raises(InputError):
        read_scan(tmp_path / name)


@pytest.mark.soak
def test_five_million_points_stay_below_four_gigabytes(tmp_path):
    import resource

    points = np.asarray(trimesh.sample.sample_surface(tube(), 5_000_000, seed=0)[0])
    trimesh.PointCloud(points).export(tmp_path / "leg.ply")
    scan = read_scan(tmp_path / "leg.ply", "mm")
    assert len(scan.points) < 200_000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 4_000_000
