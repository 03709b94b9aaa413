from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh

from hilbrace.config import Config, read_config
from hilbrace.domain.limb import Surface, find_limb, limb_skin, skin_order
from hilbrace.domain.loops import loops_of
from hilbrace.domain.paint import read_paint, smoothed_paint
from hilbrace.domain.region import cut_painted
from hilbrace.domain.remesh import mesh_quality
from hilbrace.domain.rest import rest_domain
from hilbrace.errors import ConfigError, GeometryError, HilbraceError, InputError
from tests.unit.domain_body import KNEE, LEFT, domain_settings, sleeve, synthetic_body


def band(low_mm=-120.0, high_mm=130.0, side="right"):
    """Vertices of the body at heights from the knee, on one leg."""
    points = (synthetic_body().vertices - KNEE * (LEFT if side == "left" else 1.0)) * 1000.0
    return (points[:, 1] > low_mm) & (points[:, 1] < high_mm) & (np.abs(points[:, 2]) < 75.0)


def listed(tmp_path, painted):
    path = tmp_path / "paint.txt"
    path.write_text("# the brace\n" + "\n".join(map(str, np.flatnonzero(painted))) + "\n")
    return path


def painted_ply(path, painted, vertices=None):
    body = synthetic_body()
    colours = np.full((len(body.vertices), 4), 255, np.uint8)
    colours[painted] = [220, 30, 30, 255]
    mesh = trimesh.Trimesh(body.vertices, body.triangles, process=False, vertex_colors=colours)
    mesh.export(path)
    return path


def refuse(kind: type[HilbraceError], body, wanted, *words):
    with pytest.raises(kind) as caught:
        rest_domain(body, wanted)
    for word in words:
        assert word in caught.value.two_lines()


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_painted_band_becomes_a_sleeve_with_smooth_edges(tmp_path, side):
    path = listed(tmp_path, band(side=side))
    rest = rest_domain(synthetic_body(), domain_settings(side=side, painted=path, triangles=1500))
    upper, lower = (rest.surface.vertices[loop] for loop in (rest.loops.upper, rest.loops.lower))
    # Painted to about 22 mm vertices: the edge lies within one of them, and is far smoother than they are.
    assert np.abs(upper[:, 1] - 130.0).max() < 25.0
    assert np.abs(lower[:, 1] + 120.0).max() < 25.0
    assert upper[:, 1].std() < 5.0
    assert lower[:, 1].std() < 5.0
    assert not rest.loops.windows
    quality = mesh_quality(rest.surface)
    assert abs(quality.triangles / 1500 - 1.0) <= 0.03
    assert quality.min_angle_deg >= 15.0


def test_an_unpainted_island_is_a_window(tmp_path):
    body = synthetic_body()
    hole = np.linalg.norm(body.vertices - (KNEE + np.array([0.06, 0.01, 0.0])), axis=1) < 0.032
    path = listed(tmp_path, band() & ~hole)
    rest = rest_domain(body, domain_settings(side="right", painted=path, triangles=1500))
    assert len(rest.loops.windows) == 1
    assert (rest.surface.vertices[rest.loops.windows[0], 0] > 20.0).all()
    closed = rest_domain(
        body, domain_settings(side="right", painted=listed(tmp_path, band()), triangles=1500)
    )
    assert not closed.loops.windows


def test_colours_and_lists_say_the_same(tmp_path):
    count = len(synthetic_body().vertices)
    path = painted_ply(tmp_path / "paint.ply", band())
    assert np.array_equal(read_paint(path, count, "here"), band())
    assert np.array_equal(read_paint(listed(tmp_path, band()), count, "here"), band())
    (tmp_path / "commas.txt").write_text("3, 5;7 # three\n\n9")
    assert np.flatnonzero(read_paint(tmp_path / "commas.txt", 10, "here")).tolist() == [3, 5, 7, 9]


