import pytest

from fabrication.printers import MARGIN_MM, PRINTERS, profile
from hilbrace.config import MoldSettings
from hilbrace.errors import ConfigError

MAKERS_FIGURES = {
    "prusa_mk4": (250, 210, 220),
    "bambu_x1": (256, 256, 256),
    "ender3": (220, 220, 250),
    "formlabs_form3": (145, 145, 185),
}
"""Build volumes that the makers state [mm]."""


@pytest.mark.parametrize(("name", "bed"), MAKERS_FIGURES.items())
def test_beds_are_those_that_the_makers_state(name, bed):
    printer = profile(MoldSettings(printer=name))
    assert (printer.width_mm, printer.depth_mm, printer.height_mm) == bed
    assert printer.usable_mm == tuple(length - MARGIN_MM for length in bed)


def test_every_profile_is_tested():
    assert set(PRINTERS) == set(MAKERS_FIGURES)


def test_the_default_printer_leaves_a_bed_of_250_210_210():
    assert all(a <= b for a, b in zip(profile(MoldSettings()).usable_mm, (250, 210, 210), strict=True))


def test_resin_fits_tighter_and_prints_flatter_overhangs_than_beads():
    fdm, sla = (profile(MoldSettings(printer="200x200x200", process=process)) for process in ("fdm", "sla"))
    assert (fdm.clearance_mm, sla.clearance_mm) == (0.2, 0.1)
    assert (fdm.min_wall_mm, sla.min_wall_mm) == (0.8, 0.5)
    assert (fdm.overhang_deg, sla.overhang_deg) == (45.0, 19.0)
    assert profile(MoldSettings(printer="formlabs_form3")).clearance_mm == sla.clearance_mm


@pytest.mark.parametrize("text", ["300x200.5x400", "300 x 200.5 x 400 mm", "300×200.5×400"])
def test_a_bed_of_your_own(text):
    printer = profile(MoldSettings(printer=text))
    assert (printer.width_mm, printer.depth_mm, printer.height_mm) == (300, 200.5, 400)
    assert printer.process == "fdm"
    assert printer.name == "300x200.5x400"


@pytest.mark.parametrize(
    "text", ["prusa", "250x210", "0x210x210", "10x10x10", "9000x210x210", "1.2.3x210x210", ""]
)
def test_no_such_printer(text):
    with pytest.raises(ConfigError, match="no printer") as caught:
        profile(MoldSettings(printer=text))
    assert "prusa_mk4" in caught.value.hint
    assert "250x210x220" in caught.value.hint


def test_a_printer_cannot_do_what_it_is_not():
    with pytest.raises(ConfigError, match="prints by fdm, not by sla") as caught:
        profile(MoldSettings(process="sla"))
    assert "250x210x220" in caught.value.hint
