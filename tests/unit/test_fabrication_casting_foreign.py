"""Braces from files: laid on limb or ground and cut out whole; what is wrong is named."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold
from scipy.spatial.transform import Rotation

from fabrication.bodies import body_of, mesh_of
from fabrication.casting import casting_of_stl
from fabrication.core import build_core
from fabrication.foreign_brace import UNITS, Mesh, check_apart, open_edges
from fabrication.foreign_sheet import flat_normal
from fabrication.halving import refined
from fabrication.mold import Casting
from fabrication.sheet import rim_of
from fabrication.sleeve_axis import span_of, tube_axis
from hilbrace.config import MoldSettings
from hilbrace.errors import GeometryError, InputError
from hilbrace.pattern.export import stl_bytes
from hilbrace.pattern.thicken import border_edges
from tests.unit.mold_cases import bent_tube, flat_coupon

SETTINGS = MoldSettings(resolution_mm=1.4)


@cache
def tube() -> Casting:
    return bent_tube()


@cache
def coupon() -> Casting:
    return flat_coupon()


def written(folder: Path, name: str, points: np.ndarray, triangles: np.ndarray) -> Path:
    path = folder / name
    path.write_bytes(stl_bytes(np.ascontiguousarray(points), np.ascontiguousarray(triangles)))
    return path


def brace_file(folder: Path, body: Manifold, factor: float = 1.0) -> Path:
    points, triangles = mesh_of(body)
    return written(folder, "brace.stl", points * factor, triangles)


def check_mold(casting: Casting, rel: float = 2e-3) -> None:
    """Grooves as large as the brace, one room, no film over a groove, everything within the land."""
    core = build_core(casting, SETTINGS)
    grooves = core.land.volume() - core.solid.volume() - core.gutter.volume()
    assert grooves == pytest.approx(casting.brace.volume(), rel=rel)
    rooms = [room for room in (core.land - core.solid).decompose() if room.volume() > 1.0]
    assert len(rooms) == 1
    assert core.solid.genus() == 0
    assert (core.solid - core.land).volume() < 0.01
    missing = casting.brace - (core.land - core.solid)
    assert missing.volume() < 0.02 * casting.brace.volume()


def test_a_sleeve_on_its_limb(tmp_path):
    limb = written(tmp_path, "limb.stl", tube().vertices, tube().triangles)
    made = casting_of_stl(brace_file(tmp_path, tube().brace), limb, SETTINGS)
    assert (made.name, made.joint, made.side, made.flat, made.covered) == ("brace", "", "", False, None)
    assert made.repairs == ()
    assert made.thickness_mm == pytest.approx(4.0, rel=0.01)
    assert made.up == pytest.approx([0, 1, 0], abs=0.03)
    assert made.brace.volume() == pytest.approx(tube().brace.volume() / 0.999**3, rel=1e-6)
    check_mold(made)
    middle = made.centreline[len(made.centreline) // 2]
    assert middle[[0, 2]] == pytest.approx([8, 0], abs=1.0)


def test_a_closed_limb_is_cut_where_the_brace_ends(tmp_path):
    points, triangles = tube().vertices, tube().triangles
    rim = rim_of(triangles)
    for start in (int(rim.vertices[0]), int(rim.vertices[-1])):
        loop = rim.walk(start, start)
        cap = np.stack([loop[1:], loop[:-1], np.full(len(loop) - 1, len(points))], axis=1)
        points = np.concatenate([points, points[loop].mean(axis=0, keepdims=True)])
        triangles = np.concatenate([triangles, cap])
    assert len(open_edges(triangles)) == 0
    limb = written(tmp_path, "limb.stl", points, triangles)
    made = casting_of_stl(brace_file(tmp_path, tube().brace), limb, SETTINGS)
    assert made.repairs == ()
    check_mold(made)


def test_a_short_limb_is_prolonged_by_name(tmp_path):
    straight = bent_tube(bend_mm=0.0)
    high = straight.vertices[straight.triangles].mean(axis=1)[:, 1]
    own = straight.triangles[np.abs(high) < 39]
    limb = written(tmp_path, "limb.stl", straight.vertices, own)
    made = casting_of_stl(brace_file(tmp_path, straight.brace), limb, SETTINGS)
    assert any("mm before its brace and was prolonged" in repair for repair in made.repairs)
    check_mold(made, rel=5e-3)
    own = straight.triangles[np.abs(high) < 25]
    limb = written(tmp_path, "limb.stl", straight.vertices, own)
    with pytest.raises(GeometryError, match=r"the limb ends \d+ mm before its brace does"):
        casting_of_stl(brace_file(tmp_path, straight.brace), limb, SETTINGS)


def test_a_sleeve_without_limb_is_cast_on_its_own_inner_face(tmp_path):
    made = casting_of_stl(brace_file(tmp_path, tube().brace), None, SETTINGS)
    assert "no limb was given" in made.repairs[0]
    check_mold(made, rel=5e-3)


@pytest.mark.parametrize("known", [True, False])
def test_a_brace_with_an_open_seam(tmp_path, known):
    gap = Manifold.cube((60.0, 200.0, 14.0), True).translate((-35.0, 0.0, 0.0))
    limb = written(tmp_path, "limb.stl", tube().vertices, tube().triangles) if known else None
    body = bent_tube(strut_mm=40.0).brace - gap
    made = casting_of_stl(brace_file(tmp_path, body), limb, SETTINGS)
    check_mold(made, rel=5e-3)
    probe = Manifold.sphere(1.0).translate((-31.5, 35.0, 0.0))
    assert (build_core(made, SETTINGS).solid ^ probe).volume() > 0.9 * probe.volume()


def test_a_leaning_rim_opens_all_around_onto_the_gutter(tmp_path):
    cut = tube().brace.trim_by_plane((-0.03, -1.0, 0.0), -40.0)
    made = casting_of_stl(brace_file(tmp_path, cut), None, SETTINGS)
    check_mold(made, rel=5e-3)
    core = build_core(made, SETTINGS)
    rim = core.upper
    height = (40.0 - 0.03 * rim[:, 0]) - rim[:, 1]
    assert np.abs(height - height.mean()).max() < 1.5


def test_a_coupon_on_its_ground(tmp_path):
    made = casting_of_stl(brace_file(tmp_path, coupon().brace), None, SETTINGS)
    assert made.flat
    assert made.repairs == ()
    assert made.up == pytest.approx([0, 1, 0], abs=1e-6)
    assert made.thickness_mm == pytest.approx(4 / 0.999)
    check_mold(made, rel=1e-3)
    assert set(np.unique(made.beyond)) == {-1, 0, 1, 2}
    core = build_core(made, SETTINGS)
    assert np.ptp(core.upper[:, 0]) == pytest.approx(50 / 0.999, abs=0.1)


@settings(max_examples=5)
@given(seed=st.integers(0, 10_000))
def test_a_coupon_may_lie_anyhow(tmp_path_factory, seed):
    turn = Rotation.random(rng=seed).as_matrix()
    points, triangles = mesh_of(coupon().brace)
    path = written(tmp_path_factory.mktemp("any"), "brace.stl", points @ turn.T + [5, -80, 30], triangles)
    made = casting_of_stl(path, None, SETTINGS)
    assert abs(made.up @ turn[:, 1]) == pytest.approx(1.0, abs=1e-4)
    check_mold(made, rel=1e-3)


@pytest.mark.parametrize("unit", ["in", "m"])
def test_other_units_are_told_from_the_size_and_named(tmp_path, unit):
    path = brace_file(tmp_path, coupon().brace, 1 / UNITS[unit])
    made = casting_of_stl(path, None, SETTINGS)
    assert made.repairs[0].startswith(f"the file was read in {unit}: ")
    assert made.repairs[0].endswith("makes 70 mm")
    assert made.brace.volume() == pytest.approx(coupon().brace.volume() / 0.999**3, rel=1e-4)
    said = casting_of_stl(path, None, SETTINGS, units=unit)
    assert said.repairs == ()
    assert said.brace.volume() == pytest.approx(made.brace.volume())


def test_a_limb_is_in_the_unit_of_its_brace(tmp_path):
    limb = written(tmp_path, "limb.stl", tube().vertices / 25.4, tube().triangles)
    made = casting_of_stl(brace_file(tmp_path, tube().brace, 1 / 25.4), limb, SETTINGS)
    assert [repair[:20] for repair in made.repairs] == ["the file was read in"]
    assert made.thickness_mm == pytest.approx(4.0, rel=0.01)


def test_a_size_that_no_unit_explains_is_refused(tmp_path):
    path = brace_file(tmp_path, coupon().brace.scale((0.5, 0.5, 0.005)), 30.0)
    with pytest.raises(InputError, match="the unit of the brace cannot be told") as caught:
        casting_of_stl(path, None, SETTINGS)
    assert "--units mm|cm|in|m" in caught.value.hint


def test_an_open_brace_is_refused_with_the_place(tmp_path):
    points, triangles = mesh_of(coupon().brace)
    flat = np.ptp(points[triangles][..., 2], axis=1) < 1e-9
    open_ = triangles[~(flat & (points[triangles][..., 2].max(axis=1) > 3.9))]
    with pytest.raises(GeometryError, match=r"not closed: \d+ open edges, one near \("):
        casting_of_stl(written(tmp_path, "brace.stl", points, open_), None, SETTINGS)


def test_small_holes_are_closed_by_name(tmp_path):
    points, triangles = mesh_of(coupon().brace.refine_to_length(1.5))
    made = casting_of_stl(written(tmp_path, "brace.stl", points, triangles[1:]), None, SETTINGS)
    assert made.repairs == ("1 small holes were closed",)
    assert made.brace.volume() == pytest.approx(coupon().brace.volume() / 0.999**3, rel=1e-5)


def test_needles_between_unjoined_vertices_are_joined_by_name(tmp_path):
    points, triangles = mesh_of(coupon().brace)
    corners = points[triangles].reshape(-1, 3)
    corners += np.random.default_rng(0).uniform(-1e-3, 1e-3, corners.shape)
    path = written(tmp_path, "brace.stl", corners, np.arange(len(corners)).reshape(-1, 3))
    made = casting_of_stl(path, None, SETTINGS)
    assert any("open edges were joined" in repair for repair in made.repairs)
    assert made.brace.volume() == pytest.approx(coupon().brace.volume() / 0.999**3, rel=1e-3)


def test_triangles_facing_inwards_are_turned_by_name(tmp_path):
    points, triangles = mesh_of(coupon().brace)
    triangles = triangles.copy()
    triangles[::3] = triangles[::3, ::-1]
    made = casting_of_stl(written(tmp_path, "brace.stl", points, triangles), None, SETTINGS)
    assert made.repairs == (f"{len(triangles[::3])} triangles that faced inwards were turned",)
    inside_out = written(tmp_path, "brace.stl", points, mesh_of(coupon().brace)[1][:, ::-1])
    assert len(casting_of_stl(inside_out, None, SETTINGS).repairs) == 1


def test_bodies_that_overlap_are_united_and_others_refused(tmp_path):
    points, triangles = mesh_of(coupon().brace)
    bar, faces = mesh_of(Manifold.cube((60, 6, 4)).translate((-30, -4, 0)))
    both = np.concatenate([points, bar]), np.concatenate([triangles, faces + len(points)])
    made = casting_of_stl(written(tmp_path, "brace.stl", *both), None, SETTINGS)
    assert made.repairs == ("2 bodies that overlap were made one",)
    wanted = coupon().brace + Manifold.cube((60, 6, 4)).translate((-30, -4, 0))
    assert made.brace.volume() == pytest.approx(wanted.volume() / 0.999**3, rel=1e-5)
    check_mold(made)
    apart = np.concatenate([points, bar - [0, 20, 0]]), both[1]
    with pytest.raises(GeometryError, match="2 bodies apart from each other"):
        casting_of_stl(written(tmp_path, "brace.stl", *apart), None, SETTINGS)


def test_a_brace_that_runs_through_itself_is_refused(tmp_path):
    """A bar bent around by more than a turn: closed, manifold, one part, and wrong."""
    bar = Manifold.cube((220.0, 20.0, 4.0)).refine_to_length(3.0)
    points, triangles = mesh_of(bar)
    turn = points[:, 0] / 220 * (2 * np.pi + 0.4)
    radius = 33 + points[:, 2]
    bent = np.stack([radius * np.cos(turn), points[:, 1], -radius * np.sin(turn)], axis=1)
    assert len(open_edges(triangles)) == 0
    assert body_of(bent, triangles).volume() > 0
    with pytest.raises(GeometryError, match=r"runs through itself, near \("):
        casting_of_stl(written(tmp_path, "brace.stl", bent, triangles), None, SETTINGS)


def test_a_brace_that_touches_itself_is_refused(tmp_path):
    """Faces that lie on each other, and edges that meet."""
    slot = Manifold.cube((60.0, 60.0, 4.0)) - Manifold.cube((40.0, 10.0, 6.0)).translate((30.0, 25.0, -1.0))
    points, triangles = mesh_of(slot)
    closed = points.copy()
    arm = (points[:, 0] > 29) & (np.abs(points[:, 1] - 30) < 5.1)
    closed[arm & (points[:, 0] > 59), 1] = 30.0
    with pytest.raises(GeometryError, match="touches itself"):
        casting_of_stl(written(tmp_path, "brace.stl", closed, triangles), None, SETTINGS)
    with pytest.raises(GeometryError, match="touches itself"):
        check_apart(Mesh(*_pressed(points, triangles)), "here")


def _pressed(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The slot's walls pressed onto each other along its whole length."""
    pressed = points.copy()
    pressed[(np.abs(points[:, 1] - 30) < 5.1) & (points[:, 0] > 29), 1] = 30.0
    return pressed, triangles


