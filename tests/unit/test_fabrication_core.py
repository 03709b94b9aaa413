"""The grooved core against the brace that it casts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.core import BACK_MM, GUTTER_DEPTH_MM, build_core
from fabrication.draft import SQUEEZE, drafted, wall_edges, walls_of
from fabrication.mold import Casting, Core
from fabrication.sheet import rim_of
from hilbrace.config import MoldSettings
from hilbrace.errors import GeometryError
from hilbrace.pattern.offset import area_ratio
from tests.unit.mold_cases import FOOT_MM, GUTTER_MM, bent_tube, flat_coupon

CASES = {"tube": bent_tube, "coupon": flat_coupon}


@cache
def casting(name: str) -> Casting:
    return CASES[name]()


@cache
def core(name: str, draft_deg: float) -> Core:
    return build_core(casting(name), MoldSettings(draft_deg=draft_deg))


def cavity(made: Core) -> float:
    return made.land.volume() - made.solid.volume() - made.gutter.volume()


@pytest.mark.parametrize("name", CASES)
def test_without_draft_the_grooves_are_the_brace_to_rounding(name):
    assert cavity(core(name, 0.0)) == pytest.approx(casting(name).brace.volume(), rel=1e-9)
    assert (core(name, 0.0).solid ^ casting(name).brace).volume() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("draft_deg", [1.0, 2.0, 5.0])
def test_draft_keeps_the_volume(name, draft_deg):
    assert cavity(core(name, draft_deg)) == pytest.approx(casting(name).brace.volume(), rel=2e-3)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("draft_deg", [0.0, 2.0])
def test_core_is_one_part_without_handles_inside_its_land(name, draft_deg):
    made = core(name, draft_deg)
    assert [part.volume() > 0 for part in made.solid.decompose()] == [True]
    assert made.solid.genus() == 0
    assert len(made.land.decompose()) == 1
    assert (made.solid - made.land).volume() < 0.01


@pytest.mark.parametrize("name", CASES)
def test_every_groove_leads_to_the_open_gutter(name):
    space = core(name, 2.0).land - core(name, 2.0).solid
    rooms = [room for room in space.decompose() if room.volume() > 1e-3]
    assert len(rooms) == 1
    top = casting(name).outer @ casting(name).up
    assert rooms[0].bounding_box()[4] == pytest.approx(top.max())
    gutter = core(name, 2.0).gutter
    assert (gutter - space).volume() < 5e-3 * gutter.volume()


def test_gutter_sinks_to_its_depth_all_around():
    made = core("tube", 2.0)
    top = made.upper[:, 1].max() + GUTTER_MM - 1e-3
    ring = made.gutter.rotate((90, 0, 0)).slice(top)
    assert [len(ring.to_polygons()), len(made.land.rotate((90, 0, 0)).slice(top).to_polygons())] == [2, 1]
    outer, inner = sorted(np.linalg.norm(loop - loop.mean(0), axis=1).mean() for loop in ring.to_polygons())[
        ::-1
    ]
    assert outer - inner == pytest.approx(4 + GUTTER_DEPTH_MM, abs=0.3)


def test_foot_ends_flat_below_the_lower_rim():
    made = core("tube", 2.0)
    low = casting("tube").outer[:, 1].min()
    assert made.foot == pytest.approx([0, low, 0], abs=0.05)
    assert made.lower[:, 1].min() - low == pytest.approx(FOOT_MM)
    face = made.land.rotate((90, 0, 0)).slice(low + 1e-6)
    assert face.area() > 2000
    assert len(made.lower) == 56
    assert np.diff(np.unwrap(np.arctan2(made.lower[:, 2], made.lower[:, 0]))).std() < 0.1


def test_a_coupon_lies_on_a_plate():
    made = core("coupon", 2.0)
    low, high = np.array(made.land.bounding_box()).reshape(2, 3)
    assert low == pytest.approx([-35, -FOOT_MM, -BACK_MM])
    assert high == pytest.approx([35, 70 + GUTTER_MM, 4])
    assert made.land.volume() == pytest.approx(float(np.prod(high - low)))
    assert made.land.num_tri() == 12
    assert np.ptp(made.upper[:, 0]) == pytest.approx(50, abs=0.1)


def test_walls_lean_by_the_draft_and_turn_about_their_middle():
    """On the straight frame of the coupon: the groove is narrower below and wider above by t tan(a) / 2."""
    flat = casting("coupon")
    levels = drafted(flat, 5.0)
    half = 4 * np.tan(np.radians(5)) / 2
    outline, across = walls_of(flat, flat.covered | (flat.beyond == 1))
    side = outline[(np.abs(across[outline, 0]) > 0.999) & (np.abs(flat.vertices[outline, 0]) > 24)]
    side = side[(levels.slant[side] == 1) & (np.abs(flat.vertices[side, 1] - 35) < 30)]
    assert len(side) > 10
    sign = np.sign(flat.vertices[side, 0])
    assert sign * (levels.top - flat.outer)[side, 0] == pytest.approx(half, abs=1e-4)
    assert sign * (flat.vertices - levels.floor)[side, 0] == pytest.approx(half, abs=1e-4)
    angle = np.degrees(np.arctan2(sign * (levels.top - levels.floor)[side, 0], 4.0))
    assert angle == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("draft_deg", [2.0, 10.0])
def test_draft_turns_no_triangle_over_and_is_lowered_where_lands_are_narrow(name, draft_deg):
    given = casting(name)
    levels = drafted(given, draft_deg)
    groove = given.covered | (given.beyond == 1)
    for points, moved, own in (
        (given.vertices, levels.floor, groove),
        (given.outer, levels.top, ~groove),
    ):
        ratio = area_ratio(points, given.triangles[own], moved - points)
        assert ratio.min() >= SQUEEZE - 1e-9
    outline, _ = walls_of(given, groove)
    assert np.median(levels.slant[outline]) > 0.5
    assert levels.slant.min() > 0


def test_draft_stays_within_the_faces_that_shells_are_cut_with():
    given = casting("tube")
    levels = drafted(given, 2.0)
    groove = given.covered | (given.beyond == 1)
    p, q = given.outer[given.triangles[~groove]], levels.top[given.triangles[~groove]]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(np.einsum("tkx,tx->tk", q - p, normal)).max() < 1e-4
    assert np.abs(q - p).max() > 0.05
    still = rim_of(given.triangles).vertices
    assert levels.top[still] == pytest.approx(given.outer[still])


def test_walls_stand_between_grooves_and_lands_only():
    given = casting("tube")
    groove = given.covered | (given.beyond == 1)
    edges = wall_edges(given.triangles, groove)
    ends = rim_of(given.triangles).vertices
    assert not np.isin(edges, ends).all(axis=1).any()
    steps = given.triangles[groove][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    known = {tuple(step) for step in steps.tolist()}
    assert all(tuple(edge) in known and tuple(edge[::-1]) not in known for edge in edges.tolist())


def test_a_body_of_a_file_is_cut_out_of_the_land():
    """The boolean gives the core that the height field gives, but for walls above the land."""
    given = replace(casting("tube"), covered=None)
    made, own = build_core(given, MoldSettings()), core("tube", 0.0)
    assert made.solid.genus() == 0
    assert cavity(made) == pytest.approx(given.brace.volume(), rel=2e-3)
    assert (made.solid - own.solid).volume() + (own.solid - made.solid).volume() < 0.01 * given.brace.volume()


def test_a_brace_that_stands_out_of_the_land_is_refused():
    given = casting("tube")
    boss = Manifold.cylinder(12.0, 8.0, 8.0, 48).rotate((0, 90, 0)).translate((34.0, 0.0, 0.0))
    with pytest.raises(GeometryError, match=r"the grooves hold .* ml and the brace"):
        build_core(replace(given, covered=None, brace=given.brace + boss), MoldSettings())


def test_a_brace_that_cuts_its_limb_through_is_refused():
    given = casting("tube")
    disc = Manifold.cylinder(10.0, 60.0, 60.0, 64).rotate((90, 0, 0)).translate((0.0, 5.0, 0.0))
    through = given.brace + (disc ^ core("tube", 0.0).land)
    with pytest.raises(GeometryError, match="falls into 2 pieces"):
        build_core(replace(given, covered=None, brace=through), MoldSettings())
