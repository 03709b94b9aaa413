"""Frames of self-built plates under damage: nothing wrong gets in, nothing whole gets lost."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.sources import cobs
from evaluation.sources.ascii_lines import LineDecoder, info_line, sample_line
from evaluation.sources.sample_order import SampleOrder
from evaluation.sources.serial_frame import (
    LONGEST_FRAME,
    Announcement,
    Damage,
    Edge,
    FrameDecoder,
    Sample,
    edge_frame,
    frame,
    info_frame,
    read_announcement,
    sample_frame,
)

PLATE = Announcement("bench", "7", 1000.0, tuple(f"f{k}" for k in range(8)))


def stuffed_by_the_book(plain: bytes) -> bytes:
    """COBS by Cheshire & Baker's own listing (StuffData), byte by byte."""
    out, code_at, code = bytearray([0]), 0, 1
    for byte in plain:
        if byte == 0:
            out[code_at], code_at, code = code, len(out), 1
            out.append(0)
            continue
        out.append(byte)
        code += 1
        if code == 0xFF:
            out[code_at], code_at, code = code, len(out), 1
            out.append(0)
    out[code_at] = code
    return bytes(out)


@pytest.mark.parametrize(
    ("plain", "stuffed"),
    [
        (b"\0", b"\x01\x01"),
        (b"\0\0", b"\x01\x01\x01"),
        (b"\0\x11\0", b"\x01\x02\x11\x01"),
        (b"\x11\x22\0\x33", b"\x03\x11\x22\x02\x33"),
        (b"\x11\x22\x33\x44", b"\x05\x11\x22\x33\x44"),
        (b"\x11\0\0\0", b"\x02\x11\x01\x01\x01"),
        (bytes(range(1, 255)), b"\xff" + bytes(range(1, 255))),
        (bytes(range(256)), b"\x01\xff" + bytes(range(1, 255)) + b"\x02\xff"),
    ],
)
def test_published_examples_of_byte_stuffing(plain, stuffed):
    assert cobs.encode(plain) == stuffed
    assert cobs.decode(stuffed) == plain


@given(st.binary(max_size=900) | st.lists(st.sampled_from([0, 1, 255]), max_size=900).map(bytes))
def test_byte_stuffing_returns_what_it_was_given_and_holds_no_zero(plain):
    stuffed = cobs.encode(plain)
    assert 0 not in stuffed
    assert len(stuffed) <= len(plain) + 1 + len(plain) // 254
    assert cobs.decode(stuffed) == plain
    assert cobs.decode(stuffed_by_the_book(plain)) == plain


def test_a_frame_is_what_the_specification_says():
    payload = struct.pack("<BHI2i", 1, 0x1234, 0x89ABCDEF, -1, 70000)
    checked = payload + struct.pack("<I", zlib.crc32(payload))
    assert sample_frame(0x1234, 0x89ABCDEF, (-1, 70000)) == b"\0" + stuffed_by_the_book(checked) + b"\0"


def test_messages_come_back_from_any_pieces():
    wire = info_frame(PLATE) + sample_frame(65535, 2**32 - 1, (1,) * 8) + edge_frame(17, 1)
    for size in (1, 3, 7, len(wire)):
        decoder = FrameDecoder()
        found = [m for k in range(0, len(wire), size) for m in decoder.feed(wire[k : k + size])]
        assert found == [PLATE, Sample(65535, 2**32 - 1, (1,) * 8), Edge(17, 1)]


def test_what_has_another_form_is_refused_although_its_checksum_is_right():
    decoder = FrameDecoder(8)
    wrong = [
        sample_frame(1, 1, (1,) * 7),
        frame(b"\x01\x02\x03"),
        frame(b"\x04rest"),
        frame(struct.pack("<BIB", 3, 1, 2)),
        frame(b"\x02{}"),
        frame(b"\x02" + b"[" * 900),
        frame(b""),
        b"\x01" * (LONGEST_FRAME + 5),
    ]
    for data in wrong:
        assert all(isinstance(m, Damage) for m in decoder.feed(data)), data
    assert decoder.feed(sample_frame(1, 1, (1,) * 8)) == [Sample(1, 1, (1,) * 8)]


@pytest.mark.parametrize(
    "text",
    ["", "7", "{}", '{"rate_hz":0,"channels":["a"]}', '{"rate_hz":100,"channels":[]}', "[" * 5000,
     '{"rate_hz":"x","channels":["a"]}', '{"rate_hz":NaN,"channels":["a"]}',
     '{"rate_hz":100,"channels":"abc"}'],
)  # fmt: skip
def test_a_plate_that_does_not_say_what_is_needed_is_not_understood(text):
    assert read_announcement(text) is None


