import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.fixtures import Place
from fabrication.flanges import FlangePlaces
from fabrication.hardware import shopping_list
from fabrication.joints import find_joints, joined
from fabrication.mold import Piece
from hilbrace.config import MoldSettings

X, Y, Z = np.eye(3)
STEPS_MM = (0.25, 0.5, 1, 2, 4, 8, 16, 32, 64, 128)


def place(x, y=0.0):
    return Place(np.array([x, y, 0.0]), Z, Y, ("below", "above"), 6.0)


def flanges():
    above = Manifold.cube((100, 14, 6)).translate((-50, -7, 0))
    below = above.mirror((0, 0, 1))
    return (
        Piece("below", "Below", "shell", below, -Z, np.eye(3), (1.0, 1.0, 1.0)),
        Piece("above", "Above", "shell", above, Z, np.eye(3), (1.0, 1.0, 1.0)),
    )


PLACES = FlangePlaces((place(-40), place(40)), (place(-15),), (place(15, 7.0),))


def test_two_flanges_are_bolted_keyed_and_come_apart():
    joints = find_joints(PLACES, MoldSettings())
    below, above = joined(flanges(), joints)
    for piece in (below, above):
        assert len(piece.solid.decompose()) == 1
        assert piece.solid.genus() == 2
    assert (below.solid ^ above.solid).volume() < 1e-9
    assert (below.solid ^ above.solid.translate((1.0, 0, 0))).volume() > 0.1
    moved = [(above.solid.translate((0, 0, step)) ^ below.solid).volume() for step in STEPS_MM]
    assert max(moved) < 1e-9


def test_what_is_bought_and_what_is_drawn():
    joints = find_joints(PLACES, MoldSettings())
    assert [(item.count, item.name.split(",")[0]) for item in shopping_list(joints.hardware)] == [
        (2, "M4 x 12 socket head bolt"),
        (2, "M4 nut"),
        (2, "M4 washer"),
    ]
    assert [item.name for item in joints.drawn] == ["bolt_hole"] * 2 + ["key", "socket", "jack_slot"]


def test_a_lid_is_clamped():
    lid = FlangePlaces((), (place(0),), (), (place(-20), place(20)))
    joints = find_joints(lid, MoldSettings())
    assert joints.everywhere == ()
    assert [(item.count, item.name) for item in joints.hardware] == [(2, "spring clamp, 25 mm")]


def test_no_places_no_joints():
    joints = find_joints(FlangePlaces((), (), ()), MoldSettings())
    before = flanges()
    after = joined(before, joints)
    assert joints.hardware == joints.drawn == ()
    assert [piece.solid.volume() for piece in after] == pytest.approx([p.solid.volume() for p in before])
