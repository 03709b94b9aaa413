"""The drilled and added parts, held against the closed forms of their volumes and the standards' sizes."""

from math import cos, pi, radians, sqrt, tan

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.fixtures import Place, bolts, dowels, jack_slots, keys, luer_port, pin_diameter
from fabrication.fixtures.bolt import (
    BEYOND_MM,
    SEAT_MM,
    UNDER_NUT_MM,
    grip,
    least_thickness,
    pocket_flats,
    under_nut,
)
from fabrication.fixtures.cad import ANGLE_RAD
from fabrication.fixtures.dowel import SPARE_MM, WALL_MM
from fabrication.fixtures.jack import DEPTH_MM, GAP_MM, WIDTH_MM
from fabrication.fixtures.key import BASE_MM, EMBEDDED_MM, OVERSHOOT_MM, half_angle, key_height
from fabrication.fixtures.luer import BOSS_MM, BOSS_RISE_MM, CONE_MM, MOUTH_MM, NOSE_MM, reach
from fabrication.fixtures.luer import OVERSHOOT_MM as BORE_OVERSHOOT_MM
from fabrication.hardware import FASTENERS, fastener
from fabrication.mold import Hardware
from hilbrace.config import MoldSettings
from hilbrace.errors import ConfigError, GeometryError

STEPS_MM = (0.25, 0.5, 1, 2, 4, 8, 16, 32, 64, 128)

INSCRIBED = ANGLE_RAD**2 / 6
"""Part of a disc's area by which a polygon with sides of this angle falls short: 1 - sin(a) / a."""


def place(point=(0, 0, 0), direction=(0, 0, 1), outward=(1, 0, 0), thickness=6.0, slant=0.0):
    vectors = (np.asarray(v, float) for v in (point, direction, outward))
    return Place(*vectors, ("first", "second"), thickness, slant)


def frustum(low, high, height):
    return pi * height / 3 * (low**2 + low * high + high**2)


def inscribed(value):
    """The volume of a round body, as a polygon inside it has it."""
    return pytest.approx(value * (1 - INSCRIBED / 2), rel=INSCRIBED / 2 + 1e-6)


def flanges(thickness=6.0, size=30.0):
    second = Manifold.cube((size, size, thickness)).translate((-size / 2, -size / 2, 0))
    return second.mirror((0, 0, 1)), second


@pytest.mark.parametrize("bolt", [3.0, 4.0, 5.0, 6.0])
@pytest.mark.parametrize("printer", ["prusa_mk4", "formlabs_form3"])
def test_a_bolt_hole_takes_the_bolt_the_nut_and_the_washer_of_the_standards(bolt, printer):
    settings, sizes = MoldSettings(bolt_mm=bolt, printer=printer), fastener(bolt)
    thickness = max(6.0, least_thickness(sizes))
    clearance = 0.2 if printer == "prusa_mk4" else 0.1
    cutter, _ = bolts([place(thickness=thickness)], settings)
    flats = sizes.flats + 2 * clearance
    assert pocket_flats(sizes, clearance) == pytest.approx(flats)
    far, low = thickness + BEYOND_MM, under_nut(sizes, thickness)
    seat = thickness - SEAT_MM
    volume = (
        sqrt(3) / 2 * flats**2 * (far - low)
        + pi / 4 * sizes.hole**2 * (low + seat)
        + pi / 4 * (sizes.washer + 2 * clearance) ** 2 * (far - seat)
    )
    assert cutter.volume() == inscribed(volume)
    assert len(cutter.decompose()) == 1
    # sections: nut below, hole through the parting face, seat above
    assert cutter.slice(-low - 0.1).area() == pytest.approx(sqrt(3) / 2 * flats**2, rel=1e-6)
    assert cutter.slice(0).area() == inscribed(pi / 4 * sizes.hole**2)


@pytest.mark.parametrize("sizes", FASTENERS.values(), ids=lambda sizes: sizes.name)
@pytest.mark.parametrize("clearance", [0.1, 0.2])
def test_the_nut_goes_in_and_cannot_turn(sizes, clearance):
    assert sizes.flats < pocket_flats(sizes, clearance) < sizes.corners


