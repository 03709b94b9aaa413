"""Castings of runs: the brace enlarged, and the limb's surface under it and beyond its edges."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import igl
import numpy as np
import pytest
from scipy.spatial import KDTree

from fabrication.casting import axes_of, casting_of, casting_of_run, centre_of
from fabrication.core import build_core
from fabrication.limb import Limb, centreline, with_windows_filled
from fabrication.mold import Casting
from fabrication.sheet import Sheet, loop_normal, prolonged, rim_of
from hilbrace.config import MaterialSettings, MoldSettings, PatternSettings, SolidSettings
from hilbrace.errors import GeometryError, InputError
from hilbrace.pattern.build import build_pattern, build_solid
from hilbrace.pattern.offset import area_ratio
from hilbrace.pattern.thicken import border_edges
from hilbrace.run.records import save
from tests.unit.sleeve import sleeve_design, sleeve_domain

PATTERN = PatternSettings(resolution_mm=1.6, min_strut_mm=3.0, period_mm=40.0)
MATERIAL = MaterialSettings()
SETTINGS = MoldSettings()


@cache
def records():
    domain = sleeve_domain(around=40, along=10, height_mm=90.0)
    design = sleeve_design(domain, PATTERN)
    pattern = build_pattern(domain, design, PATTERN, MATERIAL)
    return domain, pattern, build_solid(pattern, domain, design, MATERIAL, SolidSettings())


@cache
def casting(shrinkage_percent: float = 0.1) -> Casting:
    settings = MoldSettings(shrinkage_percent=shrinkage_percent)
    return casting_of("serve", *records(), settings)


def area_vectors(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    p = points[triangles]
    return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) / 2


def test_name_and_side_come_from_the_records():
    made = casting()
    assert (made.name, made.joint, made.side) == ("serve-knee-L", "knee", "left")
    assert made.covered is not None
    assert not made.flat


@pytest.mark.parametrize("percent", [0.0, 0.1, 2.0])
def test_shrinking_by_what_it_was_enlarged_gives_the_brace_back(percent):
    made, (_, _, solid) = casting(percent), records()
    back = 1 - percent / 100
    assert made.brace.volume() * back**3 == pytest.approx(solid.volume_mm3, rel=1e-9)
    assert made.thickness_mm * back == pytest.approx(solid.thickness_mm)
    assert (1 + made.shrinkage) * back == pytest.approx(1.0)
    centre = centre_of(solid.vertices, solid.triangles)
    mesh = made.brace.to_mesh64()
    assert centre_of(mesh.vert_properties[:, :3], mesh.tri_verts.astype(int)) == pytest.approx(
        centre, abs=1e-6
    )


def test_covered_part_is_the_pattern_and_all_of_it():
    made, (_, pattern, _) = casting(0.0), records()
    own = made.triangles[made.covered]
    assert made.vertices[own] == pytest.approx(pattern.vertices[pattern.triangles])
    assert (made.beyond[made.covered] == 0).all()


def test_sheet_is_one_tube_whose_ends_are_planes_across_the_axis():
    made = casting()
    rim = border_edges(made.triangles)
    level = made.outer[rim[:, 0]] @ made.up
    assert made.down == pytest.approx(-made.up)
    assert set(np.round(level, 6)) == {round(level.min(), 6), round(level.max(), 6)}
    flat = made.vertices[rim[:, 0]] @ made.up
    assert flat == pytest.approx(level, abs=1e-9)
    steps = made.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(steps, axis=0)) == len(steps)


def test_parts_beyond_the_edges_are_as_long_as_asked_and_have_no_undercut():
    made = casting()
    for end, length in ((-1, SETTINGS.foot_mm), (1, SETTINGS.gutter_mm)):
        own = made.triangles[made.beyond == end]
        way = made.up if end == 1 else made.down
        level = made.outer[own] @ way
        rest = made.outer[made.triangles[made.beyond == 0]] @ way
        assert level.max() == pytest.approx(rest.max() + length)
        area = area_vectors(made.outer, own)
        slope = area @ way / np.linalg.norm(area, axis=1)
        assert np.abs(slope).max() < 1e-9


def test_outer_face_turns_no_triangle_over():
    made = casting()
    assert area_ratio(made.vertices, made.triangles, made.outer - made.vertices).min() > 0


def test_outer_face_is_flat_over_each_triangle_of_the_domain():
    """Thousands of small triangles are a few thousand facets: the shells' inner face is light."""
    made = casting()
    land = build_core(made, SETTINGS).land
    domain = records()[0]
    assert land.num_tri() < 2.5 * len(domain.triangles) < len(made.triangles) / 4


def test_grooves_of_a_run_hold_its_brace():
    made = casting()
    core = build_core(made, SETTINGS)
    grooves = core.land.volume() - core.solid.volume() - core.gutter.volume()
    assert grooves == pytest.approx(made.brace.volume(), rel=2e-3)
    assert (core.solid - core.land).volume() < 0.1
    assert core.solid.genus() == 0


