"""Hip models against their published formulas, and what each does to the angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.hip_models import depth_under_skin, harrington, hip_centre
from evaluation.protocol import HipSettings, MarkerLabels
from evaluation.tracking import track
from hilbrace.body.body import Body
from hilbrace.errors import ConfigError, InputError
from hilbrace.run.records import save
from tests.unit.evaluation_leg import calibrated, moving, protocol, table

LABELS = MarkerLabels(left_asis="LASI", right_asis="RASI", left_psis="LPSI", right_psis="RPSI")
POINTS = {
    "HIP": np.array([0.02, 0.9, -0.18]),
    "KNL": np.array([0.0, 0.5, -0.14]),
    "KNM": np.array([0.0, 0.5, -0.04]),
    "LASI": np.array([0.1, 1.0, -0.12]),
    "RASI": np.array([0.1, 1.0, 0.12]),
    "LPSI": np.array([-0.06, 1.0, -0.05]),
    "RPSI": np.array([-0.06, 1.0, 0.05]),
}
RIGHT = {name: point * [1, 1, -1] for name, point in POINTS.items()} | {
    "LASI": POINTS["LASI"],
    "RASI": POINTS["RASI"],
    "LPSI": POINTS["LPSI"],
    "RPSI": POINTS["RPSI"],
}


def centre(side="left", points=None, **settings):
    points = points or (POINTS if side == "left" else RIGHT)
    return hip_centre(points, LABELS, HipSettings(**settings), side)


def test_the_marker_itself():
    assert centre(model="marker").tolist() == [0.02, 0.9, -0.18]


def test_a_quarter_of_the_trochanters_distance_towards_the_middle():
    found = centre(model="trochanter", trochanter_width_m=0.36, marker_radius_m=0.007)
    assert found == pytest.approx([0.02, 0.9, -0.18 + 0.09 + 0.007])


def test_a_stated_offset_follows_the_knees_direction():
    assert centre(model="offset", offset_m=(0.01, 0.02, 0.05)) == pytest.approx([0.03, 0.92, -0.13])
    turned = POINTS | {"KNL": np.array([0.05, 0.5, -0.09]), "KNM": np.array([-0.05, 0.5, -0.09])}
    found = centre(points=turned, model="offset", offset_m=(0.0, 0.0, 0.05))
    assert found == pytest.approx([-0.03, 0.9, -0.18])


def test_bell_takes_shares_of_the_width_between_the_spines():
    width = 0.24
    assert centre(model="bell") == pytest.approx([0.1 - 0.19 * width, 1 - 0.3 * width, -0.36 * width])


def test_harrington_in_millimetres_as_printed():
    """Width 240 mm, depth 160 mm: x = -0.24 PD - 9.9, y = -0.30 PW - 10.9, z = 0.33 PW + 7.3."""
    assert [1000 * v for v in harrington(0.24, 0.16)] == pytest.approx([-48.3, -82.9, 86.5])
    assert centre(model="harrington") == pytest.approx([0.1 - 0.0483, 1 - 0.0829, -0.0865])


@pytest.mark.parametrize(
    "settings",
    [
        {"model": "marker"},
        {"model": "trochanter", "trochanter_width_m": 0.36},
        {"model": "offset", "offset_m": (0.01, 0.02, 0.05)},
        {"model": "bell"},
        {"model": "harrington"},
    ],
)
def test_left_and_right_are_mirror_images(settings):
    assert centre("right", **settings) == pytest.approx(centre("left", **settings) * [1, 1, -1], abs=1e-12)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"model": "trochanter"}, "hip.trochanter_width_m"),
        ({"model": "offset"}, "hip.offset_m"),
        ({"model": "body"}, "hip.body"),
    ],
)
def test_a_model_without_its_figure_is_refused(settings, key):
    with pytest.raises(ConfigError, match=f"needs '{key}'"):
        centre(**settings)


def test_a_model_without_its_markers_is_refused():
    with pytest.raises(ConfigError, match=r"needs 'markers\.left_asis'"):
        hip_centre(POINTS, MarkerLabels(), HipSettings(model="bell"), "left")
    few = {name: point for name, point in POINTS.items() if name != "RPSI"}
    with pytest.raises(InputError, match="'RPSI', which the standing trial lacks"):
        centre(points=few, model="harrington")


def tube(radius=0.09) -> Body:
    """A pelvis of one round tube about each hip, and an arm beside the left one."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(-0.1, 0.1, 41))
    ring = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], -1).reshape(-1, 3)
    arm = 0.2 * ring + [0.0, 0.0, -0.3]
    hips = np.array([[0.0, 0.0, 0.08], [0.0, 0.0, -0.08]])
    vertices = np.concatenate([ring + hips[0], ring + hips[1], arm + hips[1]])
    weights = np.repeat(np.eye(3)[[0, 1, 2]], len(ring), axis=0)
    return Body(
        "tube", 70.0, 1.7, (), np.zeros((0, 3)), np.zeros(0), vertices, np.zeros((0, 3), int),
        ("femur_r", "femur_l", "humerus_l"), weights, ("hip_r", "hip_l"), hips, np.zeros(2), 0.0,
    )  # fmt: skip


def test_the_depth_under_the_skin_of_a_tube_is_its_radius(tmp_path: Path):
    assert depth_under_skin(tube(), "left") == pytest.approx(0.09, abs=0.003)
    assert depth_under_skin(tube(), "right") == pytest.approx(0.09, abs=0.003)
    save(tube(), tmp_path / "body.npz")
    found = centre(model="body", body=tmp_path / "body.npz", marker_radius_m=0.0)
    assert found == pytest.approx([0.02, 0.9, -0.18 + depth_under_skin(tube(), "left")])


@pytest.mark.parametrize(
    ("shift", "plane", "bias"),
    [
        ((0.0, 0.0, -0.06), 1, -5.6),
        ((0.06, 0.09, 0.0), 0, 6.7),
        ((0.0, 0.0, -0.02), 1, -1.9),
        ((0.02, 0, 0), 0, 2.7),
    ],
)
def test_a_wrong_centre_biases_the_angles_as_a_sensitivity_study_found(shift, plane, bias):
    """A trochanter or a spine taken as the centre; figures of an independent prototype [deg]."""
    rules, pose = protocol(), moving()
    motion = track(table(pose), calibrated(rules, {"HIP": shift}), rules.processing, "t")
    found = (motion.knee_deg - pose.knee_deg).mean(axis=0)[plane]
    assert found == pytest.approx(bias, abs=0.35)
