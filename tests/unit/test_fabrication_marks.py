import numpy as np
import pytest
from manifold3d import Manifold
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from fabrication.fixtures.marks import ADVANCE, CHARACTERS, DEPTH_MM, FONT, UP, label, label_width
from hilbrace.errors import GeometryError

X, Y, Z = np.eye(3)


def sheet_area(text, size):
    """Area of a text's outlines, by matplotlib's own reading of the font."""
    from matplotlib import get_data_path

    path = TextPath((0, 0), text, size=size, prop=FontProperties(fname=f"{get_data_path()}/fonts/ttf/{FONT}"))
    rings = [np.array(ring) for ring in path.to_polygons() if len(ring) > 2]
    return abs(
        sum(0.5 * np.sum(r[:, 0] * np.roll(r[:, 1], -1) - r[:, 1] * np.roll(r[:, 0], -1)) for r in rings)
    )


@pytest.mark.parametrize("text", ["CORE", "SHELL 1-L", f"R {UP}"])
def test_letters_are_those_of_the_font(text):
    drawn = label(text, np.zeros(3), Z, Y, 8.0, depth=0.6, above=0.4)
    assert drawn.volume() == pytest.approx(sheet_area(text, 8.0), rel=0.03)


def test_a_mark_is_as_deep_as_it_should_be_and_reads_from_outside():
    plate = Manifold.cube((40, 20, 5)).translate((-20, -10, -5))
    cut = plate - label("L", np.zeros(3), Z, Y, 10.0)
    floor = cut.trim_by_plane((0, 0, -1), DEPTH_MM)
    assert floor.volume() == pytest.approx(40 * 20 * (5 - DEPTH_MM))
    gone = (plate - cut).trim_by_plane((0, 1, 0), 1.0)
    # above the foot of an L only its stem is left, on the reader's left
    assert gone.volume() > 1
    assert gone.bounding_box()[3] < 0


@pytest.mark.parametrize("text", ["SHELL LATERAL L ↑", "KNEE-R"])
def test_marks_follow_a_curved_shell_and_leave_it_closed(text):
    shell = Manifold.cylinder(60, 46, 46, 360) - Manifold.cylinder(60, 40, 40, 360)
    tool = label(text, np.array([46.0, 0, 30]), X, Z, 6.0, onto=shell)
    cut = shell - tool
    assert len(cut.decompose()) == 1
    assert cut.genus() == shell.genus()
    # letters seen from the front: their outline's area, as deep as on a level face
    assert shell.volume() - cut.volume() == pytest.approx(DEPTH_MM * sheet_area(text, 6.0), rel=0.05)
    ring = Manifold.cylinder(60, 46 - DEPTH_MM - 0.05, 46 - DEPTH_MM - 0.05, 360)
    assert ((ring - cut) - Manifold.cylinder(60, 40, 40, 360)).volume() < 0.5


def test_a_raised_mark_is_one_with_its_piece():
    block = Manifold.cube((60, 20, 10)).translate((-30, -10, -10))
    raised = block + label("UP 12", np.zeros(3), Z, Y, 8.0, depth=0.5, above=DEPTH_MM)
    assert len(raised.decompose()) == 1
    assert raised.bounding_box()[5] == pytest.approx(DEPTH_MM)


def test_small_letters_become_capitals_and_strange_ones_spaces():
    assert label("core é", *(np.zeros(3), Z, Y), 8.0).volume() == pytest.approx(
        label("CORE  ", *(np.zeros(3), Z, Y), 8.0).volume()
    )
    assert label(" ", np.zeros(3), Z, Y, 8.0).is_empty()
    assert label(" ", np.zeros(3), Z, Y, 8.0, onto=Manifold.cube((1, 1, 1))).is_empty()


def test_a_mark_over_the_edge_is_refused():
    with pytest.raises(GeometryError, match="over an edge or a hole"):
        label(
            "TOO LONG A NAME",
            np.zeros(3),
            Z,
            Y,
            8.0,
            onto=Manifold.cube((20, 20, 20)).translate((-10, -10, -20)),
        )


def test_all_letters_are_of_one_width():
    from matplotlib import get_data_path
    from matplotlib.ft2font import FT2Font, LoadFlags

    font = FT2Font(f"{get_data_path()}/fonts/ttf/{FONT}")
    for character in CHARACTERS:
        glyph = font.load_char(ord(character), flags=LoadFlags.NO_SCALE)
        assert glyph.horiAdvance / font.units_per_EM == pytest.approx(ADVANCE, abs=1e-3)
    assert label_width("ABC", 10.0) == pytest.approx(3 * ADVANCE * 10)
