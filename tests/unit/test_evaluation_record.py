"""Recordings: nothing is lost on the way to the disk, and a cut file gives everything before the cut."""

from __future__ import annotations

import json
import math
import os
import struct
import time
from dataclasses import replace
from io import FileIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import CRCValidationError

from evaluation.record.mcap_log import McapLog, create_file
from evaluation.record.messages import Mark, decode, describe, encode
from evaluation.record.reading import read_log
from evaluation.record.recorder import Recorder
from evaluation.record.recover import recover
from evaluation.sources.stream import MarkerFrame, PlateSamples, SourceEvent
from hilbrace.errors import InputError
from tests.unit.evaluation_devices import INFO, PLATE, frame, stream

RNG = np.random.default_rng(5)


@pytest.fixture
def recording(tmp_path):
    """A finished recording, and what went in."""
    items = list(stream(300))
    recorder = Recorder(tmp_path / "take.mcap", (INFO,), {"condition": "Unbraced"})
    recorder.mark("condition", "Optimized")
    for k, item in enumerate(items):
        recorder.add(item)
        if k % 40 == 0:
            time.sleep(0.021)
            recorder.tick()
    return recorder.close(), items


def same(one, other):
    """Whether two items are equal, arrays to the last bit."""
    if type(one) is not type(other):
        return False
    for name, value in vars(one).items():
        against = getattr(other, name)
        if isinstance(value, np.ndarray):
            if not np.array_equal(value, against, equal_nan=True):
                return False
        elif name == "plates":
            if not all(map(same, value, against)):
                return False
        elif value != against and not (
            isinstance(value, float) and math.isnan(value) and math.isnan(against)
        ):
            return False
    return True


def test_a_recording_gives_back_what_went_in(recording):
    written, items = recording
    recorded = read_log(written.path)
    assert recorded.finished
    assert recorded.discarded_bytes == recorded.damaged_chunks == 0
    assert same(recorded.items[0], INFO)
    assert len(recorded.items) == len(items) + 1
    assert all(map(same, recorded.items[1:], items))
    assert [mark.kind for mark in recorded.marks] == ["start", "condition", "stop"]
    assert recorded.marks[0].content["condition"] == "Unbraced"
    assert recorded.condition == "Optimized"
    assert (written.frames, written.samples, written.lost) == (300, 1500, 0)
    assert written.bytes == written.path.stat().st_size