def test_a_run_folder_is_read(tmp_path):
    domain, pattern, solid = records()
    for name, record in (("domain", domain), ("pattern", pattern), ("solid", solid)):
        (tmp_path / name).mkdir()
        save(record, tmp_path / name / f"{name}.npz")
    (tmp_path / "run.toml").write_text('[motion]\nmarkers = "jump 3.c3d"\n')
    made = casting_of_run(tmp_path, SETTINGS)
    assert made.name == "jump_3-knee-L"
    assert made.brace.volume() == pytest.approx(casting().brace.volume())
    none = np.zeros((0, 3))
    old = replace(pattern, land_vertices=none, land_triangles=none.astype(int))
    save(old, tmp_path / "pattern" / "pattern.npz")
    with pytest.raises(InputError, match="no skin between its struts"):
        casting_of_run(tmp_path, SETTINGS)
    save(pattern, tmp_path / "pattern" / "pattern.npz")
    save(replace(solid, parts=2), tmp_path / "solid" / "solid.npz")
    with pytest.raises(GeometryError, match="no single closed body: 2 parts"):
        casting_of_run(tmp_path, SETTINGS)
    (tmp_path / "solid" / "solid.npz").unlink()
    with pytest.raises(InputError, match="no such record"):
        casting_of_run(tmp_path, SETTINGS)


def test_struts_finer_than_the_printer_are_refused():
    domain, pattern, solid = records()
    fine = replace(pattern, strut_width_min_mm=0.6)
    with pytest.raises(GeometryError, match=r"only 0\.60 mm thick somewhere, and Prusa MK4"):
        casting_of("x", domain, fine, solid, SETTINGS)
    casting_of("x", domain, fine, solid, MoldSettings(printer="formlabs_form3"))


def test_struts_of_another_domain_are_refused():
    domain, pattern, solid = records()
    with pytest.raises(GeometryError, match="do not lie on the domain"):
        casting_of("x", replace(domain, vertices=1.02 * domain.vertices), pattern, solid, SETTINGS)


def test_core_stands_on_one_axis_but_for_an_ankle():
    y, x = np.array([0.0, 1, 0]), np.array([1.0, 0, 0])
    down, up = axes_of(-y, y, y)
    assert (down, up) == (pytest.approx(-y), pytest.approx(y))
    tilted = np.array([0.4, -1, 0]) / np.sqrt(1.16)
    down, up = axes_of(tilted, y, np.array([0.1, 1, 0]))
    assert down == pytest.approx(-up)
    assert 0.9 < up @ y < 1
    ankle = axes_of(x, y, np.array([-95.0, 205, 0]))
    assert ankle == (pytest.approx(x), pytest.approx(y))