def test_a_brace_thinner_than_the_printer_prints_is_refused(tmp_path):
    thin = flat_coupon(thickness_mm=0.6)
    path = brace_file(tmp_path, thin.brace)
    with pytest.raises(GeometryError, match=r"only 0\.60 mm thick somewhere"):
        casting_of_stl(path, None, SETTINGS)
    sla = SETTINGS.model_copy(update={"printer": "formlabs_form3"})
    try:
        casting_of_stl(path, None, sla)
    except GeometryError as error:
        pytest.fail(f"0.6 mm prints in resin: {error}")


def test_a_thin_rib_among_thick_ones_is_refused(tmp_path):
    rib = Manifold.cube((40.0, 0.5, 4.0)).translate((-20.0, 17.0, 0.0))
    with pytest.raises(GeometryError, match=r"only 0\.50 mm thick somewhere"):
        casting_of_stl(brace_file(tmp_path, coupon().brace + rib), None, SETTINGS)


def test_shells_follow_a_thickness_that_changes_slowly(tmp_path):
    points, triangles = mesh_of(coupon().brace.refine_to_length(3.0))
    wedge = points * np.stack([np.ones(len(points)), np.ones(len(points)), 0.8 + points[:, 1] / 175], axis=1)
    made = casting_of_stl(written(tmp_path, "brace.stl", wedge, triangles), None, SETTINGS)
    assert made.repairs[-1] == "the brace is 3.20 to 4.80 mm thick; the shells follow its outer face"
    check_mold(made)


