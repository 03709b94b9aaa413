"""Self-built plates on a serial line: a mock in a process of its own, a pseudo-terminal between."""

import os
import pty
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.clocks import ClockTracker
from evaluation.plate_calibration import Placement
from evaluation.plate_zero import measure_zero
from evaluation.sources.probe import probe
from evaluation.sources.reconnecting import Reconnecting
from evaluation.sources.serial_plate import SerialPlate
from evaluation.sources.serial_port import SerialLine, serial_ports
from evaluation.sources.stream import LabError, PlateSamples, SourceInfo, ground_load
from hilbrace.errors import InputError
from mocks.plate_signal import numbered
from tests.unit.plate_mocks import built_calibration, events, listen, mock, raw_plate, samples

BUILT = built_calibration()


@pytest.fixture
def port(tmp_path):
    return tmp_path / "plate"


def plate(port: Path, **options) -> SerialPlate:
    return SerialPlate("bench", str(port), BUILT, **options)


def names_of(numbers: np.ndarray) -> np.ndarray:
    """What samples with these numbers must hold."""
    return np.array([numbered(int(n), 8) for n in numbers], float)


def test_a_plate_says_what_it_is_and_every_sample_arrives_once(port):
    with mock("serial_plate", port, "--numbers", "--calibration", "old", "--trigger-at", "0.3") as tally:
        source = plate(port, placement=Placement((1.0, 2.0, 0.0), 90.0))
        info = source.open()
        items = listen(source, 10.0, 1500)
        source.close()
    assert info.device == "bench 7"
    assert info.plates[0].rate_hz == 1000.0
    assert info.plates[0].units == ("count",) * 8
    assert "calibration 'old'" in info.notes[0]
    number, device, _, values = samples(items)
    assert np.diff(number).tolist() == [1] * (len(number) - 1)
    np.testing.assert_array_equal(values, names_of(number))
    np.testing.assert_allclose(device, 1e-3 * number, atol=2e-6)
    assert source.received == len(number) <= tally.sent
    trigger = events(items, "trigger")[0]
    assert trigger.text == "trigger input 1"
    assert trigger.device_time_s == pytest.approx(0.3, abs=0.1)


def test_wrong_bytes_and_lost_frames_leave_every_whole_sample_in_its_place(port):
    with mock("serial_plate", port, "--numbers", "--corrupt", "0.01", "--drop", "0.02") as tally:
        source = Reconnecting(plate(port))
        source.open()
        items = listen(source, 10.0, 1500)
        source.close()
    number, device, _, values = samples(items)
    np.testing.assert_array_equal(values, names_of(number))
    np.testing.assert_allclose(device, 1e-3 * number, atol=2e-6)
    missing = number[-1] - number[0] + 1 - len(number)
    assert sum(e.lost for e in events(items, "gap")) == missing
    assert missing == pytest.approx(tally.damaged + tally.dropped, rel=0.25)
    assert "damaged bytes" in events(items, "fault")[0].text


@pytest.mark.parametrize("restart", [False, True])
def test_a_pulled_plug_comes_back_within_two_seconds_with_the_old_zero(port, restart):
    options = [
        "--empty",
        "--disconnect-at",
        "3.0",
        "--replug-after",
        "2.1",
        *(["--restart"] if restart else []),
    ]
    with mock("serial_plate", port, *options):
        source = Reconnecting(plate(port))
        info = source.open().plates[0]
        before = listen(source, 5.0, 1000)
        zero = measure_zero(raw_plate("bench", 1000.0, BUILT), samples(before)[3][:1000], 0)
        items = before + listen(source, 6.5)
        source.close()
    times = {kind: events(items, kind)[-1].host_time_ns for kind in ("disconnected", "connected")}
    away = 1e-9 * (times["connected"] - times["disconnected"])
    assert 2.1 < away + 0.05 < 2.1 + 2.0
    gap = max(events(items, "gap"), key=lambda event: event.lost)
    assert gap.lost == pytest.approx(1000 * away, abs=300)
    number, _, host, values = samples(items)
    assert np.sum(np.diff(number) - 1) == sum(e.lost for e in events(items, "gap"))
    after = host > 1e-9 * times["connected"]
    assert after.any()
    np.testing.assert_allclose(ground_load(info, values[after], zero.counts), 0, atol=1e-9)
    restarted = [e for e in events(items, "restarted") if "started anew" in e.text]
    assert len(restarted) == restart


def test_a_load_on_the_plate_is_the_one_that_was_put_there(port):
    from mocks import scene

    with mock("serial_plate", port, "--rate", "1000"):
        source = plate(port)
        info = source.open().plates[0]
        number, _, _, values = samples(listen(source, 20.0, 6500))
        source.close()
    played = scene.synthetic()
    loads = played.loads.reshape(-1, 6)
    assert played.rate_hz * played.samples == 1000.0
    zero = measure_zero(raw_plate("bench", 1000.0, BUILT), values[:1000], 0).counts
    got = ground_load(info, values, zero)
    truth = loads[number % len(loads)]
    on_subject = np.hstack([-truth[:, :3], -truth[:, 3:]]) * [1, -1, -1, 1, -1, -1]
    assert got[:, 2].max() > 500
    np.testing.assert_allclose(got, on_subject, atol=0.05)


