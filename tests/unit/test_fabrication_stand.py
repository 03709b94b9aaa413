from math import pi, sqrt

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.fixtures import base
from fabrication.fixtures.stand import (
    CHAMFER_MM,
    EAR_HOLE_MM,
    EAR_WIDTH_MM,
    FLAT,
    LUG_MM,
    PLATE_MM,
    ROOF_MM,
    ROOT_MM,
    base_plate,
    core_lug,
    core_socket,
    d_area,
    ear_reach,
    shell_ridge,
    sole,
)
from fabrication.mold import Casting, Core, Piece
from fabrication.print_pose import pose
from fabrication.printers import profile
from hilbrace.config import MoldSettings
from hilbrace.errors import GeometryError

STEPS_MM = (0.25, 0.5, 1, 2, 4, 8, 16, 32, 64, 128)
Y = np.array([0.0, 1, 0])
LEFT = Casting(
    name="knee-L",
    joint="knee",
    side="left",
    brace=Manifold.cube((1, 1, 1)),
    thickness_mm=4.0,
    vertices=np.eye(3),
    direction=np.eye(3),
    thickness=np.ones(3),
    triangles=np.array([[0, 1, 2]]),
    covered=None,
    beyond=np.zeros(1, np.int64),
    centreline=np.eye(3),
    down=np.array([0.0, -1.0, 0.0]),
    up=np.array([0.0, 1.0, 0.0]),
    shrinkage=0.0,
)
"""Of a casting the base reads its side alone."""


def cone_of(low, high, height):
    """Volume between two similar outlines of the lug."""
    a, b = d_area(low), d_area(high)
    return height / 3 * (a + b + sqrt(a * b))


def upright(solid):
    """A body that stood along z, standing along y."""
    return solid.rotate((-90, 0, 0))


def mold(lift=0.6, gone=0.0):
    """Core and two shells of a tapering limb, y up, pulls along x."""
    land = upright(Manifold.cylinder(100, 40, 46, 180)).translate((5, -20, 3))
    wall = Manifold.cylinder(100 - lift, 46, 52, 180).translate((0, 0, lift))
    wall = upright(wall - Manifold.cylinder(100, 40, 46, 180)).translate((5, -20, 3))
    right, left = wall.split_by_plane((1, 0, 0), 5)
    core = Core(land, land, Manifold(), np.zeros((1, 3)), np.zeros((1, 3)), Y, np.zeros(3))
    shells = tuple(
        Piece(
            name,
            name,
            "shell",
            solid,
            np.array([way, gone, 0.0]) / np.hypot(way, gone),
            np.eye(3),
            (1.0,) * 3,
        )
        for name, solid, way in (("right", right, 1.0), ("left", left, -1.0))
    )
    return core, shells


@pytest.mark.parametrize("radius", [6.0, 20.0])
def test_lug_and_socket_have_the_volumes_of_their_drawing(radius):
    lug = core_lug(radius).val().Volume()
    straight = d_area(radius) * (LUG_MM - CHAMFER_MM + ROOT_MM)
    assert lug == pytest.approx(straight + cone_of(radius, radius - CHAMFER_MM, CHAMFER_MM), rel=1e-9)
    socket = core_socket(radius, 0.2).val().Volume()
    wide = radius + 0.2 / FLAT
    roof = cone_of(wide, ROOF_MM, wide - ROOF_MM)
    assert socket == pytest.approx(d_area(wide) * (LUG_MM + 0.2 + ROOT_MM) + roof, rel=1e-9)


def test_the_area_of_a_d():
    turns = np.linspace(0, 2 * np.pi, 200001)
    x = np.minimum(np.cos(turns), FLAT)
    y = np.where(
        np.cos(turns) > FLAT, np.sign(np.sin(turns)) * np.minimum(abs(np.sin(turns)), 0.8), np.sin(turns)
    )
    area = 0.5 * abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
    assert d_area(1.0) == pytest.approx(area, rel=1e-4)


@pytest.mark.parametrize("radius", [50.0, 80.0, 100.0])
def test_a_plate_with_its_ears_stays_inside_its_square(radius):
    shape = base_plate(radius).val()
    box = shape.BoundingBox()
    assert max(box.xmax, box.ymax, -box.xmin, -box.ymin) <= radius + 1e-6
    assert (box.zmin, box.zmax) == pytest.approx((-PLATE_MM, 0))
    tip = ear_reach(radius)
    assert tip > radius + 10
    holes = 4 * pi / 4 * EAR_HOLE_MM**2
    half = EAR_WIDTH_MM / 2
    # an ear: a strip to the middle of its round end, half a disc, less what lies inside the plate
    inside = half * sqrt(radius**2 - half**2) + radius**2 * np.arcsin(half / radius)
    ears = 4 * ((tip - half) * 2 * half + pi * half**2 / 2 - inside)
    # strips meet in the middle of the disc, so nothing is counted twice
    assert shape.Volume() == pytest.approx(PLATE_MM * (pi * radius**2 + ears - holes), rel=1e-6)