def test_control_characters_of_a_plate_do_not_reach_a_terminal():
    told = read_announcement('{"name":"a\\u001b[31m","rate_hz":10,"channels":["x"]}')
    assert told is not None
    assert told.name == "a?[31m"


def wire_of(rng: np.random.Generator, count: int, lines: bool = False) -> tuple[list[bytes], list[tuple]]:
    """Frames as sent, and what each of them says."""
    clock = 1000 * np.arange(count)
    counts = rng.integers(-(2**23), 2**23, (count, 8))
    counts[:, rng.integers(0, 8)] = 0
    said = [(k, int(t), tuple(row)) for k, t, row in zip(range(count), clock, counts.tolist(), strict=True)]
    return [sample_line(t, c) if lines else sample_frame(k, t, c) for k, t, c in said], said


def damage(rng: np.random.Generator, frames: list[bytes], rate: float) -> tuple[bytes, np.ndarray]:
    """The bytes after each was replaced with some probability, and which frames were hit."""
    wire = np.frombuffer(b"".join(frames), np.uint8).copy()
    hit = np.flatnonzero(rng.random(len(wire)) < rate)
    wire[hit] ^= rng.integers(1, 256, len(hit), dtype=np.uint8)
    owner = np.repeat(np.arange(len(frames)), [len(f) for f in frames])
    return wire.tobytes(), np.bincount(owner[hit], minlength=len(frames)) > 0


def decoded(decoder, wire: bytes, piece: int) -> list[Sample]:
    found = [m for k in range(0, len(wire), piece) for m in decoder.feed(wire[k : k + piece])]
    return [m for m in found if isinstance(m, Sample)]


def check_against_oracle(found: list[Sample], said: list[tuple], damaged: np.ndarray) -> None:
    """No wrong frame, none twice, none out of order, and every undamaged one."""
    index = {(t, c): k for k, t, c in said}
    places = [index.get((s.microseconds, s.counts), -1) for s in found]
    assert -1 not in places
    assert places == sorted(set(places))
    assert set(np.flatnonzero(~damaged).tolist()) <= set(places)


@given(st.integers(0, 2**32 - 1), st.integers(1, 200), st.sampled_from([0.001, 0.01, 0.05]))
@settings(max_examples=25)
def test_under_damage_no_wrong_frame_gets_in_and_no_whole_one_gets_lost(seed, piece, rate):
    rng = np.random.default_rng(seed)
    frames, said = wire_of(rng, 150)
    wire, damaged = damage(rng, frames, rate)
    check_against_oracle(decoded(FrameDecoder(8), wire, piece), said, damaged)


@given(st.integers(0, 2**32 - 1), st.integers(1, 200), st.sampled_from([0.001, 0.01, 0.05]))
@settings(max_examples=15)
def test_under_damage_lines_hold_to_the_same(seed, piece, rate):
    rng = np.random.default_rng(seed)
    frames, said = wire_of(rng, 60, lines=True)
    frames = [f[:-2] + b"\n" if k % 3 == 0 else f for k, f in enumerate(frames)]
    wire, damaged = damage(rng, frames, rate)
    check_against_oracle(decoded(LineDecoder(8), wire, piece), said, damaged)


