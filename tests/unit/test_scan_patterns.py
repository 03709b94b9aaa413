"""Patterns: OpenCV's Gray code, cosines that decode, a manifest that says what was projected."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from hilbrace.errors import ConfigError, InputError
from hilbrace.scan.gray_code import add_bit, cell_middles
from hilbrace.scan.patterns import (
    PatternPlan,
    checked_plan,
    pattern_files,
    pattern_pictures,
    read_manifest,
    sequence,
    write_patterns,
)
from hilbrace.scan.phase_shift import phase_and_modulation, resolved


@pytest.mark.parametrize(
    "plan", [PatternPlan(1280, 720), PatternPlan(100, 70, 9, 3), PatternPlan(256, 64, 0, 0)]
)
def test_pictures_follow_the_sequence(plan):
    patterns, pictures = sequence(plan), pattern_pictures(plan)
    assert len(patterns) == len(pictures) == 2 + 2 * (plan.bits("column") + plan.bits("row") + plan.steps)
    for pattern, picture in zip(patterns, pictures, strict=True):
        assert picture.shape == (plan.height, plan.width)
        if pattern.axis:
            along = 1 if pattern.axis == "column" else 0
            assert (np.diff(picture.astype(int), axis=1 - along) == 0).all(), pattern.name
    for first, second, picture, inverse in zip(patterns, patterns[1:], pictures, pictures[1:], strict=False):
        if second.kind == "inverse":
            assert (first.kind, first.axis, first.index) == ("bit", second.axis, second.index)
            assert (picture.astype(int) + inverse == 255).all()


@pytest.mark.parametrize(("period", "steps"), [(16, 4), (8, 3), (24, 5), (100, 8)])
def test_every_pixel_of_the_projector_decodes_to_itself(period, steps):
    plan = PatternPlan(300, 200, period, steps)
    pictures = {
        (p.kind, p.axis, p.index): picture.astype(np.float32)
        for p, picture in zip(sequence(plan), pattern_pictures(plan), strict=True)
    }
    for axis, truth in (("column", np.arange(300)[None, :]), ("row", np.arange(200)[:, None])):
        code = np.zeros((200, 300), dtype=np.uint32)
        for bit in range(plan.bits(axis)):
            code = add_bit(code, pictures["bit", axis, bit], pictures["inverse", axis, bit])
        middle = cell_middles(code, plan.cell)
        assert np.abs(middle - truth).max() == (plan.cell - 1) / 2
        phase, _ = phase_and_modulation((pictures["phase", axis, n] for n in range(steps)), steps)
        place = resolved(phase * np.float32(period / (2 * np.pi)), middle, period)
        np.testing.assert_allclose(place, np.broadcast_to(truth, place.shape), atol=0.01 * period)


def test_our_decoder_agrees_with_that_of_opencv():
    plan = PatternPlan(128, 64, 0, 0)
    coder = cv2.structured_light.GrayCodePattern.create(plan.width, plan.height)
    random = np.random.default_rng(0)
    y, x = np.mgrid[:90, :120]
    seen_x = np.clip(20 + 0.8 * x + 3 * np.sin(y / 9), 0, 127).astype(np.float32)
    seen_y = np.clip(5 + 0.6 * y, 0, 63).astype(np.float32)
    seen = [
        (
            cv2.remap(picture, seen_x, seen_y, cv2.INTER_NEAREST) * 0.7 + 20 + random.normal(0, 2, (90, 120))
        ).astype(np.uint8)
        for picture in pattern_pictures(plan)[2:]
    ]
    codes = {}
    for axis, begin in (("column", 0), ("row", 14)):
        code = np.zeros((90, 120), dtype=np.uint32)
        for bit in range(plan.bits(axis)):
            code = add_bit(code, *(seen[begin + 2 * bit + k].astype(np.float32) for k in (0, 1)))
        codes[axis] = cell_middles(code, 1)
    for row, column in random.integers(0, 90, (60, 2)):
        failed, place = coder.getProjPixel(seen, int(column), int(row))
        assert not failed
        assert place == (codes["column"][row, column], codes["row"][row, column])


def test_written_patterns_are_read_back(tmp_path):
    plan = PatternPlan(320, 200, 16, 4)
    files = write_patterns(plan, tmp_path)
    assert files[:-2] == pattern_files(plan) == sorted(pattern_files(plan))
    assert read_manifest(tmp_path) == read_manifest(tmp_path / "manifest.json") == plan
    for name, picture in zip(pattern_files(plan), pattern_pictures(plan), strict=True):
        assert (cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED) == picture).all()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    write_patterns(plan, tmp_path)
    assert before == {path.name: path.read_bytes() for path in tmp_path.iterdir()}


def test_other_pictures_are_not_mixed_with_patterns(tmp_path):
    write_patterns(PatternPlan(320, 200), tmp_path)
    with pytest.raises(InputError, match="pictures of something else"):
        write_patterns(PatternPlan(320, 200, 16, 0), tmp_path)


@pytest.mark.parametrize(
    ("figures", "key"),
    [
        ((20, 720, 16, 4), "--projector"),
        ((1280, 99999, 16, 4), "--projector"),
        ((1280, 720, 4, 4), "--period"),
        ((1280, 720, 16, 2), "--steps"),
        ((1280, 720, 16, -1), "--steps"),
    ],
)
def test_what_cannot_be_decoded_is_refused(figures, key):
    with pytest.raises(ConfigError) as fault:
        checked_plan(*figures)
    assert fault.value.where == key


@pytest.mark.parametrize(
    "content", ["", "{}", "[1]", '{"width": "a", "height": 1, "period": 1, "steps": 1}', "\x00\x01"]
)
def test_a_broken_manifest_is_named(tmp_path, content):
    (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(InputError) as fault:
        read_manifest(tmp_path)
    assert "manifest.json" in fault.value.where
    with pytest.raises(InputError, match="no list"):
        read_manifest(tmp_path / "nowhere")


def test_a_manifest_out_of_range_is_refused(tmp_path):
    (tmp_path / "manifest.json").write_text(
        json.dumps({"width": 1280, "height": 720, "period": 3, "steps": 4})
    )
    with pytest.raises(ConfigError):
        read_manifest(tmp_path)
