import json
import subprocess
import sys

import cadquery
import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.fixtures import Place, keys
from fabrication.fixtures.bake import everyday_parts
from fabrication.fixtures.bolt import bolt_hole
from fabrication.fixtures.cad import (
    Part,
    Placed,
    shipped_parts,
    tessellate,
    tessellated,
    union,
    weld,
    write_parts,
    write_step,
)
from fabrication.fixtures.key import placed_keys
from fabrication.fixtures.stand import base_plate
from hilbrace.config import MoldSettings
from hilbrace.errors import GeometryError


def cylinder(radius, height):
    return cadquery.Workplane("XY").circle(radius).extrude(height)


def opened(size):
    return cadquery.Workplane("XY").box(size, size, size).faces(">Z")


@pytest.mark.parametrize("radius", [1.0, 5.0, 50.0])
def test_round_bodies_lose_what_an_inscribed_polygon_loses(radius):
    body = Part(cylinder, (radius, 10.0)).body()
    outline = body.project()
    area, sides = outline.area(), outline.num_vert()
    assert sides >= 2 * np.pi / 0.1
    assert area == pytest.approx(0.5 * sides * radius**2 * np.sin(2 * np.pi / sides), rel=1e-9)
    assert 0 < 1 - area / (np.pi * radius**2) < 0.1**2 / 6


def test_faces_are_welded_into_one_closed_body():
    vertices, triangles = tessellate(cadquery.Workplane("XY").box(1, 2, 3).val())
    assert len(vertices) == 24
    body = weld(vertices, triangles)
    assert body.num_vert() == 8
    assert body.volume() == pytest.approx(6)


def test_what_does_not_close_is_refused_by_name():
    with pytest.raises(GeometryError) as caught:
        tessellated(Part(opened, (2.0,)))
    assert "opened 2" in str(caught.value)


def test_the_parts_that_ship_are_those_that_are_drawn():
    shipped, wanted = shipped_parts(), {part.key: part for part in everyday_parts()}
    assert set(shipped) == set(wanted)
    for key in [*list(wanted)[::9], "bolt_hole 4 6 0.2", "core_socket 20 0.2"]:
        fresh = weld(*tessellate(wanted[key].shape()), name=key)
        again = tessellated(wanted[key])
        assert again.volume() == pytest.approx(fresh.volume(), rel=1e-9)
        assert again.num_tri() == fresh.num_tri()
        np.testing.assert_allclose(again.bounding_box(), fresh.bounding_box(), atol=1e-9)


def test_every_part_that_ships_is_one_solid_body():
    for part in everyday_parts():
        body = part.body()
        assert body.volume() > 0
        assert len(body.decompose()) == (2 if part.key == "letter 0" else 1), part.key


def test_default_fixtures_do_without_cadquery():
    code = """
import json, sys
import numpy as np
from fabrication.fixtures import Place, bolts, jack_slots, keys, label, luer_port
from hilbrace.config import MoldSettings
x, y, z = np.eye(3)
place = Place(x, y, z, ("a", "b"), 6.0)
bolts([place], MoldSettings()), keys([place], MoldSettings()), jack_slots([place])
luer_port(x, y, 6.0), label("CORE L \\u2191", x, y, z, 8.0)
print(json.dumps([name for name in ("cadquery", "casadi", "OCP", "opensim") if name in sys.modules]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == []


def test_parts_survive_being_written(tmp_path):
    parts = [Part(cylinder, (2.0, 3.0)), Part(bolt_hole, (4.0, 7.0, 0.2))]
    write_parts(tmp_path / "parts.npz", parts)
    write_parts(tmp_path / "again.npz", parts)
    assert (tmp_path / "parts.npz").read_bytes() == (tmp_path / "again.npz").read_bytes()
    with np.load(tmp_path / "parts.npz") as arrays:
        assert list(arrays["keys"]) == ["cylinder 2 3", "bolt_hole 4 7 0.2"]
        assert arrays["vertex_ends"][-1] == len(arrays["vertices"])


def test_step_holds_every_part_at_its_place_and_the_same_bytes_each_time(tmp_path):
    place = Place(np.array([10.0, 20, 30]), np.array([0, 0.6, 0.8]), np.array([1.0, 0, 0]), ("a", "b"), 6.0)
    plate = Placed("base_plate", Part(base_plate, (60.0,)), place.frame)
    placed = (plate, *placed_keys([place, place], MoldSettings()))
    write_step(tmp_path / "a.step", placed)
    write_step(tmp_path / "b.step", placed)
    content = (tmp_path / "a.step").read_bytes()
    assert content == (tmp_path / "b.step").read_bytes()
    text = content.decode("ascii")
    assert all(f"'{name}'" in text for name in ("base_plate_1", "key_1", "key_2", "socket_2"))
    assert "SI_UNIT(.MILLI.,.METRE.)" in text
    solids = cadquery.importers.importStep(str(tmp_path / "a.step")).solids().vals()
    assert len(solids) == len(placed)
    read = np.array([solid.Center().toTuple() for solid in solids])
    volumes = np.array([solid.Volume() for solid in solids])
    exact = np.array([item.part.shape().Volume() for item in placed])
    np.testing.assert_allclose(np.sort(volumes), np.sort(exact), rtol=1e-9)
    biggest = int(np.argmax(volumes))
    middle = np.reshape(plate.body().bounding_box(), (2, 3)).mean(axis=0)
    np.testing.assert_allclose(read[biggest], middle, atol=1e-2)


def test_a_placed_part_is_its_body_moved():
    adders, _ = keys([Place(*np.eye(3), ("a", "b"), 6.0)], MoldSettings())
    pin, _ = placed_keys([Place(*np.eye(3), ("a", "b"), 6.0)], MoldSettings())
    assert pin.body().volume() == pytest.approx(adders["a"].volume())
    assert union([]).is_empty()
    assert isinstance(union([Manifold.cube((1, 1, 1))]), Manifold)
