"""The residual wrench at the pelvis: zero where motion and forces agree, known where they do not."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.biomech.dynamics import GroundReaction, Momenta, Wrench, momenta
from hilbrace.biomech.residuals import (
    pelvis_residual,
    residual_figures,
    residual_notes,
    unmeasured_support,
)
from hilbrace.units import GRAVITY

RATE = 100.0
FRAMES = 60
MASSES = np.array([40.0, 20.0])


def tumbling() -> Momenta:
    """Two bodies that hover, sway and turn."""
    time = np.arange(FRAMES) / RATE
    angle = 0.4 * np.sin(5.0 * time)
    cosine, sine, zero = np.cos(angle), np.sin(angle), 0.0 * angle
    turned = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, zero + 1.0], axis=1)
    rotations = np.repeat(turned.reshape(-1, 1, 3, 3), 2, axis=1)
    sway = np.stack([0.1 * np.sin(3.0 * time), 1.0 + 0.05 * np.cos(4.0 * time), zero], axis=1)
    origins = np.stack([sway, sway - [0.0, 0.5, 0.1]], axis=1)
    inertias = np.array([np.diag([1.0, 0.5, 0.8]), np.diag([0.3, 0.1, 0.3])])
    return momenta(rotations, origins, MASSES, np.zeros((2, 3)), inertias, RATE)


def reaction_of(segments: Momenta, pelvis: np.ndarray) -> GroundReaction:
    """The one ground reaction that moves the segments as they move, at the origin of the ground."""
    force = segments.force.sum(axis=1)
    moment = (np.cross(segments.centres, segments.force) + segments.torque).sum(axis=1)
    return GroundReaction(force, np.zeros_like(force), moment)


def test_forces_that_fit_the_motion_leave_nothing():
    segments = tumbling()
    pelvis = segments.centres[:, 0] + 0.07
    residual = pelvis_residual(segments, [reaction_of(segments, pelvis)], pelvis)
    assert np.abs(residual.force).max() < 1e-9
    assert np.abs(residual.moment).max() < 1e-9


def test_a_force_that_is_not_measured_is_the_residual():
    segments = tumbling()
    pelvis = segments.centres[:, 0]
    whole = reaction_of(segments, pelvis)
    push, place = np.array([30.0, 0.0, 0.0]), pelvis + np.array([0.0, 0.2, 0.0])
    less = GroundReaction(whole.force - push, whole.point, whole.torque - np.cross(place, push))
    residual = pelvis_residual(segments, [less], pelvis)
    assert np.allclose(residual.force, push)
    assert np.allclose(residual.moment, np.cross([0.0, 0.2, 0.0], push))


def test_rms_peak_and_limits_are_those_of_the_judged_frames():
    segments = tumbling()
    time = np.arange(FRAMES) / RATE
    force = np.zeros((FRAMES, 3))
    force[10], force[50] = [0.0, 60.0, 80.0], [900.0, 0.0, 0.0]
    ground = np.tile([0.0, 600.0, 0.0], (FRAMES, 1))
    figures = residual_figures(time, Wrench(force, 0.1 * force), ground, segments, [slice(45, 60)])
    height = (segments.centres[:45, :, 1] @ MASSES).mean() / MASSES.sum()
    assert figures["residual_frames"] == 45
    assert figures["residual_force_peak_n"] == pytest.approx(100.0)
    assert figures["residual_force_peak_s"] == pytest.approx(0.10)
    assert figures["residual_force_rms_n"] == pytest.approx(100.0 / np.sqrt(45))
    assert figures["residual_force_limit_n"] == pytest.approx(30.0)
    assert figures["residual_moment_peak_nm"] == pytest.approx(10.0)
    assert figures["residual_moment_limit_nm"] == pytest.approx(0.01 * 600.0 * height)
    notes = residual_notes(figures, time, [slice(45, 60)])
    assert notes[0].startswith("0.45 to 0.59 s: something that no force plate measures")
    assert "peak 100 N at 0.10 s, above the 30 N that Hicks et al. 2015 recommend" in notes[1]
    assert residual_figures(time, Wrench(force, force), ground, segments, [slice(0, 60)]) == {
        "residual_frames": 0.0
    }


def test_a_box_without_a_plate_is_found_and_a_short_misfit_is_not():
    force = np.zeros((FRAMES, 3))
    force[:30, 1] = 0.9 * 60.0 * GRAVITY
    force[40:50, 1] = 0.9 * 60.0 * GRAVITY
    assert unmeasured_support(force, 60.0, RATE) == [slice(0, 30)]
