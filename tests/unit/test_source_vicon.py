"""Our DataStream client against the mock system, and against servers that misbehave."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import itertools
import socket
import threading
import time

import numpy as np
import pytest

from evaluation.sources import vicon
from evaluation.sources.cgstream import Kind, pack_packet, pack_types
from evaluation.sources.reconnecting import Reconnecting
from evaluation.sources.stream import LabError, ground_load
from evaluation.sources.vicon import ViconSource
from evaluation.sources.vicon_scene import Scene
from hilbrace.errors import InputError
from mocks import faults, scene, vicon_server
from tests.unit.mock_process import Heard, listen, mock

OPTIONS = argparse.Namespace(once=True, speed=1000.0, change_markers_at=None, patient=False)


@pytest.fixture(scope="module")
def content():
    return scene.synthetic()


class Line:
    """A socket that keeps what it is given."""

    def __init__(self):
        self.sent = []

    def sendall(self, data):
        self.sent.append(data)


def stream(content, frames, wants=None):
    """What the mock would send: the greeting, and frames."""
    server = vicon_server.Server(content, faults.Faults(), OPTIONS)
    client = vicon_server.Client(Line())
    client.wants = wants or set(vicon.WANTED)
    client.push = True
    known = None
    for number in range(frames):
        client.line.sendall(server._frame(client, number, content.labels, known))
        known = set(client.wants), content.labels
    return pack_packet([pack_types(client.wants)]), client.line.sent


@contextlib.contextmanager
def serving(greeting, *pieces, hold=False):
    """A server on the loopback address: greeting, the client's requests, these pieces; gives its port."""
    stop = threading.Event()

    def serve(line):
        line.sendall(greeting)
        if pieces:
            line.recv(4096)
        for piece in pieces:
            line.sendall(piece)
        if hold:
            stop.wait()
        line.shutdown(socket.SHUT_WR)
        while line.recv(4096):
            pass

    def run():
        with contextlib.suppress(OSError):
            for line, _ in iter(listener.accept, None):
                with line, contextlib.suppress(OSError):
                    line.settimeout(10)
                    serve(line)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield listener.getsockname()[1]
        stop.set()
        listener.shutdown(socket.SHUT_RDWR)
    thread.join(15)


def everything(port, patience_s=1.0):
    """All items until the connection is lost."""
    source = ViconSource("vicon", "127.0.0.1", port, patience_s)
    heard = Heard([source.open()])
    try:
        for _ in itertools.repeat(None):
            heard.items += source.read(0.5)
    except LabError:
        return heard
    finally:
        source.close()


def test_markers_gaps_and_loads_arrive_as_they_were(content):
    greeting, frames = stream(content, 600)
    with serving(greeting, *frames) as port:
        heard = everything(port)
    assert [frame.number for frame in heard.frames] == list(range(600))
    positions = np.stack([frame.positions for frame in heard.frames])
    np.testing.assert_allclose(positions, content.positions[:600], atol=1e-9)
    assert np.isnan(positions).any()
    (info,) = heard.infos
    assert (info.labels, info.rate_hz, info.up) == (content.labels, 200.0, "z")
    assert heard.frames[7].device_time_s == pytest.approx(7 / 200)
    (plate,) = info.plates
    assert plate.rate_hz == pytest.approx(1000.0)
    assert [block.number for block in heard.samples] == list(range(0, 3000, 5))
    load = np.concatenate([ground_load(plate, block.values) for block in heard.samples])
    force = -content.loads[:600].reshape(-1, 6)[:, :3] @ scene.PLATE_ROTATION.T
    np.testing.assert_allclose(load[:, :3], force, atol=1e-3)
    assert load[:, 2].max() > 600


def test_the_centre_of_pressure_of_the_loads_is_where_the_subject_stands(content):
    greeting, frames = stream(content, 440)
    with serving(greeting, *frames) as port:
        heard = everything(port)
    load = ground_load(heard.infos[0].plates[0], heard.samples[430].values)
    centre = np.column_stack([-load[:, 4], load[:, 3]]) / load[:, 2:3]
    expected = content.plate_origin + content.centres[430] @ scene.PLATE_ROTATION.T
    np.testing.assert_allclose(centre, expected[:, :2], atol=1e-4)


def test_the_mock_in_its_own_process_streams_without_losses():
    with mock("vicon_server") as port:
        source = Reconnecting(ViconSource("vicon", "127.0.0.1", port))
        source.open()
        heard = listen(source, lambda heard: len(heard.frames) >= 300)
        source.close()
    assert heard.events("gap", "fault", "disconnected") == []
    assert [frame.number for frame in heard.frames] == list(range(len(heard.frames)))


def test_dropped_frames_are_counted_from_the_devices_counter():
    with mock("vicon_server", "--drop", "0.05", "--speed", "10", "--seed", "4") as port:
        source = Reconnecting(ViconSource("vicon", "127.0.0.1", port))
        source.open()
        heard = listen(source, lambda heard: len(heard.frames) >= 1000)
        source.close()
    numbers = [frame.number for frame in heard.frames]
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert missing > 20
    assert sum(event.lost for event in heard.events("gap") if not event.plate) == missing


def test_a_broken_line_and_a_restarted_server_are_outlived():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    source = Reconnecting(ViconSource("vicon", "127.0.0.1", port))
    with mock("vicon_server", "--port", port, "--disconnect-at", "0.4"):
        source.open()
        heard = listen(source, lambda heard: len(heard.events("connected")) == 2 and len(heard.frames) > 150)
    (gap,) = [event for event in heard.events("gap") if not event.plate]
    numbers = [frame.number for frame in heard.frames]
    assert gap.lost == numbers[-1] - numbers[0] + 1 - len(numbers) > 50
    with mock("vicon_server", "--port", port):
        again = listen(source, lambda heard: len(heard.events("gap")) >= 2)
    source.close()
    assert "unknown" in next(event for event in again.events("gap") if not event.plate).text


