"""Angles, peaks, health and orders while devices send, held against the analysis of the same recordings."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.calibration import calibrate
from evaluation.events import flexion_peaks, flight_from_plates
from evaluation.live import acquisition as live_acquisition
from evaluation.live.acquisition import Acquisition, Answer, Begin, End
from evaluation.live.analysis import Curve, LiveAnalysis, _together
from evaluation.live.health import HealthWatch
from evaluation.live.knee import LiveKnee
from evaluation.live.mailbox import Mailbox
from evaluation.live.peaks import FlightWatch, Peak, PeakWatch, bending_and_landing
from evaluation.live.timing import Latency
from evaluation.record.conversion import about_point, to_recording
from evaluation.record.reading import read_log
from evaluation.sources.stream import MarkerFrame, PlateSamples, SourceEvent, SourceInfo
from evaluation.tracking import track
from hilbrace.errors import InputError
from mocks import synthetic_study as made_up
from tests.unit.evaluation_devices import INFO, PLATE, ScriptedSource, ended, frame, lost_line, stream
from tests.unit.evaluation_leg import protocol

SCATTER = made_up.Scatter(gaps=0)


@pytest.fixture(scope="module")
def trial():
    """A made-up trial with its standing leg."""
    setting = protocol()
    standing = made_up.standing_recording(3, SCATTER)
    recording = made_up.trial_recording(
        made_up.planted_angles()["optimized"], np.random.default_rng(8), SCATTER, 4.0
    )
    return calibrate(standing, setting, "standing"), setting, recording


def info_of(recording, up="y") -> SourceInfo:
    labels = tuple(f"Nobody:{name}" for name in recording.markers.names)
    return SourceInfo("lab", "a device", labels, recording.markers.rate_hz, up)


def test_live_angles_are_those_of_the_recording(trial):
    calibration, setting, recording = trial
    motion = track(recording.markers, calibration, setting.processing, "trial")
    knee = LiveKnee(calibration, info_of(recording))
    live = np.concatenate([knee.angles(place[None]).knee_deg for place in recording.markers.positions])
    assert np.allclose(live, motion.knee_deg, atol=1e-9)
    together = knee.angles(recording.markers.positions)
    assert np.allclose(together.knee_deg, live, atol=1e-9)
    assert np.allclose(together.knee_gap_mm, motion.knee_gap_mm, atol=1e-9)
    assert np.allclose(together.residual_mm, motion.residual_mm[:, :2], atol=1e-9)


def test_a_laboratory_with_z_up_gives_the_same_angles(trial):
    calibration, _, recording = trial
    x, y, z = np.moveaxis(recording.markers.positions, -1, 0)
    turned = np.stack([x, -z, y], axis=-1)
    one = LiveKnee(calibration, info_of(recording)).angles(recording.markers.positions)
    other = LiveKnee(calibration, info_of(recording, "z")).angles(turned)
    assert np.allclose(one.knee_deg, other.knee_deg, atol=1e-9)


def test_hidden_markers_give_angles_from_three_and_none_from_two(trial):
    calibration, _, recording = trial
    knee = LiveKnee(calibration, info_of(recording))
    places = recording.markers.positions[400:401].copy()
    whole = knee.angles(places).knee_deg
    names = recording.markers.names
    places[0, names.index("TH2")] = np.nan
    assert np.allclose(knee.angles(places).knee_deg, whole, atol=3.0)
    places[0, names.index("TH3")] = np.nan
    assert np.isnan(knee.angles(places).knee_deg).all()


def test_a_source_without_the_clusters_is_refused(trial):
    calibration, *_ = trial
    with pytest.raises(InputError, match="names 2 of the thigh's markers"):
        LiveKnee(calibration, INFO)


def test_peaks_while_moving_are_those_found_afterwards(trial):
    calibration, setting, recording = trial
    motion = track(recording.markers, calibration, setting.processing, "trial")
    flexion = -motion.knee_deg[:, 0]
    watch = PeakWatch()
    for k, (at, value) in enumerate(zip(motion.time, flexion, strict=True)):
        watch.add(float(at), float(value), float(motion.knee_deg[k, 1]))
    found = flexion_peaks(flexion, motion.rate_hz)
    assert [peak.time_s for peak in watch.peaks] == pytest.approx(motion.time[found].tolist())
    assert [peak.flexion_deg for peak in watch.peaks] == pytest.approx(flexion[found].tolist())
    assert watch.highest.flexion_deg == flexion.max()
    flight = FlightWatch()
    for at, value in zip(recording.plates.time, recording.plates.force[:, 0, 1], strict=True):
        flight.add(float(at), float(value))
    assert flight.flight == pytest.approx(flight_from_plates(recording.plates))


@given(st.lists(st.floats(0, 100), min_size=3, max_size=60))
def test_a_watched_peak_is_a_peak(values):
    watch = PeakWatch()
    for k, value in enumerate(values):
        watch.add(float(k), value, 0.0)
    found = set(flexion_peaks(np.array(values), 1.0).tolist())
    assert {round(peak.time_s) for peak in watch.peaks} <= found | plateaus(values)


def plateaus(values) -> set[int]:
    """Flat tops, of which one program names the first frame and the other the middle."""
    return {k for k in range(1, len(values)) if values[k] in (values[k - 1], *values[k + 1 : k + 2])}


def test_bending_and_landing_by_the_flight_or_by_order():
    one, two, three = Peak(1.0, 40, 0), Peak(2.0, 60, 1), Peak(4.0, 50, 2)
    assert bending_and_landing([one, two, three], (2.5, 3.0)) == (two, three)
    assert bending_and_landing([one, two, three], None) == (one, two)
    assert bending_and_landing([one], (0.2, 0.5)) == (None, one)
    assert bending_and_landing([], None) == (None, None)


def test_unknown_angles_are_passed_over():
    watch = PeakWatch()
    for k, value in enumerate([0, 10, math.nan, 30, math.nan, 5.0]):
        watch.add(float(k), value, 0.0)
    assert [peak.flexion_deg for peak in watch.peaks] == [30]


def test_delays_are_counted_in_constant_memory():
    delays = np.random.default_rng(0).gamma(2.0, 2.0, 5000)
    latency = Latency()
    assert math.isnan(latency.percentile(50))
    for delay in delays:
        latency.add(float(delay))
    for percent in (50, 95, 99):
        assert latency.percentile(percent) == pytest.approx(np.percentile(delays, percent), abs=0.11)
    assert latency.recent(99) == pytest.approx(np.percentile(delays[-1000:], 99), rel=0.05)
    latency.add(1e6)
    assert latency.counts[-1] == 1
    assert latency.largest_ms == 1e6


def test_a_full_mailbox_drops_the_newest_and_counts_them():
    box = Mailbox(2)
    assert box.offer([1, 2])
    assert box.offer([3])
    assert not box.offer([4, 5])
    box.order(6)
    assert box.dropped == 2
    assert box.take(0.0) == [1, 2, 3, 6]
    assert box.take(0.0) == []


def test_curves_are_thinned_and_begin_anew_when_time_runs_back():
    curve = Curve()
    for k in range(200):
        curve.add(k / 200, (float(k), math.nan))
    cursor, anew, rows = curve.since(0)
    assert not anew
    assert [row[0] for row in rows] == [k / 100 for k in range(100)]
    assert rows[3] == [0.03, 6.0, None]
    assert curve.since(cursor) == (cursor, False, [])
    curve.add(0.0, (1.0, 1.0))
    after, anew, rows = curve.since(cursor)
    assert anew
    assert rows == [[0.0, 1.0, 1.0]]
    assert curve.since(3)[1]
    assert curve.since(after) == (after, False, [])


def test_health_by_what_came_and_by_the_counter():
    watch = HealthWatch("lab")
    assert watch.look(time.monotonic_ns()).state == "waiting"
    watch.add(INFO)
    rng = np.random.default_rng(0)
    now = time.monotonic_ns()
    for k in range(100):
        watch.add(MarkerFrame("lab", k, k / 200, now + k * 5_000_000, rng.normal(size=(3, 3))))
    seen = watch.look(now + 99 * 5_000_000)
    assert (seen.state, seen.frames, seen.lost) == ("ok", 100, 0)
    assert seen.rate_hz == pytest.approx(200)
    silent = watch.look(now + 99 * 5_000_000 + 700_000_000)
    assert (silent.state, silent.text) == ("silent", "nothing for 0.7 s")
    watch.add(SourceEvent("lab", "gap", now, math.nan, "7 frames are missing", 7))
    watch.add(SourceEvent("lab", "disconnected", now, math.nan, "the line went dead"))
    lost = watch.look(now)
    assert (lost.state, lost.text, lost.lost) == ("lost", "the line went dead", 7)
    watch.add(SourceEvent("lab", "connected", now, math.nan, "back"))
    assert watch.look(time.monotonic_ns()).state == "ok"
    watch.give_up("its thread ended")
    assert watch.look(now).state == "fault"


def record(tmp_path, source):
    """Record all that a scripted source has; gives the recording and the health."""
    acquisition = Acquisition([source], analyse=True)
    begun, done = Answer(), Answer()
    acquisition.recorder.mailbox.order(Begin(tmp_path / "take.mcap", {}, begun))
    acquisition.start()
    assert source.finished.wait(20)
    acquisition.recorder.mailbox.order(End(done))
    written = done.wait()
    health = acquisition.health()
    acquisition.stop()
    return written, health, acquisition


def test_everything_that_a_device_sends_is_recorded(tmp_path):
    items = list(stream(200))
    blocks = [items[k : k + 4] for k in range(0, len(items), 4)]
    written, (health,), acquisition = record(tmp_path, ScriptedSource(blocks))
    assert (written.frames, written.samples, written.lost, written.dropped) == (200, 1000, 0, 0)
    assert (health.state, health.frames, health.samples) == ("ok", 200, 1000)
    numbers = [i.number for i in read_log(written.path).items if isinstance(i, MarkerFrame)]
    assert numbers == list(range(200))
    assert sum(len(block) for block in [acquisition.analysis.take(0.0)]) >= 400


def test_an_interruption_is_recorded_and_counted(tmp_path):
    first, second = list(stream(20)), list(stream(20, first=35))
    source = ScriptedSource([first, lost_line(), second])
    written, (health,), _ = record(tmp_path, source)
    assert source.opened == 2
    assert written.lost == 15 + 5 * 15
    assert health.lost == written.lost
    kinds = [i.kind for i in read_log(written.path).items if isinstance(i, SourceEvent)]
    assert kinds == ["connected", "disconnected", "connected", "gap", "gap"]


def state_of(source, state) -> str:
    """Wait until a source's device is in some state; gives what is said about it."""
    acquisition = Acquisition([source], analyse=False)
    acquisition.start()
    for _ in range(1000):
        if acquisition.health()[0].state == state:
            break
        threading.Event().wait(0.01)
    acquisition.stop()
    assert acquisition.health()[0].state == state
    return acquisition.health()[0].text


