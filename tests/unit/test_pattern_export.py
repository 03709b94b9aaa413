"""Files that other programs read."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh

from hilbrace.errors import InputError
from hilbrace.pattern.export import glb_bytes, ply_bytes, stl_bytes, write_surface

BOX = trimesh.creation.box((10, 20, 30))
VERTICES, TRIANGLES = np.asarray(BOX.vertices), np.asarray(BOX.faces)


@pytest.mark.parametrize(
    ("kind", "writer", "unit"), [("stl", stl_bytes, 1), ("ply", ply_bytes, 1), ("glb", glb_bytes, 1e-3)]
)
def test_trimesh_reads_the_same_body(kind, writer, unit):
    loaded = trimesh.load(io.BytesIO(writer(VERTICES, TRIANGLES)), file_type=kind, force="mesh")
    loaded.merge_vertices()
    assert loaded.is_watertight
    assert loaded.volume == pytest.approx(6000 * unit**3, rel=1e-5)
    assert loaded.extents == pytest.approx(np.array([10, 20, 30]) * unit, rel=1e-5)


def test_ply_keeps_double_precision():
    shifted = VERTICES + 1e-9
    loaded = trimesh.load(io.BytesIO(ply_bytes(shifted, TRIANGLES)), file_type="ply", process=False)
    assert np.asarray(loaded.vertices) == pytest.approx(shifted, abs=1e-15)
    assert np.array_equal(loaded.faces, TRIANGLES)


def test_glb_is_padded_and_carries_names():
    content = glb_bytes(VERTICES, TRIANGLES)
    assert len(content) % 4 == 0
    assert int.from_bytes(content[8:12], "little") == len(content)
    assert b'"name":"brace"' in content


def test_write_chooses_by_suffix_and_refuses_others(tmp_path):
    for suffix in ("stl", "ply", "glb"):
        path = tmp_path / f"part.{suffix}"
        write_surface(path, VERTICES, TRIANGLES)
        first = path.read_bytes()
        write_surface(path, VERTICES.copy(), TRIANGLES.copy())
        assert path.read_bytes() == first
    with pytest.raises(InputError, match=r"cannot write '\.obj' files"):
        write_surface(tmp_path / "part.obj", VERTICES, TRIANGLES)