def test_a_boss_on_the_brace_is_refused(tmp_path):
    boss = Manifold.cylinder(12.0, 2.6, 2.6, 48).translate((-22.35, 35.0, 0.0))
    with pytest.raises(
        GeometryError, match=r"not even: it stands 8\.0 mm out of its outer face near \(-2\d, 3\d, 12\)"
    ):
        casting_of_stl(brace_file(tmp_path, coupon().brace + boss), None, SETTINGS)


def test_a_limb_elsewhere_or_with_a_hole_is_refused(tmp_path):
    brace = brace_file(tmp_path, tube().brace)
    for moved, message in (
        (tube().vertices + np.array([0, 300, 0]), r"the limb is no tube in its brace|ends \d+ mm before"),
        (tube().vertices + np.array([150, 0, 0]), "does not lie on its limb|no part of it is found|not even"),
    ):
        limb = written(tmp_path, "limb.stl", moved, tube().triangles)
        with pytest.raises(GeometryError, match=message):
            casting_of_stl(brace, limb, SETTINGS)
    middle = tube().vertices[tube().triangles].mean(axis=1)
    holed = tube().triangles[np.linalg.norm(middle - [38, 0, 0], axis=1) > 10]
    with pytest.raises(GeometryError, match="no tube in its brace, but a surface with 3 open ends"):
        casting_of_stl(brace, written(tmp_path, "limb.stl", tube().vertices, holed), SETTINGS)