@pytest.mark.slow
def test_a_drift_of_80_ppm_is_found_in_ten_seconds(port):
    """Over a real terminal: the mock's clock is 80 ppm fast, its punctuality is that of a process.

    3 ppm in ten seconds are 30 microseconds. On a machine with more work than cores the mock itself is later
    than that, which no device is; there this test only shows the order of magnitude, and the simulated
    arrivals of test_evaluation_clocks hold the estimate to its limit.
    """
    with mock("serial_plate", port, "--numbers", "--drift-ppm", "80"):
        source = plate(port)
        source.open()
        items = listen(source, 10.3)
        source.close()
    tracker = ClockTracker()
    for block in items:
        if isinstance(block, PlateSamples):
            last = block.device_time_s + (len(block.values) - 1) * block.period_s
            tracker.add(last, 1e-9 * block.host_time_ns)
    clock = tracker.fit()
    assert clock is not None
    assert clock.span_s == pytest.approx(10, abs=0.5)
    idle = os.getloadavg()[0] < 0.25 * (os.cpu_count() or 1)
    assert clock.drift_ppm == pytest.approx(80, abs=3 if idle else 25)


def test_a_stall_delays_samples_and_loses_only_what_the_line_could_not_hold(port):
    with mock("serial_plate", port, "--numbers", "--stall", "0.8", "0.4"):
        source = Reconnecting(plate(port))
        source.open()
        items = listen(source, 1.6)
        source.close()
    number, _, _, values = samples(items)
    np.testing.assert_array_equal(values, names_of(number))
    assert np.sum(np.diff(number) - 1) == sum(e.lost for e in events(items, "gap"))
    assert len(number) > 1200


def test_lines_arrive_with_the_losses_that_their_clock_shows(port):
    with mock("serial_plate", port, "--numbers", "--wire", "lines", "--rate", "80", "--drop", "0.1") as tally:
        source = Reconnecting(plate(port, wire="lines"))
        info = source.open()
        items = listen(source, 10.0, 120)
        source.close()
    assert any("no counter" in note for note in info.notes)
    assert any("too slow" in note for note in info.notes)
    number, _, _, values = samples(items)
    np.testing.assert_array_equal(values[:, 0] - values[0, 0], number - number[0])
    lost = sum(e.lost for e in events(items, "gap"))
    assert lost == number[-1] - number[0] + 1 - len(number)
    assert 0 < lost <= tally.dropped


def test_the_wrong_baud_rate_is_told_from_silence_and_from_the_wrong_protocol(port):
    with mock("serial_plate", port, "--numbers", "--baud", "460800"):
        with pytest.raises(LabError, match="none of them form frames"):
            plate(port, baud=115200).open()
        with pytest.raises(LabError, match="none of them form lines") as caught:
            plate(port, baud=460800, wire="lines").open()
        assert "'frames'" in caught.value.hint
        found = probe(str(port), "frames")
        assert (found.protocol, found.baud) == ("frames", 460800)
        assert found.text == "plate 'bench' 7: 8 channels at 1000 Hz"
        source = plate(port, baud=460800)
        source.open()
        with pytest.raises(LabError, match="in use by another program"):
            plate(port, baud=460800).open()
        with pytest.raises(LabError, match="in use by another program"):
            probe(str(port))
        source.close()
        source.close()


def test_a_plate_whose_calibration_is_another_ones_is_refused(port):
    narrow = replace(BUILT, matrix=BUILT.matrix[:, :4], empty=BUILT.empty[:4])
    with (
        mock("serial_plate", port, "--numbers"),
        pytest.raises(InputError, match="sends 8 channels, its calibration has 4"),
    ):
        SerialPlate("bench", str(port), narrow).open()


def test_another_plate_on_the_same_port_is_refused(port):
    source = plate(port)
    with mock("serial_plate", port, "--numbers", "--serial", "7"):
        source.open()
        listen(source, 5.0, 10)
        source.close()
    with (
        mock("serial_plate", port, "--numbers", "--serial", "8"),
        pytest.raises(InputError, match="another plate answers: 'bench' 8"),
    ):
        source.open()


def test_a_silent_port_says_so():
    device, host = pty.openpty()
    try:
        with pytest.raises(LabError, match="nothing arrives") as caught:
            plate(Path(os.ttyname(host))).open()
        assert "power and cable" in caught.value.hint
    finally:
        os.close(device)
        os.close(host)


def test_ports_that_cannot_be_opened_say_why(tmp_path, monkeypatch):
    with pytest.raises(LabError, match="no such port"):
        plate(tmp_path / "nothing").open()
    with pytest.raises(LabError, match="no such port"):
        probe(str(tmp_path / "nothing"))
    file = tmp_path / "file"
    file.write_text("no port")
    with pytest.raises(LabError, match="cannot be opened"):
        plate(file).open()

    def forbidden(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", forbidden)
    with pytest.raises(LabError, match="may not open") as caught:
        plate(tmp_path / "port").open()
    assert "dialout" in caught.value.hint


def test_ports_are_listed():
    assert all(port.path and port.description is not None for port in serial_ports())


def test_a_source_that_is_not_open_says_so(port):
    with pytest.raises(LabError, match="not open"):
        plate(port).read(0.1)


def test_a_line_that_dies_while_it_is_read_is_an_error_of_the_laboratory(port):
    with mock("serial_plate", port, "--numbers", "--duration", "1.0"):
        source = plate(port)
        info = source.open()
        with pytest.raises(LabError, match="went dead"):
            listen(source, 5.0)
        with pytest.raises(LabError, match="no such port"):
            source.open()
    assert isinstance(info, SourceInfo)


def test_reading_waits_no_longer_than_it_was_told(port):
    device, host = pty.openpty()
    line = SerialLine(os.ttyname(host), 115200)
    try:
        begun = time.monotonic()
        assert line.read(0.2) == b""
        assert 0.15 < time.monotonic() - begun < 0.5
    finally:
        line.close()
        os.close(device)
        os.close(host)
