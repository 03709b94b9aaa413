from dataclasses import replace

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.fixtures.marks import DEPTH_MM
from fabrication.marking import inscription, marked
from fabrication.mold import Piece
from hilbrace.errors import GeometryError
from tests.unit.test_fabrication_stand import LEFT, mold

Y = np.array([0.0, 1, 0])


def piece(name, solid, pull=None, kind="core"):
    return Piece(name, name, kind, solid, pull, np.eye(3), (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("name", "pull", "side", "text"),
    [
        ("shell_medial", Y, "left", "MEDIAL L ↑"),
        ("shell_lateral_upper", Y, "right", "LATERAL UPPER R ↑"),
        ("core", None, "left", "CORE L"),
        ("shell_1", Y, "", "1 ↑"),
    ],
)
def test_pieces_say_what_they_are_whose_side_and_what_is_up(name, pull, side, text):
    assert inscription(piece(name, Manifold(), pull), replace(LEFT, side=side)) == text


def test_marks_are_cut_into_shells_and_core_and_nothing_falls_off():
    core, shells = mold()
    shells = tuple(
        replace(shell, name=f"shell_{name}")
        for shell, name in zip(shells, ("medial", "lateral"), strict=True)
    )
    pieces = (piece("core", core.land), *shells)
    out = marked(pieces, LEFT, Y)
    for before, after in zip(pieces, out, strict=True):
        taken = before.solid - after.solid
        assert len(after.solid.decompose()) == 1
        assert after.solid.genus() == before.solid.genus()
        assert 20 < taken.volume() < 200
        # nowhere deeper than a mark: outside grows by nothing, and the inner face is untouched
        assert (after.solid - before.solid).volume() < 1e-9
        box_before, box_after = before.solid.bounding_box(), after.solid.bounding_box()
        np.testing.assert_allclose(box_after, box_before, atol=1e-6)
    top = core.land.trim_by_plane((0, 1, 0), 80 - DEPTH_MM)
    assert out[0].solid.trim_by_plane((0, 1, 0), 80 - DEPTH_MM).volume() < top.volume() - 20
    assert out[0].solid.trim_by_plane((0, -1, 0), DEPTH_MM - 80).volume() == pytest.approx(
        core.land.volume() - top.volume(), rel=1e-9
    )


def test_the_base_brings_its_own_mark():
    base = piece("base", Manifold.cube((10, 10, 10)), -Y, kind="base")
    assert marked([base], LEFT, Y) == (base,)


def test_a_mark_avoids_holes_and_bosses():
    plate = Manifold.cube((120, 10, 120)).translate((-60, -10, -60))
    hole = Manifold.cylinder(30, 4, 4, 32).rotate((-90, 0, 0)).translate((0, -20, 0))
    shell = piece("shell_front", plate - hole, np.array([0.0, 1, 0]), "shell")
    (out,) = marked([shell], LEFT, np.array([0.0, 0, 1]))
    taken = shell.solid - out.solid
    assert out.solid.genus() == 1
    assert (
        taken ^ Manifold.cylinder(30, 4.5, 4.5, 32).rotate((-90, 0, 0)).translate((0, -20, 0))
    ).volume() < 1e-9


def test_small_pieces_get_smaller_letters_and_too_small_ones_are_refused():
    small = piece("core", Manifold.cube((8, 10, 24)))
    (out,) = marked([small], LEFT, Y)
    assert 0 < small.solid.volume() - out.solid.volume() < 30
    with pytest.raises(GeometryError, match="no room for the mark 'CORE L' on core"):
        marked([piece("core", Manifold.cube((10, 10, 10)))], LEFT, Y)
