"""The DataStream's wire format: bytes written by hand from its description, damaged bytes, and any bytes."""

from __future__ import annotations

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.sources import cgstream
from evaluation.sources.cgstream import Framer, Kind, pack_object, pack_packet, pack_types
from evaluation.sources.stream import LabError

FRAME_42 = bytes.fromhex("01002b1a 0c000000  05000000 04000000 2a000000")
"""A packet with one object: frame number 42."""

SUBJECT = bytes.fromhex(
    "07000000 04000000 416e6e61"  # subject 7, "Anna"
    "01000000 ffffffff 00000000"  # one segment without a parent, number 0
    "000000000000000000000000000000000000000000000000 05000000 5069766f74"  # six bounds, "Pivot"
    "02000000 00000000 04000000 4c544831 09000000 04000000 4c544832"  # markers 0 "LTH1" and 9 "LTH2"
    "00000000"  # no attachments
)

MARKERS = (
    bytes.fromhex("01000000 07000000 09000000 0000000000001c40")  # one marker: subject 7, marker 9, radius 7
    + bytes.fromhex("000000000000f03f 0000000000000040 0000000000000840")  # 1, 2, 3 mm
    + bytes(72)
    + bytes.fromhex("05000000")
)

FORCES = bytes.fromhex(
    "2a000000 03000000 00000000 06000000"  # block 42 of device 3, channel 0, six numbers
    "0000803f 00000040 00004040 00008040 0000a040 0000c040"  # Fx 1 2, Fy 3 4, Fz 5 6
)


def test_a_packet_by_hand():
    (packet,) = Framer().feed(FRAME_42)
    assert packet == [(Kind.FRAME_INFO, struct.pack("<I", 42))]
    assert pack_packet([pack_object(Kind.FRAME_INFO, struct.pack("<I", 42))]) == FRAME_42


def test_a_subject_by_hand():
    subject = cgstream.read_subject(SUBJECT)
    assert (subject.number, subject.name) == (7, "Anna")
    assert subject.markers == {0: "LTH1", 9: "LTH2"}


def test_markers_by_hand():
    keys, places = cgstream.read_labelled(MARKERS)
    assert keys.tolist() == [7 * 2**32 + 9]
    np.testing.assert_array_equal(places, [[1.0, 2.0, 3.0]])


def test_samples_arrive_component_by_component():
    block = cgstream.read_block(FORCES)
    assert (block.number, block.device) == (42, 3)
    np.testing.assert_array_equal(block.values, [[1, 3, 5], [2, 4, 6]])


def test_a_plate_by_hand():
    values = [10, 20, 30, 1, 0, 0, 0, 0, -1, 0, 1, 0, -300, -200, 0, 300, 200, 0, *[0] * 12]
    plate = cgstream.read_plate(struct.pack("<I30f", 3, *values))
    np.testing.assert_array_equal(plate.rotation @ [0, 0, 1], [0, -1, 0])
    np.testing.assert_array_equal(plate.translation, [10, 20, 30])
    np.testing.assert_array_equal(plate.high, [300, 200, 0])


def test_period_devices_and_contents_by_hand():
    assert cgstream.read_period(struct.pack("<q", 675_000)) == 1 / 200
    assert cgstream.read_device(struct.pack("<IQI", 3, 1_350_000, 2) + b"P1") == (3, 0.01, "P1")
    assert cgstream.read_device_start(struct.pack("<IQ", 3, 135)) == (3, 1e-6)
    contents = struct.pack("<I6I2I", 3, 5, 1, 2, 1, 20, 0, 1, 2)
    assert cgstream.read_contents(contents) == ({5, 2}, {2})
    assert cgstream.read_types(pack_types([5, 1, 5])[8:]) == {1, 5}
    with pytest.raises(LabError, match="not positive"):
        cgstream.read_period(struct.pack("<q", 0))


@settings(max_examples=40)
@given(
    st.lists(st.lists(st.tuples(st.integers(0, 100), st.binary(max_size=60)), max_size=5), max_size=6),
    st.lists(st.integers(1, 40), min_size=1, max_size=30),
)
def test_packets_survive_any_cutting_of_the_stream(packets, sizes):
    stream = b"".join(pack_packet(pack_object(kind, body) for kind, body in packet) for packet in packets)
    framer, found = Framer(), []
    while stream:
        size = sizes[len(stream) % len(sizes)]
        found += framer.feed(stream[:size])
        stream = stream[size:]
    assert found == packets
    assert framer.skipped == 0


@given(st.binary(min_size=1, max_size=200))
def test_after_foreign_bytes_the_next_packets_are_found(noise):
    framer = Framer()
    found = [packet for piece in (noise, FRAME_42 * 3) for packet in framer.feed(piece)]
    if b"\x01\x00\x2b\x1a" not in noise:
        assert found[-2:] == Framer().feed(FRAME_42) * 2
        assert framer.skipped >= len(noise) - 3


@given(st.integers(0, 5 * 28 - 1), st.integers(1, 255))
def test_one_wrong_byte_costs_one_packet(at, change):
    whole = [pack_packet([pack_object(Kind.FRAME_INFO, struct.pack("<IQ", k, 99))]) for k in range(5)]
    stream = bytearray(b"".join(whole))
    stream[at] ^= change
    found = Framer().feed(bytes(stream) + FRAME_42)
    intact = [Framer().feed(packet)[0] for k, packet in enumerate(whole) if k != at // 28]
    remaining = iter(found)
    assert all(packet in remaining for packet in intact)


def test_claims_of_great_length_are_refused_at_once():
    framer = Framer()
    claims = struct.pack("<II", cgstream.MAGIC, cgstream.MOST_PACKET_BYTES + 1)
    assert framer.feed(claims + FRAME_42) == Framer().feed(FRAME_42)
    assert framer.skipped == 8


def test_a_length_that_runs_into_the_next_packet_is_noticed_there():
    framer = Framer()
    longer = struct.pack("<II", cgstream.MAGIC, 60_000) + FRAME_42[8:]
    assert framer.feed(longer) == []
    assert framer.feed(FRAME_42) == Framer().feed(FRAME_42)


def test_endless_noise_takes_no_memory():
    framer = Framer()
    for _ in range(40):
        assert framer.feed(bytes(2**18)) == []
    assert framer.skipped > 10_000_000
    many = pack_packet([pack_object(1)] * (cgstream.MOST_OBJECTS + 1))
    assert Framer().feed(many) == []


READERS = [
    cgstream.read_types,
    cgstream.read_contents,
    cgstream.read_period,
    cgstream.read_subject,
    cgstream.read_device,
    cgstream.read_device_start,
    cgstream.read_plate,
    cgstream.read_labelled,
    cgstream.read_block,
]


@given(st.sampled_from(READERS), st.binary(max_size=300))
def test_any_payload_is_read_or_refused_by_name(reader, payload):
    with contextlib.suppress(LabError):
        reader(payload)


@pytest.mark.parametrize("reader", [cgstream.read_types, cgstream.read_contents, cgstream.read_labelled])
def test_counts_beyond_the_payload_are_refused_before_anything_is_made(reader):
    with pytest.raises(LabError, match="claims 4294967295 items"):
        reader(b"\xff\xff\xff\xff" + bytes(100))


def test_truncated_payloads_are_refused():
    for reader, payload in [(cgstream.read_subject, SUBJECT), (cgstream.read_labelled, MARKERS)]:
        for end in range(len(payload) - 4):
            with pytest.raises(LabError):
                reader(payload[:end])
    for end in range(len(FORCES)):
        with pytest.raises(LabError):
            cgstream.read_block(FORCES[:end])
