"""Places along the flanges: close enough, inside the flanges, square to them, and clear of what is cast."""

from __future__ import annotations

import numpy as np
import pytest
from manifold3d import Manifold
from scipy.spatial import KDTree

from fabrication.flanges import FROM_END_MM, flange_places
from fabrication.mold import Piece
from hilbrace.config.mold import MoldSettings
from tests.unit.mold_shells import Case, coupon_case, tube_case


def places_of(case: Case):
    return flange_places(case.casting, case.parting, case.settings)


def filled(solid: Manifold, point: np.ndarray, radius: float) -> float:
    """Part of a small ball that lies in a body."""
    ball = Manifold.sphere(radius, 24).translate(tuple(point))
    return (ball ^ solid).volume() / ball.volume()


@pytest.mark.parametrize("count", [None, 3])
def test_bolts_stand_in_both_flanges(count):
    case = tube_case(count)
    solids = {shell.name: shell.solid for shell in case.shells}
    places = places_of(case)
    assert len(places.bolts) == 3 * (count or 2)
    for place in (*places.bolts, *places.keys):
        first, second = (solids[name] for name in place.pieces)
        assert filled(first, place.point - 2.5 * place.direction, 2.0) > 0.999
        assert filled(second, place.point + 2.5 * place.direction, 2.0) > 0.999
        assert filled(first, place.point + 2.5 * place.direction, 2.0) < 0.05


@pytest.mark.parametrize("count", [None, 3])
def test_bolts_are_as_close_as_wanted_and_keep_clear_of_the_ends(count):
    case = tube_case(count)
    bolts = places_of(case).bolts
    for seam in case.parting.seams:
        names = (case.parting.names[seam.first], case.parting.names[seam.second])
        side = np.array([place.point for place in bolts if place.pieces == names])
        lines = [side] if count else [side[side[:, 0] < 0], side[side[:, 0] > 0]]
        for line in lines:
            y = np.sort(line[:, 1])
            assert np.diff(y).max() <= case.settings.bolt_spacing_mm
            for end in case.parting.ends:
                depth = end.depth(line)
                assert depth.min() > FROM_END_MM - 0.5
                assert depth.min() < FROM_END_MM + 2.0


def test_keys_of_wedges_know_how_the_pulls_slant():
    for place in places_of(tube_case(3)).keys:
        assert place.slant_deg == pytest.approx(30.0, abs=5.0)
    for place in places_of(tube_case()).keys:
        assert place.slant_deg < 5.0


def test_jack_slots_lie_on_the_free_edges():
    case = tube_case()
    solids = {shell.name: shell.solid for shell in case.shells}
    jacks = places_of(case).jacks
    assert len(jacks) == 2
    for place in jacks:
        first = solids[place.pieces[0]]
        within = place.point - 2.0 * place.direction
        assert filled(first, within - 2.0 * place.outward, 1.0) > 0.999
        assert filled(first, within + 2.0 * place.outward, 1.0) == 0.0


def test_frames_are_square():
    for place in places_of(tube_case(3)).bolts:
        assert place.direction @ place.outward == pytest.approx(0.0, abs=1e-6)
        assert np.linalg.norm(place.direction) == pytest.approx(1.0)
        assert np.linalg.norm(place.outward) == pytest.approx(1.0)


def test_closer_bolts_are_more_bolts():
    case = tube_case()
    close = flange_places(case.casting, case.parting, MoldSettings(bolt_spacing_mm=30.0))
    assert len(close.bolts) > len(places_of(case).bolts)


def test_keys_of_a_lid_keep_clear_of_the_casting():
    case = coupon_case()
    places = places_of(case)
    assert places.bolts == ()
    assert len(places.keys) == len(places.clamps) >= 4
    cast = KDTree(np.asarray(case.casting.brace.to_mesh64().vert_properties)[:, :2])
    gutter = case.casting.triangles[case.casting.beyond == 1]
    for place in places.keys:
        assert place.pieces == ("core", "shell_lid")
        assert cast.query(place.point[:2])[0] > 4.0
        assert filled(case.shells[0].solid, place.point + 2.5 * place.direction, 2.0) > 0.999
        assert filled(case.core.land, place.point - 2.5 * place.direction, 2.0) > 0.999
        assert KDTree(case.casting.outer[np.unique(gutter)][:, :2]).query(place.point[:2])[0] > 3.5


def test_pieces_named_by_places_exist():
    case = tube_case(3)
    names = {piece.name for piece in case.shells if isinstance(piece, Piece)}
    assert {name for place in places_of(case).bolts for name in place.pieces} == names
