"""Files of a mold read back by other programs' readers, and the figures of the work sheet."""

import io
import re
import zipfile
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from fabrication.exploded import exploded
from fabrication.export import write_glb, write_stl_files
from fabrication.mold import Casting, Core, Filling, Hardware, Mold, Piece
from fabrication.printable import printable
from fabrication.three_mf import write_3mf
from fabrication.worksheet import hours, silicone_needed

UP = np.array([0.0, 1.0, 0.0])


@pytest.fixture
def mold() -> Mold:
    """A block of 2 ml cast between a core and two shells that are mere boxes."""
    brace = Manifold.cube((10, 20, 10), True)
    empty = np.zeros((0, 3))
    casting = Casting(
        name="block", joint="", side="", brace=brace, thickness_mm=4.0, vertices=empty, direction=empty,
        thickness=np.zeros(0), triangles=np.zeros((0, 3), np.int64), covered=None,
        beyond=np.zeros(0, np.int64), down=-UP, up=UP, centreline=empty, shrinkage=0.0,
    )  # fmt: skip
    body = Manifold.cube((10, 60, 10), True)
    core = Core(body, body, Manifold.cube((10, 5, 10), True), empty, empty, UP, np.zeros(3))
    side = Manifold.cube((10, 60, 5), True)
    pull = np.array([0.0, 0.0, 1.0])
    pieces = (
        Piece("core", "Core", "core", body, None, np.eye(3), (0.8, 0.8, 0.7)),
        Piece("shell_1", "Shell, 1", "shell", side.translate((0, 0, 7.5)), pull, np.eye(3), (1.0, 0.5, 0.0)),
        Piece(
            "shell_2", "Shell, 2", "shell", side.translate((0, 0, -7.5)), -pull, np.eye(3), (0.0, 0.5, 1.0)
        ),
    )
    filling = Filling(UP, np.zeros(3), empty, pull)
    return Mold(casting, core, pieces, filling, (Hardware(4, "M4 x 12 bolt"),))


def test_stl_files_are_the_pieces_in_mm(tmp_path, mold):
    pieces = [printable(piece) for piece in mold.pieces]
    files = write_stl_files(tmp_path, pieces)
    assert [file.name for file in files] == ["core.stl", "shell_1.stl", "shell_2.stl"]
    for file, piece in zip(files, mold.pieces, strict=True):
        mesh = trimesh.load(file)
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(piece.solid.volume())


def test_3mf_has_units_names_colours_and_closed_meshes(tmp_path, mold):
    import lib3mf

    pieces = [printable(piece) for piece in mold.pieces]
    write_3mf(tmp_path / "a.3mf", "block", pieces)
    write_3mf(tmp_path / "b.3mf", "block", pieces)
    assert (tmp_path / "a.3mf").read_bytes() == (tmp_path / "b.3mf").read_bytes()
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.QueryReader("3mf").ReadFromFile(str(tmp_path / "a.3mf"))
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    meshes = model.GetMeshObjects()
    names = []
    while meshes.MoveNext():
        mesh = meshes.GetCurrentMeshObject()
        names.append(mesh.GetName())
        assert mesh.IsManifoldAndOriented()
    assert names == ["core", "shell_1", "shell_2"]
    text = zipfile.ZipFile(tmp_path / "a.3mf").read("3D/3dmodel.model").decode()
    assert 'unit="millimeter"' in text
    assert re.findall('displaycolor="(#......)', text) == ["#CCCCB2", "#FF8000", "#0080FF"]


def test_pieces_in_a_3mf_lie_beside_each_other(tmp_path, mold):
    pieces = [printable(piece) for piece in mold.pieces]
    write_3mf(tmp_path / "a.3mf", "block", pieces)
    text = zipfile.ZipFile(tmp_path / "a.3mf").read("3D/3dmodel.model").decode()
    lefts = [float(words.split()[9]) for words in re.findall('<item[^>]*transform="([^"]*)"', text)]
    gaps = [b - a - 10 for a, b in pairwise(lefts)]
    assert all(gap >= 5 for gap in gaps)


def test_glb_holds_the_pieces_drawn_apart_in_metres(tmp_path, mold):
    write_glb(tmp_path / "a.glb", mold)
    scene = trimesh.load(io.BytesIO((tmp_path / "a.glb").read_bytes()), file_type="glb")
    assert sorted(scene.geometry) == ["core", "shell_1", "shell_2"]
    ways = exploded(mold)
    for name in scene.geometry:
        place, _ = scene.graph[name]
        assert place[:3, 3] == pytest.approx(ways[name] / 1000)
    assert scene.geometry["core"].extents == pytest.approx([0.01, 0.06, 0.01])
    colour = scene.geometry["shell_1"].visual.material.baseColorFactor
    assert np.asarray(colour)[:3] == pytest.approx([255, 128, 0], abs=1)


def test_drawn_apart_no_two_pieces_share_space(mold):
    ways = exploded(mold)
    placed = [piece.solid.translate(tuple(ways[piece.name])) for piece in mold.pieces]
    shared = [(a ^ b).volume() for k, a in enumerate(placed) for b in placed[:k]]
    assert max(shared) == 0.0


def test_silicone_is_brace_gutter_and_waste_half_of_each_component(mold):
    silicone = silicone_needed(mold)
    assert silicone.brace_ml == pytest.approx(2.0)
    assert silicone.gutter_ml == pytest.approx(0.5)
    assert silicone.total_ml == pytest.approx(2.5 * 1.15)
    assert silicone.total_g == pytest.approx(2.5 * 1.15 * 1.08)
    assert silicone.component_g == pytest.approx(silicone.total_g / 2)


@pytest.mark.parametrize(("minutes", "text"), [(0.4, "0 min"), (59.4, "59 min"), (568.5, "9 h 28 min")])
def test_durations_as_people_read_them(minutes, text):
    assert hours(minutes) == text