def test_a_marker_set_that_changes_is_described_anew():
    with mock("vicon_server", "--change-markers-at", "0.3") as port:
        source = Reconnecting(ViconSource("vicon", "127.0.0.1", port))
        first = source.open()
        heard = listen(source, lambda heard: bool(heard.infos) and isinstance(heard.items[-1], object))
        heard.items += listen(source, lambda heard: len(heard.frames) > 10).items
        source.close()
    (second,) = heard.infos
    assert second.labels == first.labels[:-1]
    labels = first.labels
    for item in heard.items:
        labels = getattr(item, "labels", labels)
        assert len(getattr(item, "positions", labels)) == len(labels)


def test_two_markers_of_one_name_are_refused(content):
    twins = dataclasses.replace(content, labels=("A",) * len(content.labels))
    greeting, frames = stream(twins, 2)
    with serving(greeting, *frames) as port, pytest.raises(InputError, match="two markers are called 'A'"):
        ViconSource("vicon", "127.0.0.1", port).open()


def test_moments_about_another_point_are_told_once(content):
    moved = content.centres + np.array([0.0, 0.03, 0.0])
    for centres, told in ((content.centres, 0), (moved, 1)):
        greeting, frames = stream(dataclasses.replace(content, centres=centres), 500)
        with serving(greeting, *frames) as port:
            faults_told = everything(port).events("fault")
        assert len(faults_told) == told
    assert "30 mm" in faults_told[0].text
    assert faults_told[0].plate == "Plate 1"


def test_two_subjects_keep_their_markers_apart(content):
    first = vicon_server.static_objects(content, ("A", "B"))[Kind.SUBJECT_INFO]
    other = bytes([9]) + first[0][1:]
    body = {Kind.SUBJECT_INFO: [first[0], other]}
    kept = Scene()
    packet = [(kind, payload) for kind, payloads in body.items() for payload in payloads]
    assert kept.update(packet)
    assert kept.labels == ("Limb:A", "Limb:B", "Limb:A", "Limb:B")
    markers = vicon_server.word(1) + vicon_server.word(9, 1)
    record = markers + np.array([0, 1, 2, 3, *[0] * 9], "<f8").tobytes() + vicon_server.word(0)
    places = kept.positions(record)
    np.testing.assert_allclose(places[3], [0.001, 0.002, 0.003])
    assert np.isnan(places[:3]).all()


def test_damaged_streams_end_in_items_or_named_errors(content):
    greeting, frames = stream(content, 12)
    whole = b"".join(frames)
    rng = np.random.default_rng(1)
    for _ in range(25):
        damaged = np.frombuffer(whole, np.uint8).copy()
        hits = rng.integers(0, len(damaged), int(rng.integers(1, 30)))
        damaged[hits] = rng.integers(0, 256, len(hits))
        with serving(greeting, damaged[: rng.integers(1, len(damaged))].tobytes()) as port:
            try:
                heard = everything(port)
            except LabError as fault:
                assert fault.hint  # noqa: PT017
                continue
        assert len(heard.frames) <= 12


def test_a_truncated_stream_gives_what_was_whole(content):
    greeting, frames = stream(content, 5)
    with serving(greeting, *frames[:4], frames[4][:-1]) as port:
        heard = everything(port)
    assert [frame.number for frame in heard.frames] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("greeting", "told"),
    [
        (b"", "does not introduce itself"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "not a DataStream"),
        (b"\xff" * 50, "not a DataStream"),
    ],
)
def test_other_servers_are_named_within_bounded_time(greeting, told):
    start = time.monotonic()
    with serving(greeting, hold=True) as port, pytest.raises(LabError, match=told):
        ViconSource("vicon", "127.0.0.1", port, patience_s=0.3).open()
    assert time.monotonic() - start < 3


def test_a_server_without_frames_is_named(content):
    greeting, _ = stream(content, 1)
    with serving(greeting, hold=True) as port, pytest.raises(LabError, match="no frames") as caught:
        ViconSource("vicon", "127.0.0.1", port, patience_s=0.3).open()
    assert "go live" in caught.value.hint


def test_hosts_that_are_not_there_are_named():
    with socket.create_server(("127.0.0.1", 0)) as free:
        closed = free.getsockname()[1]
    with pytest.raises(LabError, match="nothing listens"):
        ViconSource("vicon", "127.0.0.1", closed).open()
    with pytest.raises(InputError, match="no network address"):
        ViconSource("vicon", "127.0.0.1", 70000).open()
    with pytest.raises(LabError, match="not open"):
        ViconSource("vicon", "127.0.0.1", closed).read(0.0)


def test_a_name_that_nobody_resolves_is_given_up_in_time(monkeypatch):
    blocked = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: blocked.wait(20))
    start = time.monotonic()
    with pytest.raises(LabError, match="unknown"):
        ViconSource("vicon", "lab.example", patience_s=0.2).open()
    blocked.set()
    assert time.monotonic() - start < 3


def test_an_endless_stream_of_nonsense_is_left(content):
    greeting, frames = stream(content, 1)
    with serving(greeting, frames[0], *[bytes(2**18)] * 20) as port:
        source = ViconSource("vicon", "127.0.0.1", port)
        source.open()
        with pytest.raises(LabError, match="is no DataStream"):
            listen(source, lambda heard: False, 5.0)
        source.close()