def test_a_ridge_is_a_trapezoid():
    assert shell_ridge(7.0, 9.0, 3.0, 3.0).val().Volume() == pytest.approx(
        7 * (3 * (9 + 3) / 2 + 9 * ROOT_MM)
    )


def test_the_base_holds_the_core_one_way_only():
    core, shells = mold()
    made = base(core, LEFT, MoldSettings(), shells)
    drilled = core.land - made.core_cutter
    stand = made.piece.solid
    assert len(stand.decompose()) == len(drilled.decompose()) == 1
    assert drilled.genus() == 0
    assert (stand ^ drilled).volume() < 1e-6
    for angle in (20, 90, 180):
        turned = drilled.translate((-5, 0, -3)).rotate((0, angle, 0)).translate((5, 0, 3))
        assert (stand ^ turned).volume() > 1
    for way in ((0.6, 0, 0), (-0.6, 0, 0), (0, 0, 0.6), (0, 0, -0.6)):
        assert (stand ^ drilled.translate(way)).volume() > 1
    assert max((stand.translate((0, -step, 0)) ^ drilled).volume() for step in STEPS_MM) < 1e-6


@pytest.mark.parametrize("lift", [0.0, 0.6, 2.0])
@pytest.mark.parametrize("gone", [0.0, 0.3])
def test_shells_sit_on_ridges_and_slide_out_along_their_pull(lift, gone):
    core, shells = mold(lift, gone)
    made = base(core, LEFT, MoldSettings(), shells)
    assert set(made.shell_cutters) == {"right", "left"}
    for shell in shells:
        grooved = shell.solid - made.shell_cutters[shell.name]
        assert len(grooved.decompose()) == 1
        assert (grooved ^ made.piece.solid).volume() < 1e-6
        moved = [grooved.translate(tuple(step * shell.pull)) ^ made.piece.solid for step in STEPS_MM]
        assert max(each.volume() for each in moved) < 1e-6
        sideways = grooved.translate((0, 0, 1.0)) ^ made.piece.solid
        assert sideways.volume() > 0.1


def test_base_and_socket_print_without_support_but_for_the_ridges_sinks():
    core, shells = mold()
    made = base(core, LEFT, MoldSettings(), shells)
    printer = profile(MoldSettings())
    standing = pose(made.piece.solid, Y, printer)
    assert standing.overhang_mm2 < 1
    assert standing.fits
    np.testing.assert_allclose(made.piece.printing[2], Y, atol=1e-12)
    np.testing.assert_allclose(made.piece.pull, -Y, atol=1e-12)
    roof = pose(core.land - made.core_cutter, Y, printer).overhang_mm2
    # facets of the roof are a hair flatter than its cone of 45 degrees; its blunt tip is 3 mm wide at most
    assert roof < 1.05 * sqrt(2) * d_area(21)


def test_the_sole_of_a_limb():
    land = upright(Manifold.cylinder(60, 30, 30, 180)).translate((7, -50, 0))
    centre, inradius, reach = sole(land, Y)
    np.testing.assert_allclose(centre, [7, -50, 0], atol=0.2)
    assert inradius == pytest.approx(30, abs=0.2)
    assert reach == pytest.approx(30, abs=0.3)


def test_the_plate_stays_on_a_small_bed():
    core, shells = mold()
    made = base(core, LEFT, MoldSettings(printer="formlabs_form3"), shells)
    assert pose(made.piece.solid, Y, profile(MoldSettings(printer="formlabs_form3"))).fits


def test_a_core_too_slim_for_a_locator_is_refused():
    land = upright(Manifold.cylinder(60, 10, 10, 90))
    core = Core(land, land, Manifold(), np.zeros((1, 3)), np.zeros((1, 3)), Y, np.zeros(3))
    with pytest.raises(GeometryError, match="too slim for a locator"):
        base(core, LEFT, MoldSettings())
    tip = Core(Manifold(), Manifold(), Manifold(), np.zeros((1, 3)), np.zeros((1, 3)), Y, np.zeros(3))
    with pytest.raises(GeometryError, match="no sole"):
        base(tip, LEFT, MoldSettings())
