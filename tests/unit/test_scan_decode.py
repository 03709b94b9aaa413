"""Decoded captures of a rendered leg, and every fault that a laboratory makes."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from hilbrace.errors import InputError
from hilbrace.scan.capture import open_capture
from hilbrace.scan.decode import decode_capture
from hilbrace.scan.exposure import picture_noise
from hilbrace.scan.patterns import PatternPlan, pattern_pictures, sequence
from mocks.scan_studio import Light
from tests.unit.scan_scenes import SMALL, exposed, leg, leg_pictures, rms, store

NUMBER = {(p.kind, p.axis, p.index): k for k, p in enumerate(sequence(SMALL))}


def decoded(tmp_path, pictures, plan=SMALL):
    return decode_capture(open_capture(store(pictures, tmp_path / "leg"), plan))


def refused(tmp_path, pictures, plan=SMALL):
    with pytest.raises(InputError) as fault:
        decoded(tmp_path, pictures, plan)
    return fault.value


def exchanged(pictures, one, other):
    order = list(pictures)
    order[one], order[other] = order[other], order[one]
    return tuple(order)


def test_pixels_of_the_projector_are_found_with_the_error_that_is_expected(tmp_path):
    view, (_, shot) = decoded(tmp_path, leg_pictures()), leg()
    assert view.valid[shot.lit].mean() > 0.85
    assert (view.valid & ~shot.lit).sum() < 0.02 * view.valid.sum()
    both = view.valid & shot.lit
    for found, axis in ((view.column, 0), (view.row, 1)):
        off = (found - shot.projector[..., axis])[both]
        assert abs(np.median(off)) < 0.02
        assert rms(off) < 0.2
        assert 0.5 < np.median(np.abs(off)) / (0.6745 * np.median(view.error[both])) < 1.6
    assert view.agreement > 0.95
    assert view.noise == pytest.approx(Light().noise, rel=0.2)


def test_gray_code_alone_finds_the_pixel(tmp_path):
    plan = PatternPlan(SMALL.width, SMALL.height, 16, 0)
    view, (_, shot) = decoded(tmp_path, leg_pictures(plan=plan), plan), leg()
    both = view.valid & shot.lit
    off = (view.column - shot.projector[..., 0])[both]
    assert np.median(np.abs(off)) < 0.6
    assert (np.abs(off) < 2.0).mean() > 0.95


def test_decoding_repeats_to_the_bit(tmp_path):
    one, other = decoded(tmp_path / "a", leg_pictures()), decoded(tmp_path / "b", leg_pictures())
    assert one.column.tobytes() == other.column.tobytes()
    assert one.error.tobytes() == other.error.tobytes()


def test_over_exposed_pictures_are_refused(tmp_path):
    fault = refused(tmp_path, leg_pictures(light=Light(gain=900.0)))
    assert "over-exposed" in fault.what
    assert fault.where.endswith("IMG_0000.png")
    assert "exposure" in fault.hint


def test_a_shining_spot_is_left_out(tmp_path):
    pictures, spot = [picture.copy() for picture in leg_pictures()], (slice(150, 170), slice(190, 210))
    for picture in pictures:
        picture[spot] = 255
    view = decoded(tmp_path, tuple(pictures))
    assert not view.valid[spot].any()
    assert view.valid.sum() > 0.9 * leg()[1].lit.sum() * 0.85


def test_dark_pictures_are_refused(tmp_path):
    fault = refused(tmp_path, leg_pictures(light=Light(gain=5.0)))
    assert "brighter" in fault.what
    assert "expose longer" in fault.hint


def test_white_and_black_exchanged(tmp_path):
    assert "white, then black" in refused(tmp_path, exchanged(leg_pictures(), 0, 1)).hint


@pytest.mark.parametrize("axis", ["column", "row"])
@pytest.mark.parametrize("bit", [0, 1, 3])
def test_a_pattern_and_its_inverse_exchanged(tmp_path, axis, bit):
    one, other = NUMBER["bit", axis, bit], NUMBER["inverse", axis, bit]
    fault = refused(tmp_path, exchanged(leg_pictures(), one, other))
    assert f"IMG_{one:04d}.png and IMG_{other:04d}.png" in fault.what
    assert "exchanged" in fault.what
    assert fault.where == str(tmp_path / "leg")


@pytest.mark.parametrize(("one", "other"), [(0, 1), (1, 2), (2, 4), (0, 5)])
def test_two_pairs_exchanged(tmp_path, one, other):
    pictures = leg_pictures()
    for kind in ("bit", "inverse"):
        pictures = exchanged(pictures, NUMBER[kind, "column", one], NUMBER[kind, "column", other])
    fault = refused(tmp_path, pictures)
    first, second = (f"IMG_{NUMBER['bit', 'column', bit]:04d}.png" for bit in (one, other))
    assert f"pair {first}" in fault.what
    assert f"pair {second}" in fault.what


def test_two_single_pictures_exchanged(tmp_path):
    one, other = NUMBER["bit", "column", 2], NUMBER["inverse", "column", 4]
    fault = refused(tmp_path, exchanged(leg_pictures(), one, other))
    assert fault.what == f"IMG_{one:04d}.png and IMG_{other:04d}.png seem to be exchanged"


@pytest.mark.parametrize(("one", "other"), [(0, 1), (1, 3)])
def test_two_cosines_exchanged(tmp_path, one, other):
    first, second = (NUMBER["phase", "column", step] for step in (one, other))
    fault = refused(tmp_path, exchanged(leg_pictures(), first, second))
    assert f"IMG_{first:04d}.png and IMG_{second:04d}.png" in fault.what


def test_a_picture_taken_twice(tmp_path):
    pictures = list(leg_pictures())
    pictures[NUMBER["inverse", "row", 1]] = pictures[NUMBER["bit", "row", 1]]
    fault = refused(tmp_path, tuple(pictures))
    assert f"IMG_{NUMBER['inverse', 'row', 1]:04d}.png" in fault.what
    assert "taken twice" in fault.hint


def test_a_camera_one_pattern_behind(tmp_path):
    pictures = leg_pictures()
    assert refused(tmp_path, (pictures[0], *pictures[:-1]))


def test_patterns_of_another_period(tmp_path):
    plan = dataclasses.replace(SMALL, period=20)
    assert plan.cell == SMALL.cell
    assert "contradict" in (what := refused(tmp_path, leg_pictures(), plan).what) or "agree on" in what


def test_the_noise_of_a_picture_is_measured():
    random = np.random.default_rng(0)
    y, x = np.mgrid[:200, :300]
    scene = 40 + 0.2 * x + 0.1 * y + 60 * (x > 150)
    picture = (scene + random.normal(0, 3.0, scene.shape)).astype(np.float32)
    assert picture_noise(picture) == pytest.approx(3.0, rel=0.05)


def test_every_pattern_was_photographed():
    assert len(leg_pictures()) == len(pattern_pictures(SMALL))
    assert cv2.countNonZero(leg_pictures()[0]) > 0
    assert exposed(leg()[1], SMALL, Light(), 0)[3].shape == (360, 480)
