"""Weights reach as far as a bent knee needs, and one leg never hangs on the skin of the other."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.body.bending import bends_whole, knee_area_ratios
from hilbrace.body.skinning import bind, one_leg
from tests.unit.body_people import person


def test_an_ordinary_person_keeps_the_first_length_and_a_short_heavy_one_gets_more():
    ordinary, heavy = person(), person(86.7, 1.70)
    assert ordinary.weight_smoothing_mm == 40.0
    assert heavy.weight_smoothing_mm > 40.0
    for body in (ordinary, heavy):
        assert bends_whole(body)
        for side in "rl":
            ratio = knee_area_ratios(body, side)
            assert 0.28 <= ratio.min() < 1.0 < ratio.max() <= 2.1


def test_too_little_smoothing_is_noticed():
    body = person(smoothing_mm=0.0)
    assert body.weight_smoothing_mm == 0.0
    assert not bends_whole(body)
    assert knee_area_ratios(body, "r", 0.0) == pytest.approx(1.0)


def test_points_where_the_thighs_touch_hang_on_their_own_leg():
    body = person(86.7, 1.70)
    thigh = body.bone_weights[:, body.bones.index("femur_l")] > 0.8
    points = body.vertices[thigh]
    inner = points[points[:, 2].argsort()[-60:]] + [0.0, 0.0, 0.02]
    other = [k for k, bone in enumerate(body.bones) if bone in ("femur_r", "tibia_r", "calcn_r")]
    assert bind(inner, body)[:, other].sum(axis=1).max() > 0.5
    assert bind(inner, one_leg(body, "l"))[:, other].sum(axis=1).max() < 0.2
    assert np.isin(one_leg(body, "l").triangles, body.triangles).all()
