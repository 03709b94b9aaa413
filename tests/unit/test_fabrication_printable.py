"""Pieces as printers read them."""

import io

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from fabrication.mold import Piece
from fabrication.printable import open_edges, printable, read_stl, weld
from hilbrace.errors import GeometryError
from hilbrace.pattern.export import stl_bytes


def piece(solid: Manifold, printing: np.ndarray | None = None) -> Piece:
    turn = np.eye(3) if printing is None else printing
    return Piece("block", "Block", "shell", solid, np.array([1.0, 0.0, 0.0]), turn, (0.5, 0.5, 0.5))


def test_a_piece_stands_on_the_bed_in_the_middle():
    turn = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    found = printable(piece(Manifold.cube((10, 20, 30)).translate((5, 5, 5)), turn))
    assert found.size == pytest.approx((10, 30, 20))
    assert found.vertices[:, 2].min() == 0.0
    assert np.abs(found.vertices[:, :2].min(axis=0) + found.vertices[:, :2].max(axis=0)).max() < 1e-5
    assert (found.parts, found.voids, found.open_edges) == (1, 0, 0)
    assert found.volume_mm3 == pytest.approx(6000.0)


def test_loose_parts_and_hollows_are_counted():
    two = Manifold.cube((5, 5, 5)) + Manifold.cube((5, 5, 5)).translate((9, 0, 0))
    hollow = Manifold.cube((9, 9, 9)) - Manifold.cube((3, 3, 3)).translate((3, 3, 3))
    assert printable(piece(two)).parts == 2
    assert (printable(piece(hollow)).parts, printable(piece(hollow)).voids) == (1, 1)


def test_faces_that_nearly_touch_stay_watertight_in_single_precision():
    """Two towers 1e-7 mm apart at x = 100 fall together in single precision: 8e-6 mm is its step there."""
    gap = 1e-7
    left = Manifold.cube((10, 10, 10)).translate((100, 0, 2))
    right = Manifold.cube((10, 10, 10)).translate((110 + gap, 0, 2))
    solid = left + right + Manifold.cube((20, 10, 3)).translate((100, 0, 0))
    assert solid.decompose()[0].volume() > 0
    found = printable(piece(solid))
    assert found.open_edges == 0
    mesh = trimesh.load(io.BytesIO(stl_bytes(found.vertices, found.triangles)), file_type="stl")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(solid.volume(), rel=1e-3)


def test_open_edges_are_those_that_lack_a_partner():
    faces = np.asarray(trimesh.creation.box().faces)
    assert open_edges(faces) == 0
    assert open_edges(faces[1:]) == 3
    assert open_edges(np.concatenate([faces, faces[:1]])) == 3
    assert open_edges(np.concatenate([faces[:-1], faces[-1:, ::-1]])) > 0


def test_a_file_reads_back_as_it_was_written():
    found = printable(piece(Manifold.sphere(10.0, 48)))
    content = stl_bytes(found.vertices, found.triangles)
    vertices, triangles = weld(read_stl(content))
    assert len(vertices) == len(found.vertices)
    assert len(triangles) == len(found.triangles)
    assert open_edges(triangles) == 0
    with pytest.raises(GeometryError, match="length"):
        read_stl(content[:-7])
