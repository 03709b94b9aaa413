"""The clocks of devices in their health and in recordings, and plates on the clock of the markers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from evaluation.device_clock import DeviceClock
from evaluation.live.health import HealthWatch
from evaluation.record.conversion import to_recording
from evaluation.record.messages import Mark
from evaluation.record.reading import Recorded, read_log
from evaluation.record.recorder import Recorder
from evaluation.sources.stream import Item, MarkerFrame, PlateInfo, PlateSamples, SourceEvent, SourceInfo
from evaluation.stream_alignment import force_onsets, heel_strikes
from hilbrace.motion.recording import Recording
from tests.unit.test_evaluation_stream_alignment import STOMPS, foot, force

FRAME_S, SAMPLE_S = 1 / 200, 1e-3
LENGTH_S = 19.0
OFFSET_S, LATE_S = 7.5, 0.040
"""The plate's clock when the markers' starts, and how late the plate's computer passes its samples on."""

PLATE = PlateInfo(
    name="1", rate_hz=1000.0, channels=("Fx", "Fy", "Fz", "Mx", "My", "Mz"), units=("N",) * 6,
    calibration=np.eye(6), rotation=np.eye(3), origin=np.zeros(3), corners=np.zeros((4, 3)), zeroed=True,
)  # fmt: skip
INFOS = (
    SourceInfo("cameras", "cameras", ("HEE", "KNE"), 200.0),
    SourceInfo("plate", "plate", plates=(PLATE,)),
)


def host_ns(true_s: float, rng: np.random.Generator) -> int:
    """When something that left its device at a time arrives."""
    return round(1e9 * (1000.0 + true_s + min(rng.exponential(0.001), 0.004)))


def frames(rng: np.random.Generator) -> list[Item]:
    times = np.arange(0, LENGTH_S, FRAME_S)
    height = foot(times, STOMPS) + rng.normal(0, 2e-4, len(times))
    return [
        MarkerFrame("cameras", k, at, host_ns(at, rng), np.array([[0.0, 0.0, up], [0.0, 0.0, 0.5]]))
        for k, (at, up) in enumerate(zip(times.tolist(), height.tolist(), strict=True))
    ]


def samples(rng: np.random.Generator, drift: float, stomps: np.ndarray) -> list[Item]:
    true = np.arange(0, LENGTH_S, SAMPLE_S)
    values = np.zeros((len(true), 6))
    values[:, 2] = force(true, stomps) + rng.normal(0, 1, len(true))
    return [
        PlateSamples("plate", "1", k, (true[k] + OFFSET_S) * (1 + drift), SAMPLE_S,
                     host_ns(true[k + 4] + LATE_S, rng), values[k : k + 5])
        for k in range(0, len(true) - 5, 5)
    ]  # fmt: skip


def converted(items: Sequence[Item], content: dict | None = None) -> Recording:
    marks = (Mark("start", 0, "take", content or {}),)
    return to_recording(Recorded(Path("take.mcap"), (*INFOS, *items), marks, True, 0, 0, {}, {}, ()))


def lateness(recording: Recording) -> np.ndarray:
    """How long after the heel has stopped the force begins [s]."""
    assert recording.plates is not None
    stops = heel_strikes(recording.markers.time, recording.markers.positions[:, 0, 1])
    return force_onsets(recording.plates.time, recording.plates.force[:, 0, 1]) - stops


@pytest.mark.parametrize("drift", [0.0, 80e-6])
def test_stomps_bring_a_late_and_drifting_plate_to_the_frames(drift):
    rng = np.random.default_rng(4)
    items = frames(rng) + samples(rng, drift, STOMPS)
    found = converted(items, {"stomps": "HEE"})
    np.testing.assert_allclose(lateness(found), 0.0, atol=FRAME_S / 2)
    (note,) = (note for note in found.notes if "plate 1" in note)
    assert "4 events (heel stomps), which agree to" in note
    assert float(note.split("agree to ")[1].split(" ms")[0]) < 1e3 * FRAME_S


