"""Markers placed in a motion: what an unusual pelvis does to the hips of someone who never stands still."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.biomech.calibration import calibrate
from hilbrace.biomech.engine import Engine
from hilbrace.biomech.kinematics import follow
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.motion.marker_maps import read_marker_map
from hilbrace.motion.synthetic.generate import SyntheticMotion, generate
from hilbrace.motion.trial import Trial
from hilbrace.run.progress import silent
from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.table import load_table

LOW_M = 0.03
"""Posterior iliac spines this far below the model's: ten degrees over the depth of the pelvis."""


def pelvis_errors(truth: SyntheticMotion, markers: np.ndarray) -> dict[str, float]:
    """Mean error of pelvis and hips without a standing trial [deg]."""
    part = slice(None, None, 4)
    nothing = np.zeros((len(truth.time[part]), 2, 3))
    trial = Trial(
        name="walk",
        origin="synthetic",
        time=truth.time[part],
        rate_hz=truth.rate_hz / 4.0,
        marker_names=truth.marker_names,
        markers=markers[part],
        static_marker_names=(),
        static_markers=np.zeros((0, 3)),
        feet=("right", "left"),
        ground_force=nothing,
        centre_of_pressure=nothing,
        free_torque=nothing,
        mass_kg=truth.mass_kg,
        height_m=truth.height_m,
        marker_map="hilbrace",
        notes=(),
    )
    with Engine() as engine:
        built = engine.call("build_model", bodies=(), scales=np.zeros((0, 3)), mass_kg=truth.mass_kg)
        figures = ModelFigures(**built)
        placed, start, _ = calibrate(engine, figures, trial, read_marker_map("hilbrace"))
        found = follow(engine, figures, trial, placed, start, 0.0, silent).coordinates
    names = ("pelvis_tilt", "hip_flexion_r", "hip_flexion_l")
    columns = figures.columns(names)
    true = np.stack([truth.coordinates[name][part] for name in names], axis=1)
    return dict(zip(names, np.degrees(found[:, columns] - true).mean(axis=0), strict=True))


def with_low_spines(truth: SyntheticMotion) -> np.ndarray:
    """Markers of someone whose posterior iliac spines lie `LOW_M` lower on the pelvis."""
    up = skeleton_from_table(load_table()).forward(truth.coordinates)["pelvis"].rotation[:, :, 1]
    markers = truth.true_markers.copy()
    for name in ("RPSI", "LPSI"):
        markers[:, truth.marker_names.index(name)] -= LOW_M * up
    return markers


@pytest.fixture(scope="module")
def walk() -> SyntheticMotion:
    return generate("gait", rate_hz=100.0)


def test_an_upright_posture_outweighs_an_unusual_pelvis(walk):
    """The low spines alone would tilt the pelvis, and extend the hips with it, by 2.9 and 3.3 deg."""
    errors = pelvis_errors(walk, with_low_spines(walk))
    assert abs(errors["pelvis_tilt"]) < 2.3
    assert abs(errors["hip_flexion_r"]) < 2.6
    assert abs(errors["hip_flexion_l"]) < 2.6


def test_landmarks_that_fit_the_model_are_believed(walk):
    """A pelvis that is tilted in truth stays so, since the hold fades with the misfit."""
    errors = pelvis_errors(walk, walk.true_markers)
    assert all(abs(error) < 0.5 for error in errors.values())