def test_what_is_neither_flat_nor_a_sleeve_is_refused(tmp_path):
    with pytest.raises(GeometryError, match="neither flat nor a sleeve"):
        casting_of_stl(brace_file(tmp_path, Manifold.cube((100.0, 12.0, 12.0))), None, SETTINGS)


def test_files_that_are_no_mesh_are_refused(tmp_path):
    (tmp_path / "brace.stl").write_text("no mesh at all")
    with pytest.raises(InputError):
        casting_of_stl(tmp_path / "brace.stl", None, SETTINGS)
    with pytest.raises(InputError, match="no such file"):
        casting_of_stl(tmp_path / "other.stl", None, SETTINGS)


def test_axis_and_span_of_a_sleeve():
    mesh = Mesh(*mesh_of(tube().brace))
    up = tube_axis(mesh, "here")
    assert up == pytest.approx([0, 1, 0], abs=0.03)
    straight = bent_tube(bend_mm=0.0)
    mesh = Mesh(*mesh_of(straight.brace))
    up = tube_axis(mesh, "here")
    assert up == pytest.approx([0, 1, 0], abs=2e-3)
    span = span_of(mesh, up)
    assert span.high == pytest.approx(42.0, abs=0.15)
    assert span.low == pytest.approx(-42.0, abs=0.15)


