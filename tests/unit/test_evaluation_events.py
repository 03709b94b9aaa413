"""Bending peak, touch-down and landing peak: by plates, by the falling hip, by order, by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.events import find_events, flexion_peaks, flight_from_hip, flight_from_plates
from evaluation.measure import MeasuredTrial, events_of
from evaluation.quality import judge
from evaluation.study import EventSettings
from evaluation.tracking import track
from hilbrace.errors import InputError
from mocks import synthetic_study as made_up
from tests.unit.evaluation_leg import calibrated, protocol

STILL = made_up.Scatter(sagittal_deg=0, frontal_deg=0, pace_s=0, noise_mm=0, wobble_mm=0, gaps=0)
ANGLES = np.array([[-70.0, -1.0], [-60.0, -4.0]])


@pytest.fixture(scope="module")
def trial():
    """A serve whose bending and landing peak are 0.95 s apart, 0.75 s of it in the air or unloaded."""
    recording = made_up.trial_recording(ANGLES, np.random.default_rng(1), STILL, 4.0)
    motion = track(recording.markers, calibrated(protocol()), protocol().processing, "t")
    return motion, recording.plates


def test_the_plates_tell_take_off_and_touch_down(trial):
    motion, plates = trial
    found = find_events(motion, plates, "t")
    assert found.found_by == "plates"
    assert found.landing_s - found.bending_s == pytest.approx(0.95, abs=0.0101)
    assert found.landing_s - found.touchdown_s == pytest.approx(0.2, abs=0.01)
    frames = [round(at * 200) for at in (found.bending_s, found.landing_s)]
    assert motion.knee_deg[frames, :2] == pytest.approx(ANGLES, abs=0.1)


def test_without_plates_the_falling_hip_tells_the_same(trial):
    motion, plates = trial
    by_plates, by_markers = find_events(motion, plates, "t"), find_events(motion, None, "t")
    assert by_markers.found_by == "markers"
    assert by_markers.touchdown_s == pytest.approx(by_plates.touchdown_s, abs=0.06)
    assert by_markers.bending_s == by_plates.bending_s
    assert by_markers.landing_s == by_plates.landing_s


def test_a_hip_that_falls_freely():
    time = np.arange(400) / 200.0
    air = np.clip(time, 0.8, 1.2) - 0.8
    height = 0.9 + 0.5 * 9.80665 * air * (0.4 - air)
    assert flight_from_hip(height, 200.0) == pytest.approx((0.8, 1.2), abs=0.06)
    assert flight_from_hip(0.9 + 0.05 * np.sin(3 * time), 200.0) is None


def test_unloaded_stretches_at_the_ends_are_no_flight(trial):
    _, plates = trial
    start, end = flight_from_plates(plates)
    loads = plates.force.copy()
    loads[:600] = 0.0
    loads[-900:] = 0.0
    assert flight_from_plates(replace(plates, force=loads)) == (start, end)
    assert flight_from_plates(replace(plates, force=loads * 0.0)) is None


def squat(depths, seconds=6.0):
    time = np.arange(round(seconds * 200)) / 200.0
    return sum(
        depth * np.exp(-0.5 * ((time - at) / 0.2) ** 2)
        for at, depth in zip(np.linspace(1, seconds - 1, len(depths)), depths, strict=True)
    )


def test_shallow_bends_are_no_peaks_and_a_cut_peak_is_at_the_gaps_edge():
    assert len(flexion_peaks(squat([70, 10, 60]), 200.0)) == 2
    flexion = squat([70, 60])
    flexion[180:220] = np.nan
    assert flexion_peaks(flexion, 200.0).tolist() == [220, 1000]
    assert len(flexion_peaks(np.full(100, np.nan), 200.0)) == 0


def bend(trial, flexion):
    motion, _ = trial
    count = min(len(flexion), len(motion.time))
    knee = np.column_stack([-flexion[:count], 0 * flexion[:count], 0 * flexion[:count]])
    arrays = {
        key: getattr(motion, key)[:count]
        for key in ("time", "ankle_deg", "knee", "ankle", "residual_mm", "visible", "knee_gap_mm")
    }
    hip = np.tile([0.0, 0.9, 0.0], (count, 1))
    return replace(motion, knee_deg=knee, hip=hip, **arrays)


def test_without_any_flight_the_first_two_peaks_are_taken(trial):
    found = find_events(bend(trial, squat([70, 60, 50], 4.0)), None, "t")
    assert (found.bending_s, found.landing_s, found.found_by) == (1.0, 2.0, "order")
    assert np.isnan(found.touchdown_s)


def test_a_single_bend_is_refused_with_advice(trial):
    with pytest.raises(InputError, match="1 flexion peaks of 15 deg, two are needed") as caught:
        find_events(bend(trial, squat([70, 5], 4.0)), None, "serve_1")
    assert caught.value.where == "serve_1"
    assert "[events]" in caught.value.hint


def test_no_bend_before_take_off_is_refused(trial):
    _, plates = trial
    flexion = np.where(np.arange(800) < 420, 0.0, squat([5, 70, 60], 4.0))
    with pytest.raises(InputError, match="no flexion peak before take-off"):
        find_events(bend(trial, flexion), plates, "t")


def measured(trial, **by_hand):
    motion, plates = trial
    quality = judge(motion, calibrated(protocol()), "t")
    return MeasuredTrial(Path("t.c3d").stem, 0, motion, quality, plates, EventSettings(**by_hand), ())


def test_events_set_by_hand_win(trial):
    found = events_of(measured(trial))
    part = events_of(measured(trial, landing_s=2.5))
    assert (part.bending_s, part.touchdown_s) == (found.bending_s, found.touchdown_s)
    assert (part.landing_s, part.found_by) == (2.5, "hand")
    both = events_of(measured(trial, bending_s=1.2, landing_s=2.4))
    assert (both.bending_s, both.landing_s, both.found_by) == (1.2, 2.4, "hand")


def test_an_event_outside_the_trial_is_refused(trial):
    with pytest.raises(InputError, match="landing_s = 9 lies outside the trial, which ends at"):
        events_of(measured(trial, landing_s=9.0))