@given(st.data(), st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_lost_and_inserted_bytes_cost_their_own_frame_only(data, seed):
    rng = np.random.default_rng(seed)
    frames, said = wire_of(rng, 30)
    damaged = np.zeros(30, bool)
    for k in data.draw(st.lists(st.integers(0, 29), max_size=8, unique=True)):
        at, size = int(rng.integers(0, len(frames[k]))), int(rng.integers(1, 60))
        noise = bytes(rng.integers(0, 256, size, dtype=np.uint8)) if rng.random() < 0.5 else b""
        cut = 0 if noise else size
        frames[k] = frames[k][:at] + noise + frames[k][at + cut :]
        damaged[k] = True
    # noise right behind a frame may be what its own end looks like, so only the others are counted on
    check_against_oracle(decoded(FrameDecoder(8), b"".join(frames), 64), said, damaged)


@given(st.binary(max_size=3 * LONGEST_FRAME), st.integers(0, 45))
def test_after_any_noise_the_next_frame_is_read(noise, cut):
    """Resynchronisation takes no frame that arrives whole, wherever reading begins."""
    said = (5, 5000, tuple(range(8)))
    found = decoded(FrameDecoder(8), noise + sample_frame(*said)[cut:] + sample_frame(*said), 100)
    assert Sample(*said) in found
    assert all(s == Sample(*said) for s in found)


@pytest.mark.parametrize("frames", [4000, pytest.param(1_000_000, marks=pytest.mark.soak)])
def test_one_percent_of_wrong_bytes(frames):
    """Places and all: 37 % of the frames are damaged, the rest arrive with their true number and time."""
    rng, decoder, order = np.random.default_rng(11), FrameDecoder(8), SampleOrder(1000.0)
    hit = whole = 0
    for block in range(0, frames, 4000):
        sent, said = wire_of(rng, 4000)
        said = [(k + block, t + 1000 * block, c) for k, t, c in said]
        wire, damaged = damage(rng, [sample_frame(*one) for one in said], 0.01)
        found = [s for s in decoder.feed(wire) if isinstance(s, Sample)]
        placed = [p for s in found for p in order.place(s, 1000 * s.microseconds + 10**6)]
        truth = {k: (t, c) for k, t, c in said}
        assert len(sent) == len(said)
        got = {p.number: p for p in placed}
        assert set(np.flatnonzero(~damaged) + block) <= set(got)
        for number, p in got.items():
            clock, counts = truth[number]
            assert p.counts == counts
            assert p.device_time_s == pytest.approx(1e-6 * clock, abs=1e-6)
        hit, whole = hit + damaged.sum(), whole + (~damaged).sum()
    assert 0.3 < hit / (hit + whole) < 0.42
    assert order.implausible == 0
    assert order.restarts == 0


def placed_numbers(order: SampleOrder, samples: list[tuple[int, int, float]]) -> list[int]:
    """Numbers of samples given as counter, clock [us] and arrival [s]."""
    return [
        p.number
        for sequence, clock, host in samples
        for p in order.place(Sample(sequence % 65536, clock % 2**32, (1,)), int(1e9 * host))
    ]


@given(
    st.integers(0, 65535), st.integers(0, 2**32 - 1), st.lists(st.integers(1, 5000), min_size=2, max_size=60)
)
def test_counter_and_clock_unwrap(sequence, clock, steps):
    numbers = np.cumsum([0, *steps])
    samples = [(sequence + int(n), clock + 1000 * int(n), 1e-3 * n + 9) for n in numbers]
    assert placed_numbers(SampleOrder(1000.0), samples) == (sequence + numbers).tolist()


def test_a_sample_that_nothing_bears_out_is_dropped():
    order = SampleOrder(1000.0)
    good = [(k, 1000 * k, 1e-3 * k) for k in range(50)]
    wrong = [(40000, 123456789, 0.025), (25, 3_000_000_000, 0.0255)]
    assert placed_numbers(order, good[:25] + wrong + good[25:]) == list(range(50))
    assert order.implausible == 2
    assert order.restarts == 0


@pytest.mark.parametrize(("clock_s", "counter"), [(0.0, 0), (1.0, 1000), (5.0, 5000), (3000.0, 12)])
@pytest.mark.parametrize("away_s", [0.0, 1.5, 60.0])
def test_a_plate_that_starts_anew_goes_on_where_the_host_puts_it(clock_s, counter, away_s):
    order = SampleOrder(1000.0)
    before = placed_numbers(order, [(k, 1000 * k, 1e-3 * k + 4) for k in range(2000)])
    if away_s:
        order.reopen()
    host = 6.0 + away_s
    after = [(counter + k, int(1e6 * clock_s) + 1000 * k, host + 1e-3 * k) for k in range(50)]
    numbers = placed_numbers(order, after)
    assert before[-1] == 1999
    assert order.restarts == 1
    assert numbers[0] == pytest.approx(2000 + 1000 * away_s, abs=2)
    assert np.diff(numbers).tolist() == [1] * 49


def test_a_busy_host_that_gets_everything_late_loses_nothing():
    order = SampleOrder(1000.0)
    delay = [max(0.0, 2.0 - 1e-3 * (k - 500)) if k >= 500 else 0.0 for k in range(3500)]
    late = [(k, 1000 * k, 1e-3 * k + delay[k]) for k in range(3500)]
    assert placed_numbers(order, late) == list(range(3500))
    assert order.restarts == 0


def test_lines_say_what_the_specification_says():
    assert sample_line(12, (3, -4)) == b"12,3,-4*%08X\r\n" % zlib.crc32(b"12,3,-4")
    decoder = LineDecoder()
    assert decoder.feed(info_line(PLATE) + sample_line(12, (3,) * 8)) == [PLATE, Sample(None, 12, (3,) * 8)]
    assert all(isinstance(m, Damage) for m in decoder.feed(sample_line(13, (3,) * 7) + b"1,2\n,*00000000\n"))


def test_lines_are_counted_by_their_clock():
    order = SampleOrder(80.0)
    clocks = [k * 12500 for k in range(100) if k not in (20, 21, 50)]
    placed = [p for t in clocks for p in order.place(Sample(None, t, (1,)), 1000 * t)]
    assert [p.number for p in placed] == [k for k in range(100) if k not in (20, 21, 50)]