def test_flat_is_what_has_a_ground():
    assert flat_normal(Mesh(*mesh_of(tube().brace))) is None
    assert flat_normal(Mesh(*mesh_of(coupon().brace))) == pytest.approx([0, 0, 1])
    embossed = Manifold.cube((50.0, 50.0, 4.0)) + Manifold.cylinder(1.0, 22.0, 10.0, 64).translate(
        (25, 25, 4)
    )
    turned = embossed.mirror((0, 0, 1))
    assert flat_normal(Mesh(*mesh_of(embossed))) == pytest.approx([0, 0, 1])
    assert flat_normal(Mesh(*mesh_of(turned))) == pytest.approx([0, 0, -1])


@pytest.mark.parametrize("length", [0.9, 2.0])
def test_refined_meshes_keep_surface_and_linear_values(length):
    points, triangles = coupon().vertices, coupon().triangles
    new, values, small = refined(points, points * [2, 3, 4], triangles, length)
    assert values == pytest.approx(new * [2, 3, 4])
    edges = np.linalg.norm(new[small] - new[np.roll(small, 1, axis=1)], axis=2)
    assert edges.max() <= length
    p, q = points[triangles], new[small]
    areas = [np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])[:, 2] for c in (p, q)]
    assert areas[1].min() > 0
    assert areas[1].sum() == pytest.approx(areas[0].sum(), rel=1e-12)
    rim = new[border_edges(small)]
    outline = np.linalg.norm(rim[:, 1] - rim[:, 0], axis=1).sum()
    assert outline == pytest.approx(2 * (70 + 70 + 26), rel=1e-9)
