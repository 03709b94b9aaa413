import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.fixtures.cradle import FLOOR_MM, HOLD_MM, SADDLE_MM, cradle, cradle_block
from fabrication.fixtures.luer import BARREL_MM, reach, syringe_room
from fabrication.print_pose import pose
from fabrication.printers import profile
from hilbrace.config import MoldSettings
from hilbrace.errors import GeometryError

MK4 = profile(MoldSettings())
Y = np.array([0.0, 1, 0])
STEPS_MM = (0.25, 0.5, 1, 2, 4, 8, 16, 32, 64, 128)


def foot():
    """A mold that lies: a thick rod along x with a fin below, y up."""
    rod = Manifold.cylinder(160, 35, 35, 90).rotate((0, 90, 0)).translate((-60, 60, 5))
    fin = Manifold.cube((160, 40, 12)).translate((-60, 10, -1))
    return rod + fin


def test_the_block_has_the_volume_of_its_drawing():
    block = cradle_block(180.0, 80.0, 210.0, 110.0).val()
    assert block.Volume() == pytest.approx(210 * 110 * FLOOR_MM + 2 * SADDLE_MM * 80 * HOLD_MM)
    short = cradle_block(60.0, 80.0, 90.0, 110.0).val()
    assert short.Volume() == pytest.approx(90 * 110 * FLOOR_MM + 60 * 80 * HOLD_MM)


def test_a_cradle_holds_a_mold_on_all_sides_and_lets_it_out_upwards():
    mold = foot()
    made, placed = cradle([mold], Y, MK4)
    assert len(made.decompose()) == 1
    assert [item.name for item in placed] == ["cradle_block"]
    assert (made ^ mold).volume() < 1e-9
    assert max((made ^ mold.translate((0, step, 0))).volume() for step in STEPS_MM) < 1e-9
    for way in ((1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0, -1, 0)):
        assert (made ^ mold.translate(way)).volume() > 1
    assert pose(made, Y, MK4).fits
    assert pose(made, Y, MK4).overhang_mm2 < 1


def test_it_carries_the_middle_of_the_mold():
    made, _ = cradle([foot()], Y, MK4)
    box = np.reshape(made.bounding_box(), (2, 3))
    assert box[0, 0] < -60
    assert box[1, 0] > 100
    assert box[0, 1] == pytest.approx(10 - 0.2 - FLOOR_MM)


def test_the_syringe_gets_to_its_port():
    point, way = np.array([20.0, 28, 40]), np.array([0.0, 0, 1])
    room = syringe_room(point, way, 6.0)
    box = np.reshape(room.bounding_box(), (2, 3))
    assert box[0, 2] == pytest.approx(46)
    assert box[1, 2] > 40 + reach(6.0) + 100
    assert np.ptp(box, axis=0)[:2] == pytest.approx([BARREL_MM, BARREL_MM], rel=2e-3)
    wide = foot() + Manifold.cube((150, 30, 80)).translate((-55, 10, -30))
    blocked, _ = cradle([wide], Y, MK4)
    free, _ = cradle([wide], Y, MK4, [room.translate((-50, -10, 0))])
    assert (blocked ^ room.translate((-50, -10, 0))).volume() > 1
    assert (free ^ room.translate((-50, -10, 0))).volume() < 1e-9
    assert len(free.decompose()) == 1


def test_a_cradle_for_nothing_is_refused():
    with pytest.raises(GeometryError, match="something to hold"):
        cradle([], Y, MK4)
