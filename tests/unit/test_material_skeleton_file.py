"""Skeleton files: the built-in ones, one of the user's, and every way to break one."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.config.material import CELLS
from hilbrace.errors import ConfigError, HilbraceError, InputError
from hilbrace.material.cells import cell_distance
from hilbrace.material.skeleton_file import FOLDER, parse_skeleton, read_skeleton

CROSS = "polylines = [[[0.5, 0], [0.5, 1]], [[0, 0.5], [1, 0.5]]]\n"


def test_every_name_has_its_file_and_every_file_its_name():
    assert sorted(path.stem for path in FOLDER.glob("*.toml")) == sorted(CELLS)
    titles = [read_skeleton(name).title for name in CELLS]
    assert len(set(titles)) == len(CELLS)


def test_a_users_file_is_read_by_its_path(tmp_path):
    path = tmp_path / "cross.toml"
    path.write_text('title = "My cross"\n' + CROSS, "utf-8")
    skeleton = read_skeleton(str(path))
    assert skeleton.title == "My cross"
    assert skeleton.volume_range is None
    assert np.array_equal(skeleton.segments, read_skeleton("square").segments)
    u = np.linspace(0, 1, 50)
    assert np.array_equal(cell_distance(str(path), u, u), cell_distance("square", u, u))


def test_a_changed_file_gives_a_changed_distance(tmp_path):
    path = tmp_path / "cross.toml"
    path.write_text(CROSS, "utf-8")
    corner = np.zeros(1)
    before, digest = cell_distance(str(path), corner, corner), read_skeleton(str(path)).digest
    path.write_text(CROSS.replace("0.5, 0]", "0.4, 0]").replace("0.5, 1]", "0.4, 1]"), "utf-8")
    assert cell_distance(str(path), corner, corner) < before
    assert read_skeleton(str(path)).digest != digest


BROKEN = {
    "open gap": (
        "polylines = [[[0.5, 0], [0.5, 1]], [[0, 0.5], [0.49, 0.5]], [[0.5, 0.5], [1, 0.5]]]",
        "polylines[1]",
        "open gap: a strut ends in nothing at (0.49, 0.5), 0.01 cell sides from the next one",
    ),
    "lone dead end": (
        "polylines = [[[0.5, 0], [0.5, 0.5]]]",
        "polylines[0]",
        "ends in nothing at (0.5, 0.5)",
    ),
    "outside": ("polylines = [[[0, 0.5], [1.2, 0.5]]]", "polylines[0][1]", "outside of the unit cell"),
    "nan": ("polylines = [[[0, 0.5], [nan, 0.5]]]", "polylines[0][1]", "not finite"),
    "infinite": ("polylines = [[[0, 0.5], [inf, 0.5]]]", "polylines[0][1]", "not finite"),
    "in two parts": (
        "polylines = [[[0, 0.2], [1, 0.2]], [[0, 0.8], [1, 0.8]]]",
        "polylines",
        "2 parts that never touch",
    ),
    "mirror images apart": (
        "polylines = [[[0, 0.5], [1, 0.5]]]",
        "polylines",
        "does not reach the lower side",
    ),
    "closed ring": (
        "polylines = [[[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.2]]]",
        "polylines",
        "does not reach the left side",
    ),
    "unknown key": (CROSS + "polyline = []", "polyline", "unknown key 'polyline'"),
    "nothing drawn": ('title = "empty"', "polylines", "draws nothing"),
    "empty list": ("polylines = []", "polylines", "at least one entry"),
    "one point": ("polylines = [[[0, 0.5]]]", "polylines[0]", "at least 2 points"),
    "text point": ('polylines = [[[0, 0.5], "b"]]', "polylines[0][1]", "'b' is no point"),
    "three numbers": ("polylines = [[[0, 0, 0], [1, 1]]]", "polylines[0][0]", "is no point"),
    "boolean": ("polylines = [[[0, true], [1, 1]]]", "polylines[0][0]", "is no point"),
    "same point twice": ("polylines = [[[0, 0.5], [0, 0.5], [1, 0.5]]]", "polylines[0]", "are the same"),
    "one seed": ("voronoi_seeds = [[0.5, 0.5]]", "voronoi_seeds", "at least 2 points"),
    "wave too high": ("waves = [{ amplitude = 0.6, half_waves = 2 }]", "waves[0].amplitude", "leaves"),
    "half a wave": ("waves = [{ amplitude = 0.2, half_waves = 1.5 }]", "waves[0].half_waves", "1.5"),
    "unknown wave key": ("waves = [{ amplitude = 0.2, phase = 1 }]", "waves[0]", "is no wave"),
    "range upside down": (CROSS + "volume_range = [0.6, 0.1]", "volume_range", "[0.6, 0.1]"),
    "range of one": (CROSS + "volume_range = [0.6]", "volume_range", "is no range"),
    "title is a number": (CROSS + "title = 3", "title", "3 is no text"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_broken_skeletons_are_refused_by_file_and_key(fault, tmp_path):
    text, key, what = BROKEN[fault]
    path = tmp_path / "mine.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError) as error:
        read_skeleton(str(path))
    assert what in error.value.what
    assert error.value.where == f"{path}: {key}"
    assert error.value.hint


def test_missing_and_unreadable_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml"):
        read_skeleton(str(tmp_path / "none.toml"))
    path = tmp_path / "mine.toml"
    path.write_text("polylines = [[", "utf-8")
    with pytest.raises(InputError, match="not valid TOML"):
        read_skeleton(str(path))
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not valid TOML"):
        read_skeleton(str(path))


def test_a_misspelt_name_brings_the_right_one():
    with pytest.raises(ConfigError, match="no microstructure named 'hexagon'"):
        read_skeleton("hexagon")
    with pytest.raises(ConfigError) as error:
        read_skeleton("honeycom")
    assert "did you mean 'honeycomb'?" in error.value.hint


VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-3, 3), st.floats(-2, 2), st.text(max_size=3)),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=12,
)


@given(st.dictionaries(st.sampled_from(["polylines", "voronoi_seeds", "waves", "volume_range"]), VALUES))
def test_whatever_a_file_says_it_is_read_or_refused_by_name(content):
    where = "mine.toml: (none)"
    try:
        parse_skeleton(content, "mine.toml")
    except HilbraceError as error:
        where = error.where
    assert where.startswith("mine.toml: ")


def test_written_by_hand_and_drawn_by_seeds_agree(tmp_path):
    segments = read_skeleton("voronoi_open").segments
    text = "polylines = " + str(segments.tolist())
    assert np.array_equal(parse_skeleton(tomllib.loads(text), "mine").segments, segments)