def test_the_format_s_own_library_reads_a_finished_recording_by_its_index(recording):
    written, items = recording
    with open(written.path, "rb") as stream_:
        reader = make_reader(stream_, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == len(items) + 4
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 5
        topics = {channel.topic for channel in summary.channels.values()}
        assert topics == {"/session", "/lab/info", "/lab/markers", "/lab/1"}
        assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema"}
        frames = [
            json.loads(message.data)
            for schema, channel, message in reader.iter_messages(topics=["/lab/markers"])
        ]
        assert [content["frame"] for content in frames] == list(range(300))
        assert set(frames[0]["markers"]) == {"TH1", "TH2", "HIP"}
        assert frames[7]["markers"]["TH2"] is None
        starts = summary.chunk_indexes[3].message_start_time
        later = list(reader.iter_messages(starting_at=starts))
        assert 0 < len(later) < len(items)


def test_times_in_the_file_are_wall_clock_times(recording):
    written, _ = recording
    with open(written.path, "rb") as stream_:
        times = [message.log_time for *_, message in make_reader(stream_).iter_messages()]
    assert abs(times[0] - written.path.stat().st_mtime_ns) < 60e9


def test_a_file_cut_anywhere_gives_everything_before_the_cut(recording, tmp_path):
    written, items = recording
    content = written.path.read_bytes()
    whole = read_log(written.path)
    known = 0
    for cut in np.linspace(6000, len(content) - 1, 24).astype(int):
        path = tmp_path / "cut.mcap"
        path.write_bytes(content[:cut])
        recorded = read_log(path)
        assert not recorded.finished
        assert all(map(same, recorded.items, whole.items))
        assert len(recorded.items) >= known
        known = len(recorded.items)
    assert known == len(items) + 1


def test_the_library_reads_a_cut_file_as_far_as_we_do(recording, tmp_path):
    written, _ = recording
    path = tmp_path / "cut.mcap"
    path.write_bytes(written.path.read_bytes()[: written.bytes // 2])
    ours = read_log(path)
    with open(path, "rb") as stream_:
        messages = NonSeekingReader(stream_).iter_messages(log_time_order=False)
        for message in ours.messages:
            assert next(messages)[2].data == message.data
        assert len(ours.messages) > 100
        with pytest.raises((EndOfFile, CRCValidationError, struct.error)):
            next(messages)


def test_a_recovered_file_is_whole_and_says_what_is_missing(recording, tmp_path):
    written, _ = recording
    path = tmp_path / "cut.mcap"
    path.write_bytes(written.path.read_bytes()[: 2 * written.bytes // 3])
    before = read_log(path)
    found = recover(path)
    assert found.path.name == "cut_recovered.mcap"
    assert not found.finished
    assert found.frames > 100
    assert "without having been closed" in found.gaps[0]
    assert "50 ms" in found.gaps[0]
    assert found.discarded_bytes == before.discarded_bytes > 0
    clean = read_log(found.path)
    assert clean.finished
    assert all(map(same, clean.items, before.items))
    assert clean.marks[-1].kind == "recovered"
    assert clean.marks[-1].content["gaps"] == list(found.gaps)
    with open(found.path, "rb") as stream_:
        assert make_reader(stream_, validate_crcs=True).get_summary().statistics.chunk_count < 10
    again = recover(path)
    assert again.path.name == "cut_recovered_2.mcap"


def test_gaps_of_the_device_s_counter_are_reported(tmp_path):
    recorder = Recorder(tmp_path / "take.mcap", (INFO,), {})
    for item in (*stream(100), *stream(50, first=120)):
        recorder.add(item)
    recorder.add(SourceEvent("lab", "disconnected", time.monotonic_ns(), math.nan, "The line went dead.", 3))
    assert recorder.close().lost == 3
    found = recover(tmp_path / "take.mcap")
    assert found.finished
    assert found.missing == {"lab markers": 20, "lab 1": 100}
    assert found.gaps[:2] == (
        "lab markers: 20 missing by the device's counter.",
        "lab 1: 100 missing by the device's counter.",
    )
    assert found.gaps[2].startswith("lab, ")
    assert found.gaps[2].endswith("The line went dead.")


def test_a_damaged_chunk_costs_only_itself(recording, tmp_path):
    written, items = recording
    content = bytearray(written.path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    recorded = read_log(path)
    assert recorded.finished
    assert recorded.damaged_chunks <= 1
    numbers = [item.number for item in recorded.items if isinstance(item, MarkerFrame)]
    assert 300 > len(numbers) >= 300 - 45 or len(numbers) == 300
    assert all(frame_ in map(lambda i: i.number, items[::2]) for frame_ in numbers)


@pytest.mark.parametrize(
    ("content", "what"),
    [(b"", "no MCAP"), (b"hello", "no MCAP"), (b"\x89MCAP0\r\n", "holds nothing"),
     (b"\x89MCAP0\r\n" + bytes(500), "holds nothing"),
     (b"\x89MCAP0\r\n\x06" + b"\xff" * 90, "holds nothing")],
)  # fmt: skip
def test_foreign_files_are_refused_by_name(tmp_path, content, what):
    path = tmp_path / "foreign.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=what):
        read_log(path)
    with pytest.raises(InputError, match="no such recording"):
        read_log(tmp_path / "absent.mcap")
    with pytest.raises(InputError, match="cannot read"):
        read_log(tmp_path)


@given(st.data())
def test_no_damage_raises_anything_but_a_named_error(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "fuzz"
    folder.mkdir(exist_ok=True)
    source = folder / "source.mcap"
    if not source.exists():
        recorder = Recorder(source, (INFO,), {})
        for item in stream(20):
            recorder.add(item)
        recorder.close()
    content = bytearray(source.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    path = folder / "fuzzed.mcap"
    path.write_bytes(content[: data.draw(st.integers(1, len(content)))])
    try:
        read_log(path)
    except InputError:
        pass


def test_nothing_is_ever_overwritten(tmp_path):
    made = [create_file(tmp_path / "take.mcap") for _ in range(3)]
    for _, stream_ in made:
        stream_.close()
    assert [path.name for path, _ in made] == ["take.mcap", "take_2.mcap", "take_3.mcap"]
    with pytest.raises(InputError, match="cannot create"):
        create_file(tmp_path / "absent" / "take.mcap")


def test_a_full_disk_is_an_error_and_not_a_silence():
    with FileIO("/dev/full", "wb") as stream_, pytest.raises(OSError, match="No space"):
        McapLog(stream_)


def test_a_disk_that_fills_up_keeps_what_was_written(tmp_path):
    recorder = Recorder(tmp_path / "take.mcap", (INFO,), {})
    for item in stream(50):
        recorder.add(item)
    time.sleep(0.021)
    recorder.tick()
    with open("/dev/full", "wb") as full:
        os.dup2(full.fileno(), recorder._log._stream.fileno())
    recorder.add(frame(50, RNG))
    time.sleep(0.021)
    with pytest.raises(OSError, match="No space"):
        recorder.tick()
    recorder.abandon()
    recorded = read_log(tmp_path / "take.mcap")
    assert not recorded.finished
    assert sum(isinstance(item, MarkerFrame) for item in recorded.items) == 50


def test_channels_follow_a_change_of_the_markers(tmp_path):
    recorder = Recorder(tmp_path / "take.mcap", (INFO,), {})
    recorder.add(frame(0, RNG))
    recorder.add(replace(INFO, labels=("A", "B")))
    recorder.add(frame(1, RNG, markers=2))
    recorder.add(frame(2, RNG, markers=4))
    recorder.close()
    recorded = read_log(tmp_path / "take.mcap")
    assert [len(item.positions) for item in recorded.items if isinstance(item, MarkerFrame)] == [3, 2, 4]
    names = [set(json.loads(message.data)["markers"]) for message in recorded.messages
             if recorded.channels[message.channel_id].topic == "/lab/markers"]  # fmt: skip
    assert names == [
        {"TH1", "TH2", "HIP"}, {"A", "B"}, {"marker_1", "marker_2", "marker_3", "marker_4"},
    ]  # fmt: skip


@given(
    st.lists(st.floats(width=64), min_size=6, max_size=6),
    st.integers(0, 2**63 - 1),
    st.floats(allow_nan=True, allow_infinity=False),
)
def test_values_survive_the_message(values, number, device_time):
    places = np.array(values).reshape(2, 3)
    sent = MarkerFrame("lab", number, device_time, 12, places)
    info = replace(INFO, labels=("A", "B"))
    got = decode(encode(sent, info), describe(sent, info)[1])
    hidden = ~np.isfinite(places).all(axis=1)
    assert np.array_equal(got.positions, np.where(hidden[:, None], np.nan, places), equal_nan=True)
    assert got.number == number
    sent = PlateSamples("lab", "1", number, device_time, 0.001, 12, places.reshape(1, 6))
    got = decode(encode(sent, info), describe(sent, info)[1])
    assert np.array_equal(got.values, np.where(np.isfinite(sent.values), sent.values, np.nan), equal_nan=True)


def test_counts_are_stored_as_whole_numbers():
    counts = PlateSamples("lab", "1", 0, 0.0, 0.001, 0, np.array([[1.0, 2, 3, 4, 5, -6]]))
    assert b'"Mz":[-6]' in encode(counts, INFO)
    assert b'"Fz":[3]' in encode(counts, replace(INFO, plates=(PLATE,)))


def test_unknown_messages_are_refused():
    with pytest.raises(ValueError, match="unknown kind"):
        decode(b"{}", {"kind": "picture"})
    with pytest.raises(ValueError, match="none of"):
        decode(b'{"kind":"x","host_time_ns":1,"text":"","content":{}}', {"kind": "mark"})
    mark = Mark("note", 5, "a \u00b5-note", {"a": [1, None]})
    assert decode(encode(mark, None), describe(mark, None)[1]) == mark