def test_the_bolt_reaches_through_the_nut_and_is_bought_with_nut_and_washer():
    _, bought = bolts([place(), place((0, 40, 0))], MoldSettings())
    # washer 0.8, flange 6 less seat 1, wall under the nut 2.8, nut 3.2
    assert grip(fastener(4), 6.0) == pytest.approx(11.8)
    assert bought == (
        Hardware(2, "M4 x 12 socket head bolt, ISO 4762"),
        Hardware(2, "M4 nut, ISO 4032"),
        Hardware(2, "M4 washer, ISO 7089"),
    )


def test_bolts_stand_where_they_are_told():
    point, way = np.array([10.0, 20, 30]), np.array([1.0, 2, 2]) / 3
    cutter, _ = bolts([place(point, way, (0, 0, 1))], MoldSettings())
    inside = Manifold.sphere(0.5, 16)
    for along, radius, taken in ((0, 2.0, True), (0, 2.6, False), (6, 4.5, True), (-6, 4.5, False)):
        across = np.cross(way, [0, 0, 1.0])
        at = point + along * way + radius * across / np.linalg.norm(across)
        assert ((inside.scale((0.2,) * 3).translate(tuple(at)) - cutter).volume() < 1e-9) == taken


def test_flanges_with_bolts_stay_whole():
    cutter, _ = bolts([place((-7, 0, 0)), place((7, 0, 0))], MoldSettings())
    for flange in flanges():
        drilled = flange - cutter
        assert len(drilled.decompose()) == 1
        assert drilled.genus() == 2


def test_no_bolts_no_cutter():
    cutter, bought = bolts([], MoldSettings())
    assert cutter.is_empty()
    assert bought == ()


def test_a_flange_too_thin_for_the_nut_is_refused():
    assert least_thickness(fastener(6)) == pytest.approx(5.2 + UNDER_NUT_MM)
    with pytest.raises(GeometryError, match="too thin for the nut of an M6 bolt") as caught:
        bolts([place()], MoldSettings(bolt_mm=6))
    assert "first and second" in caught.value.where
    with pytest.raises(ConfigError, match="no metric bolt"):
        bolts([place()], MoldSettings(bolt_mm=4.2))


@pytest.mark.parametrize("slant", [0.0, 30.0, 45.0, 60.0])
def test_keys_are_cones_that_fit_their_sockets_with_a_clearance(slant):
    angle, clearance = half_angle(slant), 0.2
    adders, cutters = keys([place(slant=slant)], MoldSettings())
    assert set(adders) == {"first"}
    assert set(cutters) == {"second"}
    height, slope = key_height(angle), tan(radians(angle))
    pin = frustum(BASE_MM, BASE_MM - height * slope, height) + pi * BASE_MM**2 * EMBEDDED_MM
    assert adders["first"].volume() == inscribed(pin)
    wide, deep = BASE_MM + clearance / cos(radians(angle)), height + clearance
    socket = frustum(wide, wide - deep * slope, deep) + pi * wide**2 * OVERSHOOT_MM
    assert cutters["second"].volume() == inscribed(socket)
    first, second = flanges()
    male, female = first + adders["first"], second - cutters["second"]
    assert len(male.decompose()) == len(female.decompose()) == 1
    assert (male ^ female).volume() < 1e-9
    assert male.min_gap(female.trim_by_plane((0, 0, 1), 0.5), 1.0) == pytest.approx(clearance, rel=0.05)


@pytest.mark.parametrize("slant", [0.0, 30.0, 45.0, 60.0])
@pytest.mark.parametrize("azimuth", [0.0, 77.0, 180.0])
def test_a_key_leaves_its_socket_along_every_pull_up_to_its_slant(slant, azimuth):
    first, second = flanges()
    adders, cutters = keys([place(slant=slant)], MoldSettings())
    male, female = first + adders["first"], second - cutters["second"]
    tilt, turn = radians(slant), radians(azimuth)
    pull = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    moved = [(female.translate(tuple(step * pull)) ^ male).volume() for step in STEPS_MM]
    assert max(moved) < 1e-9


def test_a_key_too_steep_for_the_pull_is_what_the_slant_prevents():
    first, second = flanges()
    adders, cutters = keys([place(slant=0.0)], MoldSettings())
    pull = np.array([np.sin(radians(45)), 0, np.cos(radians(45))])
    moved = (second - cutters["second"]).translate(tuple(1.0 * pull))
    assert (moved ^ (first + adders["first"])).volume() > 0.1


