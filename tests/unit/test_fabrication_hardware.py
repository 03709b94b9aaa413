import pytest

from fabrication.hardware import (
    BOLT_LENGTHS,
    FASTENERS,
    PIN_LENGTHS,
    bolt_length,
    fastener,
    pin_length,
    shopping_list,
)
from fabrication.mold import Hardware
from hilbrace.errors import ConfigError, GeometryError

STANDARDS = {
    # head dk and k of ISO 4762, flats s, corners e and height m of ISO 4032, medium hole of ISO 273
    3: (5.5, 3.0, 5.5, 6.01, 2.4, 3.4),
    4: (7.0, 4.0, 7.0, 7.66, 3.2, 4.5),
    5: (8.5, 5.0, 8.0, 8.79, 4.7, 5.5),
    6: (10.0, 6.0, 10.0, 11.05, 5.2, 6.6),
}


@pytest.mark.parametrize(("size", "figures"), STANDARDS.items())
def test_sizes_are_those_of_the_standards(size, figures):
    bolt = fastener(size)
    found = bolt.head, bolt.head_height, bolt.flats, bolt.corners, bolt.nut_height, bolt.hole
    assert found == figures
    assert bolt.name == f"M{size}"


@pytest.mark.parametrize("bolt", FASTENERS.values(), ids=lambda bolt: bolt.name)
def test_what_holds_for_every_fastener(bolt):
    assert bolt.size < bolt.hole < bolt.washer
    assert bolt.head <= bolt.washer
    assert bolt.head_height == bolt.size
    # a regular hexagon is 2 / sqrt(3) as wide across corners; the standard takes a little off for chamfers
    assert 1.07 < bolt.corners / bolt.flats < 2 / 3**0.5


def test_no_such_bolt():
    with pytest.raises(ConfigError, match=r"no metric bolt of 4\.2 mm") as caught:
        fastener(4.2)
    assert caught.value.where == "mold.bolt_mm"


def test_bolts_are_long_enough_and_no_longer_than_needed():
    for grip in (3.0, 11.8, 12.0, 12.1, 99.0):
        length = bolt_length(grip)
        assert length >= grip
        assert all(shorter < grip for shorter in BOLT_LENGTHS if shorter < length)
    with pytest.raises(GeometryError, match="101 mm long"):
        bolt_length(101.0)


def test_pins_fit_their_holes():
    for diameter, lengths in PIN_LENGTHS.items():
        assert pin_length(diameter, lengths[0]) == lengths[0]
        assert pin_length(diameter, 1000.0) == lengths[-1]
        with pytest.raises(GeometryError, match="no dowel pin"):
            pin_length(diameter, lengths[0] - 0.1)


def test_a_shopping_list_adds_up_what_is_the_same():
    bought = [Hardware(2, "bolt"), Hardware(3, "nut"), Hardware(4, "bolt"), Hardware(0, "pin")]
    assert shopping_list(bought) == (Hardware(6, "bolt"), Hardware(3, "nut"))
