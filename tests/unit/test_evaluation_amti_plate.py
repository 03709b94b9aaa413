"""AMTI's serial protocol: its bytes, its resynchronisation, and the plate as a process of its own."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.plate_loads import centre_of_pressure
from evaluation.plate_zero import measure_zero
from evaluation.sources.amti import FRAME_BYTES, AmtiDecoder, AmtiSample, Skipped, encode_sample
from evaluation.sources.amti_plate import AmtiPlate
from evaluation.sources.arrival_model import ArrivalModel
from evaluation.sources.probe import probe
from evaluation.sources.reconnecting import Reconnecting
from evaluation.sources.stream import LabError, ground_load
from hilbrace.errors import InputError
from mocks.plate_signal import AMTI_MATRIX
from tests.unit.plate_mocks import (
    N_AND_NMM,
    amti_calibration,
    built_calibration,
    events,
    listen,
    mock,
    raw_plate,
    samples,
)

AMTI = amti_calibration()
READINGS = st.lists(st.integers(-2048, 2047), min_size=12, max_size=12).map(tuple)


@pytest.fixture
def port(tmp_path):
    return tmp_path / "plate"


def plate(port, **options) -> AmtiPlate:
    return AmtiPlate("force", str(port), AMTI, **options)


def decoded(wire: bytes, piece: int = 50) -> tuple[list[tuple], int]:
    """Readings, and how many bytes were passed over."""
    decoder = AmtiDecoder()
    found = [m for k in range(0, len(wire), piece) for m in decoder.feed(wire[k : k + piece])]
    skipped = sum(m.size for m in found if isinstance(m, Skipped))
    return [tuple(m.counts.tolist()) for m in found if isinstance(m, AmtiSample)], skipped


def test_a_sample_is_twelve_words_with_the_channel_above_the_reading():
    wire = encode_sample((-2048, 2047, 0, *range(1, 10)), trigger=True)
    words = struct.unpack("<12H", wire)
    assert words[:3] == (0xF000, 0x1FFF, 0x2800)
    assert [w >> 12 for w in words] == [15, *range(1, 12)]
    assert [w & 0xFFF for w in words[3:]] == [2048 + k for k in range(1, 10)]


@given(st.lists(READINGS, min_size=1, max_size=20), st.integers(1, 70))
@settings(max_examples=40)
def test_samples_come_back_from_any_pieces(readings, piece):
    assert decoded(b"".join(map(encode_sample, readings)), piece) == (readings, 0)


@given(st.lists(READINGS, min_size=6, max_size=20), st.data())
@settings(max_examples=60)
def test_lost_bytes_cost_their_own_sample_and_the_next_is_read(readings, data):
    frames = [encode_sample(r) for r in readings]
    # Without a checksum, a sample that lost its end can borrow the first byte of the next, and two damaged
    # ones in a row can add up to a whole one. A loss in the first half of a lone sample is always noticed.
    lone = st.integers(0, (len(frames) - 2) // 2).map(lambda k: 2 * k)
    hit = data.draw(st.lists(lone, max_size=4, unique=True))
    for k in hit:
        start = data.draw(st.integers(0, FRAME_BYTES // 2 - 1))
        lost = data.draw(st.integers(1, FRAME_BYTES // 2))
        frames[k] = frames[k][:start] + frames[k][start + lost :]
    found, skipped = decoded(b"".join(frames))
    assert found == [r for k, r in enumerate(readings) if k not in hit]
    assert skipped == sum(len(frames[k]) for k in hit)


@given(st.binary(max_size=200), READINGS, st.integers(0, 23))
@settings(max_examples=60)
def test_after_noise_the_second_sample_is_read_at_the_latest(noise, reading, cut):
    wire = noise + encode_sample(reading)[cut:] + encode_sample(reading) * 2
    assert decoded(wire)[0][-1] == reading


def test_force_and_centre_of_pressure_of_the_published_example():
    """Unit test of Open3DMotion, AccuSway-076: the sign of its force is that of the ground on the subject."""
    counts = np.array([25, -12, -72, -3, 8, -306, 19, 3, 26, -18, 0, -39.0])
    load = AMTI.matrix @ counts
    np.testing.assert_allclose(load[:3], [-3.16268, -0.09875, -107.79905], atol=1e-5)
    centre = 1e3 * centre_of_pressure(load[None], AMTI.surface_z)[0]
    np.testing.assert_allclose(centre, [-138.62861565, 168.1274746], atol=1e-6)
    on_plate = (AMTI_MATRIX * N_AND_NMM) @ counts
    np.testing.assert_allclose(1e3 * centre_of_pressure(on_plate[None], AMTI.surface_z)[0], centre)


def test_a_plate_is_started_zeroed_and_read(port):
    from mocks import scene

    with mock("amti_plate", port, "--trigger-at", "1.0", "--trigger-at", "2.0") as tally:
        source = plate(port, rate_hz=200, auto_zero=True)
        info = source.open()
        items = listen(source, 20.0, 1100)
        source.close()
    assert info.device == "AMTI plate 0983"
    assert any("not verified on hardware" in note for note in info.notes)
    assert tally.zeroed == 1
    number, device, _, values = samples(items)
    assert number.tolist() == list(range(len(number)))
    np.testing.assert_allclose(device, number / 200.0, atol=1e-9)
    got = ground_load(info.plates[0], values)
    played = scene.synthetic()
    truth = -played.loads.reshape(-1, 6)[(5 * number) % (len(played) * played.samples)]
    truth[:, :3] *= [1, -1, -1]
    assert got[:, 2].max() > 400
    error = np.abs(got[:, :3] - truth[:, :3])
    assert np.median(error) < 0.2
    assert sum(e.lost for e in events(items, "gap")) == 0
    assert [e.text for e in events(items, "trigger")][:1] == ["trigger input 1"]


def test_cut_samples_are_noticed_at_once_and_dropped_ones_by_their_arrival(port):
    with mock("amti_plate", port, "--numbers", "--cut", "70", "--drop", "0.004", "--seed", "3") as tally:
        source = plate(port)
        source.open()
        items = listen(source, 12.0, 700)
        source.close()
    _, device, _, values = samples(items)
    sent = (values[:, 0] + 2048).astype(int)
    cut = [e for e in events(items, "gap") if "passed over" in e.text]
    assert len(cut) == pytest.approx(len(sent) // 70, abs=1)
    missing = sent[-1] - sent[0] + 1 - len(sent)
    assert missing > len(cut)
    settled = sum(e.lost for e in events(items, "gap"))
    assert settled <= missing <= settled + 3  # what was dropped last is not known yet
    assert tally.dropped > 0
    assert abs(device[-1] * 200 - sent[-1]) <= 3


def test_a_pulled_plug_comes_back_with_the_old_zero_and_the_gap_is_an_estimate(port):
    with mock("amti_plate", port, "--empty", "--disconnect-at", "3.0", "--replug-after", "1.0") as tally:
        source = Reconnecting(plate(port, auto_zero=True))
        info = source.open().plates[0]
        before = listen(source, 6.0, 250)
        zero = measure_zero(raw_plate("force", 200.0, AMTI), samples(before)[3], 0)
        items = before + listen(source, 5.5)
        source.close()
    assert tally.zeroed == 1
    times = {kind: events(items, kind)[-1].host_time_ns for kind in ("disconnected", "connected")}
    away = 1e-9 * (times["connected"] - times["disconnected"])
    assert 1.0 < away + 0.05 < 1.0 + 2.0
    gap = next(e for e in events(items, "gap") if "without the plate" in e.text)
    assert gap.lost == pytest.approx(200 * away, abs=40)
    number, device, host, values = samples(items)
    assert number.tolist() == list(range(len(number)))
    assert device[-1] - device[0] == pytest.approx(host[-1] - host[0], abs=0.05)
    load = ground_load(info, values[host > 1e-9 * times["connected"]], zero.counts)
    assert len(load) > 50
    np.testing.assert_allclose(load, 0, atol=1e-9)


def test_what_keeps_a_plate_from_answering_is_told_apart(port):
    with (
        mock("amti_plate", port, "--empty", "--mute"),
        pytest.raises(LabError, match="no plate answers") as caught,
    ):
        plate(port).open()
    assert "switches A+B" in caught.value.hint
    with mock("serial_plate", port, "--numbers"), pytest.raises(LabError, match="no AMTI plate") as caught:
        plate(port).open()
    assert "USB adapters" in caught.value.hint
    with pytest.raises(LabError, match="no such port"):
        plate(port).open()
    with pytest.raises(InputError, match="no rate of 123 Hz"):
        plate(port, rate_hz=123)
    with pytest.raises(InputError, match="sends 12 channels, its calibration has 8"):
        AmtiPlate("force", str(port), built_calibration()).open()


def test_another_plate_on_the_same_port_is_refused(port):
    source = plate(port)
    with mock("amti_plate", port, "--empty", "--serial", "0983"):
        source.open()
        source.close()
    with (
        mock("amti_plate", port, "--empty", "--serial", "1111"),
        pytest.raises(InputError, match="AMTI 1111"),
    ):
        source.open()


def test_a_test_of_the_connection_says_what_the_plate_said(port):
    with mock("amti_plate", port, "--empty"):
        found = probe(str(port), "amti")
        assert (found.protocol, found.text) == ("amti", "AMTI 12-channel plate, serial number 0983")
    with mock("amti_plate", port, "--empty", "--serial", ""):
        assert "does not tell" in probe(str(port), "amti").text
    with mock("amti_plate", port, "--empty", "--mute"), pytest.raises(LabError, match="no plate answers"):
        probe(str(port), "amti")


PERIOD = 0.005


def arrive(
    lost_at: list[int], seed: int, count: int = 4000, ppm: float = 0.0, stall: bool = False
) -> list[int]:
    """What the model reports for samples of which some never come."""
    rng = np.random.default_rng(seed)
    model = ArrivalModel(PERIOD)
    held_until, reports = 0.0, []
    for k in range(count):
        if k in lost_at:
            continue
        at = k * PERIOD * (1 + 1e-6 * ppm) + 1e-4 + rng.exponential(3e-4)
        if stall and k == count // 2:
            held_until = at + 0.9
        reports.append(model.arrive(1, max(at, held_until)))
    assert model.lost == sum(reports)
    assert model.place == count - len(lost_at) + model.lost
    return [r for r in reports if r]


@pytest.mark.parametrize("ppm", [0.0, 300.0, -300.0])
def test_lost_samples_raise_the_floor_of_arrivals(ppm):
    assert arrive([], 0, ppm=ppm) == []
    assert arrive([1000], 1, ppm=ppm) == [1]
    assert sum(arrive([700, 701, 702, 2500], 2, ppm=ppm)) == 4


def test_a_stall_of_the_host_is_no_loss():
    assert arrive([], 3, stall=True) == []
    assert sum(arrive([3000], 4, stall=True)) == 1