def test_paint_runs_as_heat_does():
    """On a long tube an implicit step of the painted half is ``1 - exp(-x / reach) / 2`` inside."""
    vertices, triangles = sleeve(30.0, 30.0, 300.0, around=36, along=150)
    share = smoothed_paint(Surface(vertices, triangles), vertices[:, 1] > 149.0, 20.0)
    away = np.abs(vertices[:, 1] - 149.0)
    exact = np.where(vertices[:, 1] > 149.0, 1.0 - np.exp(-away / 20.0) / 2.0, np.exp(-away / 20.0) / 2.0)
    middle = np.abs(vertices[:, 1] - 149.0) < 80.0
    assert np.abs(share - exact)[middle].max() < 0.02


def test_the_painted_border_is_cut_where_paint_and_skin_weigh_the_same():
    body = synthetic_body()
    limb = find_limb(body, "knee", "right")
    skin, order = limb_skin(body, limb), skin_order(body, limb)
    region = cut_painted(skin, limb, band()[order], 6.0)
    assert igl.euler_characteristic(region.triangles) == 0
    assert len(loops_of(region, limb).windows) == 0
    squared, *_ = igl.point_mesh_squared_distance(region.vertices, skin.vertices, skin.triangles)
    assert np.sqrt(np.max(squared)) < 3.0


def test_paint_that_is_no_sleeve_is_refused(tmp_path):
    body = synthetic_body()
    front = body.vertices[:, 0] > KNEE[0]
    wanted = lambda painted, **keys: domain_settings(  # noqa: E731
        side="right", triangles=1500, painted=listed(tmp_path, painted), **keys
    )
    refuse(GeometryError, body, wanted(band() & front), "no sleeve", "domain.painted", "all the way around")
    above_only = body.vertices[:, 1] > KNEE[1]
    refuse(GeometryError, body, wanted(above_only), "domain.painted")
    refuse(GeometryError, body, wanted(band(side="left")), "domain.painted")
    refuse(ConfigError, body, wanted(band(), above=0.3), "domain.painted and domain.above")


def test_files_that_are_no_paint_are_refused(tmp_path):
    body = synthetic_body()
    wanted = lambda name: domain_settings(side="right", painted=tmp_path / name)  # noqa: E731
    refuse(InputError, body, wanted("none.txt"), "no such file", "domain.painted")
    refuse(InputError, body, wanted("skin.obj"), "'.obj'", "PLY")
    (tmp_path / "far.txt").write_text("1\n2 999999\n")
    refuse(InputError, body, wanted("far.txt"), "'999999'", "line 2")
    (tmp_path / "word.txt").write_text("one")
    refuse(InputError, body, wanted("word.txt"), "'one'", "line 1")
    (tmp_path / "empty.txt").write_text("# nothing\n")
    refuse(InputError, body, wanted("empty.txt"), "nothing is painted")
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 9\n")
    refuse(InputError, body, wanted("broken.ply"), "no readable PLY")
    trimesh.Trimesh(body.vertices, body.triangles, process=False).export(tmp_path / "plain.ply")
    refuse(InputError, body, wanted("plain.ply"), "no vertex colours", "MeshLab")
    other = trimesh.creation.icosphere(subdivisions=1)
    other = trimesh.Trimesh(other.vertices, other.faces, vertex_colors=[255, 0, 0, 255])
    other.export(tmp_path / "other.ply")
    refuse(InputError, body, wanted("other.ply"), f"{len(other.vertices)} vertices", "this body")


def test_paint_lies_beside_the_configuration(tmp_path):
    (tmp_path / "run.toml").write_text(
        '[domain]\npainted = "brace.ply"\nreliefs = [{painted = "spots.txt", height_mm = 3.0}]\n'
    )
    config: Config = read_config(tmp_path / "run.toml")
    assert config.domain.painted == (tmp_path / "brace.ply").resolve()
    assert config.domain.reliefs[0].painted == (tmp_path / "spots.txt").resolve()
