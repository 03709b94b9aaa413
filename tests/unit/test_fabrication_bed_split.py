"""The bed split: every part fits, is one body, slides off, and meets its neighbour at loose pins."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.bed_split import LEAST_CLEAR_MM, Split, split_for_bed
from fabrication.bodies import mesh_of
from fabrication.dowel_sites import core_sites, plane_axes
from fabrication.flanges import flange_places
from fabrication.mold import Piece
from fabrication.print_pose import best_pose
from fabrication.printers import custom_bed, profile
from fabrication.removal import collision
from hilbrace.config.mold import MoldSettings
from hilbrace.errors import GeometryError
from tests.unit.mold_shells import tube_case

SMALL = "125x110x90"


def pieces_of() -> tuple[Piece, ...]:
    case = tube_case()
    core = Piece("core", "Core", "core", case.core.land, None, np.eye(3), (0.8, 0.8, 0.8))
    return (core, *case.shells)


def holes() -> np.ndarray:
    case = tube_case()
    places = flange_places(case.casting, case.parting, case.settings)
    return np.array([place.point for place in (*places.bolts, *places.keys, *places.jacks)])


@cache
def small_split(bed: str = SMALL) -> Split:
    settings = MoldSettings(printer=bed)
    return split_for_bed(pieces_of(), profile(settings), tube_case().core, settings, holes())


def cut_level(part: Piece) -> float:
    return float(mesh_of(part.solid)[0][:, 1].max())


def test_what_fits_is_left_alone():
    settings = MoldSettings()
    split = split_for_bed(pieces_of(), profile(settings), tube_case().core, settings, holes())
    assert [piece.name for piece in split.pieces] == ["core", "shell_1", "shell_2"]
    assert all(a.solid is b.solid for a, b in zip(split.pieces, pieces_of(), strict=True))
    assert split.hardware == ()


def test_every_part_fits_and_is_one_body():
    split, printer = small_split(), profile(MoldSettings(printer=SMALL))
    assert [piece.name for piece in split.pieces] == [
        f"{name}_part{number}" for name in ("core", "shell_1", "shell_2") for number in (1, 2)
    ]
    for part in split.pieces:
        bodies = part.solid.decompose()
        assert len(bodies) == 1
        assert bodies[0].volume() > 0
        assert best_pose(part, printer, tube_case().core.axis).fits
    assert split.pieces[0].title == "Core, part 1 of 2"


def test_parts_are_numbered_from_the_foot():
    parts = {piece.name: piece for piece in small_split().pieces}
    for name in ("core", "shell_1", "shell_2"):
        assert cut_level(parts[f"{name}_part1"]) < cut_level(parts[f"{name}_part2"])


def test_cuts_keep_clear_of_bolts_and_of_each_other():
    levels = [cut_level(piece) for piece in small_split().pieces if piece.name.endswith("part1")]
    for level in levels[1:]:
        assert np.abs(holes()[:, 1] - level).min() >= LEAST_CLEAR_MM - 0.01
    assert abs(levels[1] - levels[2]) > 15.0


def test_only_holes_and_bosses_change_what_a_piece_holds():
    split = small_split()
    for piece in pieces_of():
        parts = [part for part in split.pieces if part.name.startswith(f"{piece.name}_")]
        lost = piece.solid.volume() - sum(part.solid.volume() for part in parts)
        pins = 2 if piece.kind == "core" else 3
        if piece.kind == "core":
            assert lost == pytest.approx(pins * np.pi * 4.2**2 * 41, rel=0.01)
        else:
            assert -pins * np.pi * 3.6**2 * 20 < lost < pins * np.pi * 1.7**2 * 11


def test_parts_do_not_overlap_and_come_off():
    parts = small_split().pieces
    for first, second in itertools.combinations(parts, 2):
        assert abs((first.solid ^ second.solid).volume()) < 1e-6
    for part in parts:
        assert collision(part, [other for other in parts if other is not part]) < 1e-3


def test_holes_are_wider_than_pins_by_the_clearance():
    core = pieces_of()[0]
    parts = [part for part in small_split().pieces if part.name.startswith("core_")]
    level = cut_level(parts[0])
    turn = plane_axes(np.array([0.0, 1.0, 0.0]))
    flat = [
        solid.transform(np.column_stack([turn, np.zeros(3)])).slice(level - 5.0)
        for solid in (core.solid, parts[0].solid)
    ]
    area = flat[0].area() - flat[1].area()
    clearance = profile(MoldSettings(printer=SMALL)).clearance_mm
    assert area == pytest.approx(2 * np.pi * (4.0 + clearance) ** 2, rel=0.01)


def test_pins_to_buy():
    names = [item.name for item in small_split().hardware]
    assert names == ["8 x 40 dowel pin, ISO 2338"] + 2 * ["3 x 10 dowel pin, ISO 2338"]
    assert [item.count for item in small_split().hardware] == [2, 3, 3]
    assert len(small_split().drawn) == 8


def test_wide_pieces_are_cut_lengthwise_too():
    bed = "90x80x70"
    printer = custom_bed(bed, "fdm")
    split = small_split(bed)
    assert len(split.pieces) > 8
    for part in split.pieces:
        assert len(part.solid.decompose()) == 1
        assert best_pose(part, printer, tube_case().core.axis).fits


def test_pins_of_a_bar_lie_inside_it_and_far_apart():
    bar = Manifold.cube((60, 30, 80), True)
    sites = core_sites(bar, np.array([0.0, 0.0, 1.0]), 5.0, ("a", "b"))
    assert sites is not None
    first, second = (place.point for place in sites.places)
    assert np.linalg.norm(first - second) > 40.0
    for point in (first, second):
        assert point[2] == pytest.approx(5.0)
        assert abs(point[0]) <= 30 - sites.diameter_mm / 2 - 3.9
    assert core_sites(Manifold.cube((6, 6, 80), True), np.array([0.0, 0.0, 1.0]), 0.0, ("a", "b")) is None


def test_a_piece_that_no_pin_fits_is_refused_by_name():
    needle = Piece("core", "Core", "core", Manifold.cube((6, 300, 6), True), None, np.eye(3), (1.0, 1.0, 1.0))
    settings = MoldSettings(printer="100x100x100")
    case = tube_case()
    with pytest.raises(GeometryError, match="cut in two") as caught:
        split_for_bed([needle], profile(settings), replace(case.core, land=needle.solid), settings)
    assert "core" in caught.value.where
    assert "mold.printer" in caught.value.hint