def test_without_events_arrivals_hide_how_late_a_device_sends_and_the_notes_say_so():
    rng = np.random.default_rng(5)
    found = converted(frames(rng) + samples(rng, 80e-6, STOMPS))
    np.testing.assert_allclose(lateness(found), LATE_S, atol=FRAME_S / 2)
    (note,) = (note for note in found.notes if "plate 1" in note)
    assert "fastest arrivals" in note
    assert float(note.split("runs ")[1].split(" ppm")[0]) == pytest.approx(80, abs=10)


def test_triggers_are_trusted_more_than_arrivals():
    rng = np.random.default_rng(6)
    pulses = np.array([0.5, 1.9, 14.0, 18.2])
    events: list[Item] = []
    for at in pulses.tolist():
        events += [
            SourceEvent("cameras", "trigger", host_ns(at, rng), at, "trigger"),
            SourceEvent("plate", "trigger", host_ns(at, rng), at + OFFSET_S, "trigger input 1"),
            SourceEvent("plate", "trigger", host_ns(at, rng), at + OFFSET_S + 0.01, "trigger input 0"),
        ]
    found = converted(frames(rng) + samples(rng, 0.0, STOMPS) + events)
    np.testing.assert_allclose(lateness(found), 0.0, atol=FRAME_S / 2)
    assert any("4 events (trigger), which agree to 0.0 ms" in note for note in found.notes)


@pytest.mark.parametrize(
    ("content", "shifts", "why"),
    [
        ({"stomps": "HEE"}, [0.0, 0.006, -0.006, 0.006], "one frame is 5 ms"),
        ({"stomps": "HEE"}, [0.0, 0.3, 0.7, 1.2], "by its arrivals"),
        ({"stomps": "TOE"}, [0.0] * 4, "no marker 'TOE'"),
    ],
)
def test_a_plate_whose_events_disagree_is_refused_and_the_markers_are_kept(content, shifts, why):
    rng = np.random.default_rng(7)
    found = converted(frames(rng) + samples(rng, 0.0, STOMPS + np.array(shifts)), content)
    assert found.plates is None
    assert len(found.markers.time) == pytest.approx(LENGTH_S / FRAME_S, abs=1)
    assert any("Plate 'plate 1' is left out: " in note and why in note for note in found.notes)


def test_health_shows_the_drift_and_forgets_it_when_the_device_starts_anew():
    rng = np.random.default_rng(8)
    watch = HealthWatch("plate")
    assert watch.look(0).drift_ppm is None
    items = samples(rng, 80e-6, STOMPS)
    for item in items:
        watch.add(item)
    seen = watch.look(10**13)
    assert seen.drift_ppm == pytest.approx(80, abs=3)
    assert seen.drift_error_ppm == pytest.approx(1, abs=1)
    watch.add(SourceEvent("plate", "restarted", items[-1].host_time_ns, math.nan, "the plate started anew"))
    assert watch.look(2 * 10**13).drift_ppm is None


def test_a_clock_that_runs_backwards_or_at_another_speed_is_none():
    clock, fast = DeviceClock(), DeviceClock()
    for k in range(4000):
        clock.add(MarkerFrame("c", k, k * FRAME_S, round(1e9 * k * FRAME_S), np.zeros((1, 3))))
        fast.add(MarkerFrame("c", k, 2 * k * FRAME_S, round(1e9 * k * FRAME_S), np.zeros((1, 3))))
    known = clock.fit()
    assert known is not None
    assert abs(known.drift_ppm) < 0.01
    assert fast.fit() is None
    clock.add(MarkerFrame("c", 0, 0.0, round(21e9), np.zeros((1, 3))))
    assert clock.fit() is None


def test_the_recording_ends_with_the_clocks_of_its_devices(tmp_path):
    rng = np.random.default_rng(9)
    recorder = Recorder(tmp_path / "take.mcap", INFOS, {})
    for item in sorted(frames(rng) + samples(rng, 80e-6, STOMPS), key=lambda item: item.host_time_ns):
        recorder.add(item)
    last = read_log(recorder.close().path).marks[-1]
    assert last.kind == "stop"
    assert last.content["frames"] == round(LENGTH_S / FRAME_S)
    assert last.content["clocks"]["plate"]["drift_ppm"] == pytest.approx(80, abs=3)
    assert last.content["clocks"]["cameras"]["drift_ppm"] == pytest.approx(0, abs=3)
