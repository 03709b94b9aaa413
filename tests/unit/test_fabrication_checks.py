"""The proof of a mold: a sound one passes, and every fault built in on purpose is found by its check."""

from dataclasses import replace

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.build import build_mold
from fabrication.cavity import measure_cavity, room_of
from fabrication.checks import (
    Check,
    cavity_checks,
    check_mold,
    closing_checks,
    fits,
    opening_checks,
    overhang_mm2,
    piece_checks,
    wall_checks,
)
from fabrication.fixtures.cad import union
from fabrication.mold import Mold, Piece
from fabrication.printable import printable
from fabrication.printers import custom_bed
from hilbrace.config.mold import MoldSettings
from tests.unit.mold_cases import bent_tube, flat_coupon

BED = custom_bed("250x210x210", "fdm")


@pytest.fixture(scope="module")
def tube() -> Mold:
    return build_mold(bent_tube(), MoldSettings(printer="250x210x210"))


def proof(mold: Mold, printer=BED) -> dict[str, Check]:
    return check_mold(mold, [printable(piece) for piece in mold.pieces], printer)


def failed(checks) -> set[str]:
    return {check.name for check in checks if not check.passed}


def by_name(checks) -> dict[str, Check]:
    return {check.name: check for check in checks}


def changed(mold: Mold, name: str, solid: Manifold) -> Mold:
    """The mold with the body of one piece replaced."""
    pieces = tuple(replace(piece, solid=solid) if piece.name == name else piece for piece in mold.pieces)
    return replace(mold, pieces=pieces)


def body(mold: Mold, name: str) -> Manifold:
    return next(piece.solid for piece in mold.pieces if piece.name == name)


def test_a_tube_s_mold_is_proved(tube):
    checks = proof(tube)
    assert {name: check.value for name, check in checks.items() if not check.passed} == {}
    assert checks["cavity_volume_error"].value < 2e-3
    assert checks["removal_collision_mm3"].value < 1e-3
    assert checks["min_channel_mm"].value == pytest.approx(4.0, abs=0.1)
    assert all(check.means for check in checks.values())
    assert all(check.mend for check in checks.values() if check.limit is not None)


def test_a_coupon_s_mold_is_proved():
    mold = build_mold(flat_coupon(), MoldSettings(printer="250x210x210"))
    assert failed(proof(mold).values()) == set()


def test_a_shell_pressed_into_the_core_overlaps(tube):
    pull = next(piece for piece in tube.pieces if piece.kind == "shell").pull
    name = tube.of("shell")[0].name
    found = failed(closing_checks(changed(tube, name, body(tube, name).translate(tuple(-0.5 * pull)))))
    assert "core_overlap_mm3" in found


def test_a_hook_behind_the_core_hinders_removal(tube):
    """A block that reaches around the core from one shell stands in the way of that shell."""
    shell = tube.of("shell")[0]
    middle = np.asarray(tube.core.land.bounding_box()).reshape(2, 3).mean(axis=0)
    behind = middle - 45.0 * shell.pull
    hook = Manifold.cube((10, 10, 10), True).translate(tuple(behind))
    assert failed(opening_checks(tube)) == set()
    hooked = changed(tube, shell.name, shell.solid + hook)
    others = tuple(piece for piece in hooked.pieces if piece.name in ("core", shell.name))
    checks = by_name(opening_checks(replace(hooked, pieces=others)))
    assert checks["removal_collision_mm3"].value > 100
    assert checks["removal_collision_mm3"].where == shell.name


def test_a_missing_rib_shows_in_the_volume(tube):
    """The groove of one strut is filled: the cavity lacks it, and its depth is wrong there."""
    low = np.asarray(tube.casting.brace.bounding_box())
    plug = Manifold.cube((200, 12, 200), True) ^ tube.casting.brace
    assert plug.volume() > 0.01 * tube.casting.brace.volume()
    assert low[4] > 6
    filled = changed(tube, "core", body(tube, "core") + plug)
    found = failed(cavity_checks(filled))
    assert {"cavity_volume_error", "cavity_depth_error_mm"} <= found