def ball(rows: int, radius: float = 60.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sphere of rings without its caps: vertices, triangles, the lower ring."""
    turn = np.arange(48) / 48 * 2 * np.pi
    height = np.linspace(-0.85, 0.95, rows)
    wide = np.sqrt(1 - height**2)[:, None]
    points = radius * np.stack(
        [wide * np.cos(turn), np.broadcast_to(height[:, None], (rows, 48)), -wide * np.sin(turn)], axis=-1
    )
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(48), indexing="ij")
    a, b = i * 48 + j, i * 48 + (j + 1) % 48
    triangles = np.stack([np.stack([a, b, b + 48], -1), np.stack([a, b + 48, a + 48], -1)], axis=2)
    return points.reshape(-1, 3), triangles.reshape(-1, 3), np.arange(48)


def test_a_window_is_filled_as_the_skin_around_it_goes_on():
    """A cap of a sphere is filled to within 2 % of its radius; a flat lid would miss it by 15 %."""
    points, triangles, _ = ball(24)
    rim = rim_of(triangles)
    window = rim.walk(0, 0)[:-1]
    limb = Limb(points, points / 15.0, triangles, np.zeros(len(triangles), dtype=bool))
    whole = with_windows_filled(limb, (window,))
    new = slice(len(points), None)
    assert np.linalg.norm(whole.vertices[new], axis=1) == pytest.approx(60.0, abs=1.5)
    assert np.linalg.norm(whole.vector[new], axis=1) == pytest.approx(4.0, abs=0.15)
    assert whole.filled.sum() > 50
    assert len(border_edges(whole.triangles)) == 48
    volume = area_vectors(whole.vertices, whole.triangles)
    middle = whole.vertices[whole.triangles].mean(axis=1)
    assert (np.einsum("tx,tx->t", volume, middle) > 0).all()
    known = np.arange(len(points))
    assert whole.vertices[known] == pytest.approx(points)


def test_a_window_whose_edge_crosses_itself_is_refused():
    points, triangles, _ = ball(12)
    window = rim_of(triangles).walk(0, 0)[:-1]
    points[window[5]], points[window[9]] = points[window[9]].copy(), points[window[5]].copy()
    limb = Limb(points, points / 15.0, triangles, np.zeros(len(triangles), dtype=bool))
    with pytest.raises(GeometryError, match=r"window 1 .* crosses itself"):
        with_windows_filled(limb, (window,))


def test_core_has_a_land_over_a_window():
    """The window's cap joins the rim around it, edge by finely divided edge."""
    whole = sleeve_domain(around=30, along=6, height_mm=60.0)
    middle = whole.vertices[whole.triangles].mean(axis=1)
    front = np.argsort(np.linalg.norm(middle - [70, 0, 0], axis=1))
    corner = whole.triangles[front[0], 0]
    ring = whole.triangles[front[0]][whole.triangles[front[0]] != corner]
    hole = np.isin(whole.triangles, [*ring, corner]).sum(axis=1) == 3
    hole |= (np.isin(whole.triangles, ring).sum(axis=1) == 2) & ~np.isin(whole.triangles, corner).any(axis=1)
    loop = rim_of(whole.triangles[hole]).walk(int(corner), int(corner))[-2::-1]
    design = sleeve_design(whole, PATTERN)
    domain = replace(
        whole,
        triangles=whole.triangles[~hole],
        cut_triangles=whole.cut_triangles[~hole],
        deformation=whole.deformation[:, ~hole],
        quasi_conformal=whole.quasi_conformal[~hole],
        windows=np.stack([np.zeros(len(loop), dtype=np.int64), loop], axis=1),
    )
    per_triangle = {
        name: value[..., ~hole]
        for name, value in vars(design).items()
        if isinstance(value, np.ndarray) and value.shape[-1:] == hole.shape
    }
    design = replace(design, **per_triangle)
    pattern = build_pattern(domain, design, PATTERN, MATERIAL)
    solid = build_solid(pattern, domain, design, MATERIAL, SolidSettings())
    made = casting_of("x", domain, pattern, solid, SETTINGS)
    assert len(border_edges(pattern.triangles)) > 0
    assert len(igl.boundary_loop_all(made.triangles)) == 2
    core = build_core(made, SETTINGS)
    assert core.solid.genus() == 0
    grooves = core.land.volume() - core.solid.volume() - core.gutter.volume()
    assert grooves == pytest.approx(made.brace.volume(), rel=2e-3)


def test_centreline_follows_a_bent_tube():
    """A quarter of a torus: the sections' middles lie on its circle."""
    bend, turn = np.linspace(0, np.pi / 2, 30), np.arange(36) / 36 * 2 * np.pi
    ring = 100 + 30 * np.cos(turn)
    points = np.stack(
        [
            ring * np.cos(bend)[:, None],
            ring * np.sin(bend)[:, None],
            np.broadcast_to(30 * np.sin(turn), (30, 36)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(29), np.arange(36), indexing="ij")
    a, b = i * 36 + j, i * 36 + (j + 1) % 36
    triangles = np.stack([np.stack([a, b, b + 36], -1), np.stack([a, b + 36, a + 36], -1)], axis=2).reshape(
        -1, 3
    )
    line = centreline(points, triangles, np.arange(36), 29 * 36 + np.arange(36))
    assert np.hypot(line[:, 0], line[:, 1]) == pytest.approx(100, abs=2.0)
    assert line[:, 2] == pytest.approx(0, abs=0.1)
    assert np.diff(np.arctan2(line[:, 1], line[:, 0])).min() > 0
    assert line[[0, -1]] == pytest.approx(np.array([[100.0, 0, 0], [0, 100, 0]]), abs=0.1)


def test_a_prolonged_edge_ends_in_a_plane_and_keeps_its_outline():
    points, triangles, _ = ball(8)
    vector = 4 * points / 60
    none = np.zeros(len(triangles), dtype=int)
    sheet = Sheet(points, vector, triangles, none > 0, none)
    line = rim_of(triangles).walk(0, 0)
    way = np.array([0.2, -1.0, 0]) / np.sqrt(1.04)
    longer = prolonged(sheet, line, way, 10.0, -1)
    end = np.setdiff1d(rim_of(longer.triangles).vertices, np.arange(len(points)))
    wanted = (sheet.outer[line] @ way).max() + 10
    assert longer.outer[end] @ way == pytest.approx(wanted)
    assert longer.vertices[end] @ way == pytest.approx(wanted)
    across = longer.outer - np.outer(longer.outer @ way, way)
    away = KDTree(across[line]).query(across[longer.triangles[longer.beyond == -1]].reshape(-1, 3))[0]
    assert away.max() < 1e-9
    assert np.linalg.norm(longer.vector, axis=1) == pytest.approx(4.0)
    assert -loop_normal(longer.outer[end]) @ way > 0.99 or loop_normal(longer.outer[end]) @ way > 0.99
