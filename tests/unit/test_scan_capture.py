"""Folders of pictures: their order, and what is wrong with them, by name."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest

from hilbrace.errors import InputError
from hilbrace.scan.capture import open_capture
from hilbrace.scan.patterns import PatternPlan, sequence

PLAN = PatternPlan(64, 64, 0, 0)
COUNT = len(sequence(PLAN))


def fill(folder, names, shape=(80, 100), kind=np.uint8):
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(names):
        assert cv2.imwrite(str(folder / name), np.full(shape, number + 1, dtype=kind))
    return folder


def test_numbers_in_names_give_the_order(tmp_path):
    folder = fill(tmp_path / "view", [f"shot{number}.png" for number in range(COUNT)])
    (folder / "notes.txt").write_text("not a picture")
    capture = open_capture(folder, PLAN)
    assert [path.name for path in capture.files] == [f"shot{number}.png" for number in range(COUNT)]
    assert capture.size == (100, 80)
    assert capture.grey(10)[0, 0] == 11.0
    assert capture.files[capture.place("inverse", "column", 0)].name == "shot3.png"


def test_sixteen_bits_and_colours_become_grey_levels(tmp_path):
    folder = fill(tmp_path / "view", [f"{n:02d}.png" for n in range(COUNT)], kind=np.uint16)
    picture = np.zeros((80, 100, 3), dtype=np.uint16)
    picture[..., 2] = 65535
    cv2.imwrite(str(folder / "00.png"), picture)
    capture = open_capture(folder, PLAN)
    assert capture.grey(0)[0, 0] == pytest.approx(85.0)
    assert capture.brightest(0)[0, 0] == pytest.approx(255.0)
    assert capture.colours(0)[0, 0].tolist() == [255, 0, 0]


def test_a_missing_picture_is_named_by_the_gap(tmp_path):
    names = [f"IMG_{number:04d}.png" for number in range(7, 8 + COUNT) if number != 7 + 5]
    with pytest.raises(InputError) as fault:
        open_capture(fill(tmp_path / "view", names[: COUNT - 1]), PLAN)
    assert "pattern 5 (column_bit_02_inverse)" in fault.value.what
    assert "IMG_0011.png to IMG_0013.png" in fault.value.what
    assert str(tmp_path / "view") in fault.value.where


def test_missing_pictures_without_a_gap_are_counted(tmp_path):
    folder = fill(tmp_path / "view", [f"{n:02d}.png" for n in range(COUNT - 2)])
    with pytest.raises(InputError, match=f"{COUNT - 2} pictures for {COUNT} patterns.*row_bit_06"):
        open_capture(folder, PLAN)


def test_too_many_and_none(tmp_path):
    with pytest.raises(InputError, match=f"the first too many is {COUNT}.png"):
        open_capture(fill(tmp_path / "view", [f"{n:02d}.png" for n in range(COUNT + 1)]), PLAN)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no pictures"):
        open_capture(tmp_path / "empty", PLAN)
    with pytest.raises(InputError, match="no such folder"):
        open_capture(tmp_path / "nowhere", PLAN)


@pytest.mark.parametrize("content", [b"", b"not a picture", None])
def test_a_broken_picture_is_named(tmp_path, content):
    folder = fill(tmp_path / "view", [f"{n:02d}.png" for n in range(COUNT)])
    broken = folder / "03.png"
    broken.write_bytes(broken.read_bytes()[:30] if content is None else content)
    with pytest.raises(InputError, match="no readable picture") as fault:
        open_capture(folder, PLAN).grey(3)
    assert fault.value.where == str(broken)


def test_pictures_of_another_size_are_named(tmp_path):
    folder = fill(tmp_path / "view", [f"{n:02d}.png" for n in range(COUNT)])
    shutil.copy(fill(tmp_path / "other", ["a.png"], (80, 104)) / "a.png", folder / "07.png")
    with pytest.raises(InputError, match="104 x 80 pixels, the first picture has 100 x 80") as fault:
        open_capture(folder, PLAN).grey(7)
    assert fault.value.where.endswith("07.png")