def test_a_device_that_ends_is_no_fault():
    assert state_of(ScriptedSource([list(stream(5)), [ended()]]), "ended") == "The replay is over."


def test_a_fault_that_needs_a_person_is_shown():
    fault = InputError("another plate answers", where="serial", hint="exchange the cables")
    assert state_of(ScriptedSource([list(stream(5)), fault]), "fault") == (
        "another plate answers; exchange the cables"
    )


def test_what_the_recorder_cannot_take_is_counted_and_written(tmp_path, monkeypatch):
    """The recorder is held up while a device goes on: what does not fit its queue is named in the file."""
    monkeypatch.setattr(live_acquisition, "WAITING_BLOCKS", 5)
    blocks = [[frame(k, np.random.default_rng(k))] for k in range(50)]
    source = ScriptedSource(blocks)
    acquisition = Acquisition([source], analyse=False)
    thread, held = acquisition.recorder, threading.Event()
    care = thread._care
    monkeypatch.setattr(thread, "_care", lambda: (held.wait(20), care())[1])
    begun, done = Answer(), Answer()
    thread.mailbox.order(Begin(tmp_path / "take.mcap", {}, begun))
    thread.start()
    begun.wait()
    for reader in acquisition._threads:
        reader.start()
    assert source.finished.wait(20)
    held.set()
    thread.mailbox.order(End(done))
    written = done.wait()
    acquisition.stop()
    assert written.dropped == thread.mailbox.dropped > 30
    recorded = read_log(written.path)
    assert sum(mark.content["items"] for mark in recorded.marks if mark.kind == "lost") == written.dropped
    assert written.frames + written.dropped >= 50


