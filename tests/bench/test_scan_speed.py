"""Time to decode a capture of 960 x 720 pixels under 44 patterns; 2 s are allowed."""

from __future__ import annotations

import cv2
import pytest

from hilbrace.scan.capture import open_capture
from hilbrace.scan.decode import decode_capture
from hilbrace.scan.patterns import PatternPlan, pattern_pictures
from mocks.scan_studio import leg_scene, make_rig, photograph

PLAN = PatternPlan(1280, 720)
SAMPLE = 300
"""Pixels given to OpenCV's decoder, which takes one a call."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("leg")
    photograph(leg_scene(), make_rig(), pattern_pictures(PLAN), out)
    return out


def test_decode(benchmark, folder):
    benchmark.pedantic(lambda: decode_capture(open_capture(folder, PLAN)), rounds=5, warmup_rounds=1)


def test_opencv_pixel_by_pixel(benchmark, folder):
    plan = PatternPlan(PLAN.width, PLAN.height, 16, 0)
    shots = photograph(leg_scene(), make_rig(), pattern_pictures(plan), folder / "gray")
    seen = [
        cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted((folder / "gray").glob("*.png"))[2:]
    ]
    coder = cv2.structured_light.GrayCodePattern.create(plan.width, plan.height)
    y, x = shots.lit.nonzero()
    step = len(x) // SAMPLE

    def once() -> None:
        for row, column in zip(y[::step], x[::step], strict=True):
            coder.getProjPixel(seen, int(column), int(row))

    benchmark.pedantic(once, rounds=3, warmup_rounds=1)
    benchmark.extra_info["whole_picture_s"] = benchmark.stats.stats.mean * len(x) / len(x[::step])