@pytest.mark.parametrize(("shells", "least"), [(2, 0.0), (3, 30.0), (4, 45.0)])
def test_half_angles_follow_the_rule_of_equal_sectors(shells, least):
    assert 90 - 180 / shells == pytest.approx(least)
    assert half_angle(least) >= least + 5


def test_keys_that_cannot_be_are_refused():
    with pytest.raises(GeometryError, match="no key could leave its socket"):
        keys([place(slant=75.0)], MoldSettings())
    with pytest.raises(GeometryError, match="too thin for a key"):
        keys([place(thickness=4.0)], MoldSettings())


def test_keys_of_several_flanges_go_to_their_pieces():
    other = Place(*(np.eye(3)[i] for i in (0, 1, 2)), ("second", "third"), 6.0)
    adders, cutters = keys([place(), place((0, 20, 0)), other], MoldSettings())
    assert {name: len(body.decompose()) for name, body in adders.items()} == {"first": 2, "second": 1}
    assert {name: len(body.decompose()) for name, body in cutters.items()} == {"second": 2, "third": 1}


def test_the_port_has_the_taper_of_iso_80369_7():
    wall = 6.0
    boss, bore = luer_port(np.zeros(3), np.array([0.0, 0, 1]), wall)
    mouth = reach(wall)
    areas = [bore.slice(mouth - depth).area() for depth in (0.5, 8.5)]
    wide, narrow = (2 * sqrt(area / pi) for area in areas)
    assert (wide - narrow) / 8 == pytest.approx(0.06, rel=5e-3)
    assert wide == pytest.approx(4.5 - 0.03, rel=1e-3)
    assert 2 * sqrt(bore.slice(1.0).area() / pi) == pytest.approx(3.96, rel=1e-3)
    # a male cone is 3.925 to 3.990 mm wide at its tip: the tip seats inside the cone
    seat = (MOUTH_MM - 3.99) / 0.06
    assert 7.5 < seat < CONE_MM
    assert boss.volume() == inscribed(
        pi / 4 * (BOSS_MM**2 * (wall / 2 + BOSS_RISE_MM) + NOSE_MM**2 * CONE_MM)
    )
    straight = pi / 4 * 3.96**2 * (mouth - CONE_MM + BORE_OVERSHOOT_MM)
    cone = frustum(1.98, MOUTH_MM / 2 + 0.03 * BORE_OVERSHOOT_MM, CONE_MM + BORE_OVERSHOOT_MM)
    assert bore.volume() == inscribed(straight + cone)


def test_a_port_in_a_curved_shell_leaves_it_whole_with_one_way_through():
    shell = Manifold.cylinder(60, 46, 46, 180) - Manifold.cylinder(60, 40, 40, 180)
    boss, bore = luer_port(np.array([40.0, 0, 30]), np.array([1.0, 0, 0]), 6.0)
    with_port = (shell + boss) - bore
    assert len(with_port.decompose()) == 1
    assert with_port.genus() == shell.genus() + 1
    # the boss stays out of the cavity
    assert (boss ^ Manifold.cylinder(60, 42, 42, 180)).volume() < 1e-9


def test_jack_slots_open_at_the_edge_in_both_flanges():
    cutter = jack_slots([place((15, 0, 0))])
    for flange in flanges():
        slotted = flange - cutter
        assert len(slotted.decompose()) == 1
        assert flange.volume() - slotted.volume() == pytest.approx(DEPTH_MM * WIDTH_MM * GAP_MM / 2)
        assert slotted.genus() == 0


def test_dowel_holes_take_the_pins_that_are_bought():
    cutter, bought = dowels([place(thickness=30.0), place((10, 0, 0), thickness=30.0)], 6.0, MoldSettings())
    room = 2 * (30.0 - SPARE_MM - WALL_MM)
    assert room == 56
    assert bought == (Hardware(2, "6 x 50 dowel pin, ISO 2338"),)
    assert cutter.volume() == inscribed(2 * pi * 3.2**2 * (50 + 2 * SPARE_MM))
    box = np.reshape(cutter.bounding_box(), (2, 3))
    np.testing.assert_allclose(box[:, 2], [-25.5, 25.5])


def test_pins_leave_enough_of_the_wall():
    assert pin_diameter(6.5, 0.2) == 3.0
    assert pin_diameter(7.4, 0.2) == 4.0
    assert pin_diameter(100.0, 0.2) == 8.0
    with pytest.raises(GeometryError, match="too thin for a dowel pin"):
        pin_diameter(6.0, 0.2)