def test_a_second_start_is_refused_and_two_devices_need_two_names(tmp_path):
    with pytest.raises(InputError, match="two devices"):
        Acquisition([ScriptedSource([]), ScriptedSource([])], analyse=False)
    acquisition = Acquisition([ScriptedSource([])], analyse=False)
    first, second, third, none = Answer(), Answer(), Answer(), Answer()
    acquisition.start()
    acquisition.recorder.mailbox.order(Begin(tmp_path / "a.mcap", {}, first))
    acquisition.recorder.mailbox.order(Begin(tmp_path / "b.mcap", {}, second))
    assert first.wait().path.name == "a.mcap"
    with pytest.raises(InputError, match="running"):
        second.wait()
    acquisition.recorder.mailbox.order(End(Answer()))
    acquisition.recorder.mailbox.order(Begin(tmp_path / "absent" / "c.mcap", {}, third))
    with pytest.raises(InputError, match="cannot create"):
        third.wait()
    acquisition.recorder.mailbox.order(End(none))
    with pytest.raises(InputError, match="nothing is being recorded"):
        none.wait()
    acquisition.stop()


def test_frames_missing_by_the_counter_become_gaps(tmp_path):
    items = [*stream(40), *stream(20, first=44)]
    written, *_ = record(tmp_path, ScriptedSource([items]))
    recording = to_recording(read_log(written.path))
    known = np.isfinite(recording.markers.positions).all(axis=2).any(axis=1)
    assert len(known) == 64
    assert (~known).sum() == 4
    assert (~known)[40:44].all()
    assert "4 of 64 frames are missing and stay gaps." in recording.notes
    assert recording.plates is None
    assert any("left out: it lacks up to 21 ms" in note for note in recording.notes)