def test_a_brace_in_two_rings_makes_two_cavities(tube):
    ring = tube.casting.brace.trim_by_plane((0, 1, 0), 8.0) + tube.casting.brace.trim_by_plane(
        (0, -1, 0), 8.0
    )
    casting = replace(tube.casting, brace=ring)
    assert "cavities" in failed(cavity_checks(replace(tube, casting=casting)))


def test_a_vent_that_was_forgotten_is_named(tube):
    """A closed gutter leaves the whole rim without a way out."""
    core = replace(tube.core, gutter=Manifold.cube((1, 1, 1)).translate((500, 0, 0)))
    checks = by_name(cavity_checks(replace(tube, core=core)))
    assert checks["trapped_maxima"].value >= 1
    assert not checks["trapped_maxima"].passed


def test_loose_parts_small_beds_and_thin_walls_are_named(tube):
    pieces = [printable(piece) for piece in tube.pieces]
    assert failed(piece_checks(pieces, BED)) == set()
    plate = np.asarray(body(tube, "base").bounding_box())
    crumb = Manifold.cube((3, 3, 3)).translate((0, plate[4] + 9, 0))
    loose = changed(tube, "base", body(tube, "base") + crumb)
    assert failed(piece_checks([printable(loose.pieces[-1])], BED)) == {"pieces_not_in_one_part"}
    checks = by_name(piece_checks(pieces, custom_bed("60x60x60", "fdm")))
    assert not checks["pieces_larger_than_bed"].passed
    assert "core" in checks["pieces_larger_than_bed"].where
    fin = Manifold.cube((0.3, 8, 30)).translate((plate[0] + 20, plate[4] - 0.5, -15))
    finned = changed(tube, "base", body(tube, "base") + fin)
    checks = by_name(wall_checks(finned, [printable(piece) for piece in finned.pieces], BED))
    assert checks["min_wall_mm"].value == pytest.approx(0.3, abs=0.01)
    assert checks["min_wall_mm"].where == "base"


def test_a_piece_fits_straight_or_turned_by_a_quarter():
    def block(*size: float):
        solid = Manifold.cube(size)
        return printable(Piece("b", "B", "shell", solid, None, np.eye(3), (0.5, 0.5, 0.5)))

    width, depth, height = BED.usable_mm
    assert fits(block(width - 1, depth - 1, height - 1), BED)
    assert fits(block(depth - 1, width - 1, height - 1), BED)
    assert not fits(block(width - 1, depth + 1, 10), BED)
    assert not fits(block(10, 10, height + 1), BED)


def test_overhanging_area_is_what_looks_down_above_the_bed():
    table = Manifold.cube((4, 4, 10)).translate((18, 18, 0)) + Manifold.cube((40, 40, 2)).translate(
        (0, 0, 10)
    )
    piece = printable(Piece("t", "T", "base", table, None, np.eye(3), (0.5, 0.5, 0.5)))
    assert overhang_mm2(piece, BED) == pytest.approx(40 * 40 - 4 * 4, rel=1e-6)
    cone = Manifold.cylinder(10, 1, 9, 256)
    piece = printable(Piece("c", "C", "base", cone, None, np.eye(3), (0.5, 0.5, 0.5)))
    assert overhang_mm2(piece, BED) == 0.0


def test_the_room_holds_the_brace_and_stays_clear_of_outer_walls(tube):
    room = room_of(tube.casting)
    assert (tube.casting.brace - room).volume() < 1e-3 * tube.casting.brace.volume()
    outside = union([piece.solid for piece in tube.of("shell")]) + tube.core.land
    assert (room - outside).volume() < 0.05 * room.volume()
    assert measure_cavity(tube).volume_error < 2e-3