def test_loads_about_a_point_of_the_surface():
    rng = np.random.default_rng(2)
    force = np.column_stack([rng.normal(0, 50, 40), rng.uniform(100, 900, 40), rng.normal(0, 50, 40)])
    force[:3] = 1.0
    point = np.column_stack([rng.uniform(-1, 1, 40), np.full(40, 0.03), rng.uniform(-1, 1, 40)])
    torque = np.column_stack([np.zeros(40), rng.normal(0, 5, 40), np.zeros(40)])
    load = np.hstack([force, np.cross(point, force) + torque])
    found_force, found_point, found_torque = about_point(load, 0.03)
    assert np.array_equal(found_force, force)
    assert np.allclose(found_point[3:], point[3:])
    assert np.allclose(found_torque[3:], torque[3:])
    assert np.isnan(found_point[:3]).all()
    assert not found_torque[:3].any()


def test_a_backlog_of_two_plates_and_a_leg_is_taken_in_the_order_of_time(trial):
    """After a hold-up everything waits at once; curves and flight are those of frames that came singly."""
    calibration, _, recording = trial
    info = replace(info_of(recording), plates=(PLATE, replace(PLATE, name="2")))
    rng = np.random.default_rng(3)
    vertical = np.where((np.arange(600) > 300) & (np.arange(600) < 400), 0.0, 300.0)

    def items(start: int, stop: int) -> list:
        made = []
        for k in range(start, stop):
            now = time.monotonic_ns()
            made.append(MarkerFrame("lab", k, k / 200, now, recording.markers.positions[k]))
            for name in ("1", "2"):
                values = rng.normal(0, 1, (5, 6))
                values[:, 1] = vertical[k]
                made.append(PlateSamples("lab", name, 5 * k, k / 200, 0.001, now, values))
        return made

    views = []
    for step in (1, 150):
        box: Mailbox = Mailbox(10)
        analysis = LiveAnalysis(box, calibration.thigh.labels)
        analysis.calibrate(calibration)
        for batch in [[info], *(items(k, k + step) for k in range(0, 600, step))]:
            for group in _together(batch):
                analysis._take(group)
        views.append(
            (analysis.knee_curve.since(0)[2], analysis.force_curve.since(0)[2], analysis._flight.flight)
        )
    assert views[0][0] == views[1][0]
    assert len(views[0][1]) == len(views[1][1]) == 300
    assert views[0][2] == views[1][2] == (1.505, 2.0)
