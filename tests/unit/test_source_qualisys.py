"""The Qualisys source against the mock of its server, damaged packets, and settings written by hand."""

from __future__ import annotations

import contextlib
import importlib
import socket
import struct
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.sources import qtm_gate, qtm_settings
from evaluation.sources.qtm_gate import Gate
from evaluation.sources.qualisys import QualisysSource
from evaluation.sources.reconnecting import Reconnecting
from evaluation.sources.stream import LabError, ground_load
from hilbrace.errors import InputError
from mocks import qualisys_server, scene
from tests.unit.mock_process import listen, mock

pytest.importorskip("qtm_rt")

COMMAND = bytes.fromhex("0b000000 01000000 4f6b00")
"""A packet of type 1 (command): "Ok"."""

DATA = bytes.fromhex(
    "34000000 03000000 8813000000000000 01000000 01000000"  # 52 bytes, data: 5000 us, frame 1, one component
    "1c000000 01000000 01000000 0000 0000 0000803f 00000040 00004040"  # 28 bytes of type 1: one at 1, 2, 3
)

SETTINGS = b"""<QTM_Parameters_Ver_1.25><General><Frequency>200</Frequency></General>
<The_3D><AxisUpwards>+Z</AxisUpwards><Labels>2</Labels>
<Label><Name>LTH1</Name></Label><Label><Name>LTH2</Name></Label></The_3D>
<Force><Unit_Length>mm</Unit_Length><Unit_Force>N</Unit_Force><Plate><Plate_ID>4</Plate_ID>
<Frequency>1000</Frequency><Name>Left</Name><Location>
<Corner1><X>600</X><Y>0</Y><Z>0</Z></Corner1><Corner2><X>0</X><Y>0</Y><Z>0</Z></Corner2>
<Corner3><X>0</X><Y>400</Y><Z>0</Z></Corner3><Corner4><X>600</X><Y>400</Y><Z>0</Z></Corner4>
</Location></Plate></Force></QTM_Parameters_Ver_1.25>"""


@pytest.fixture(scope="module")
def content():
    return scene.synthetic()


def test_settings_by_hand():
    settings = qtm_settings.read_settings(SETTINGS, "here")
    assert (settings.labels, settings.rate_hz, settings.up) == (("LTH1", "LTH2"), 200.0, "z")
    (plate,) = settings.plates
    assert (plate.number, plate.info.name, plate.info.rate_hz) == (4, "Left", 1000.0)
    np.testing.assert_allclose(plate.info.rotation, np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_allclose(plate.info.origin, [0.3, 0.2, 0.0])
    # 700 N straight down on a point 0.1 m before the plate's middle push the subject straight up there.
    load = ground_load(plate.info, np.array([[0.0, 0.0, 700.0, 0.0, -70.0, 0.0]]))
    np.testing.assert_allclose(load[0], [0, 0, 700, 0.2 * 700, -0.4 * 700, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "error", "told"),
    [
        (b"+Z", b"-X", InputError, "vertical axis"),
        (b"LTH2", b"LTH1", InputError, "two trajectories"),
        (b"<Frequency>200", b"<Frequency>x", LabError, "General/Frequency"),
        (b"<Frequency>200", b"<Frequency>0", LabError, "not positive"),
        (b"<X>600</X>", b"<X>0</X>", InputError, "no surface"),
        (b"<X>600</X>", b"<X>nan</X>", LabError, "nan"),
        (b"</General>", b"", LabError, "no XML"),
        (b"<QTM", b'<!DOCTYPE a [<!ENTITY b "c">]><QTM', LabError, "entities"),
    ],
)
def test_unusable_settings_are_refused_by_name(old, new, error, told):
    with pytest.raises(error, match=told):
        qtm_settings.read_settings(SETTINGS.replace(old, new), "here")


def test_packets_by_hand_pass_the_gate_in_any_pieces():
    gate = Gate()
    found = [packet for byte in COMMAND + DATA for packet in gate.feed(bytes([byte]))]
    assert found == [COMMAND, DATA]
    unknown_event = struct.pack("<II", 9, 6) + b"\x63"
    file_packet = struct.pack("<II", 10, 5) + b"ab"
    assert Gate().feed(unknown_event + file_packet + COMMAND) == [COMMAND]


@pytest.mark.parametrize(
    "packet",
    [
        struct.pack("<II", 0, 3),
        struct.pack("<II", qtm_gate.MOST_PACKET_BYTES + 1, 3),
        struct.pack("<II", 8, 77),
        struct.pack("<II", 12, 3) + bytes(4),
        DATA[:20] + b"\x02" + DATA[21:],
        DATA[:24] + b"\x00" + DATA[25:],
        DATA[:28] + b"\xff" + DATA[29:],
        DATA[:20] + b"\xff\xff\xff\xff" + DATA[24:],
    ],
)
def test_lengths_that_contradict_each_other_stop_at_the_gate(packet):
    with pytest.raises(LabError):
        Gate().feed(packet)


@given(st.binary(max_size=300))
def test_any_bytes_pass_or_stop_at_the_gate(data):
    gate = Gate()
    with contextlib.suppress(LabError):
        for packet in gate.feed(data):
            assert struct.unpack_from("<I", packet)[0] == len(packet)


def test_markers_gaps_and_loads_arrive_as_they_were(content):
    with mock("qualisys_server", "--speed", "4") as port:
        source = Reconnecting(QualisysSource("qtm", "127.0.0.1", port))
        info = source.open()
        heard = listen(source, lambda heard: len(heard.frames) >= 600)
        source.close()
    assert heard.events("gap", "fault", "disconnected") == []
    assert (info.labels, info.rate_hz, info.up) == (content.labels, 200.0, "z")
    numbers = [frame.number for frame in heard.frames]
    assert numbers == list(range(len(numbers)))
    places = np.stack([frame.positions for frame in heard.frames[:600]])
    np.testing.assert_allclose(places, content.positions[:600], atol=1e-6)
    assert heard.frames[10].device_time_s == pytest.approx(0.05)
    load = np.concatenate([ground_load(info.plates[0], block.values) for block in heard.samples[:600]])
    force = -content.loads[:600].reshape(-1, 6)[:, :3] @ scene.PLATE_ROTATION.T
    np.testing.assert_allclose(load[:, :3], force, atol=1e-3)
    assert heard.samples[3].number == 15
    assert heard.samples[3].device_time_s == pytest.approx(0.015)


def test_dropped_frames_and_broken_lines_are_counted_from_the_devices_counter():
    options = ["--drop", "0.05", "--disconnect-at", "0.5", "--seed", "3"]
    with mock("qualisys_server", *options) as port:
        source = Reconnecting(QualisysSource("qtm", "127.0.0.1", port))
        source.open()
        heard = listen(source, lambda heard: len(heard.events("connected")) == 2 and len(heard.frames) > 200)
        source.close()
    numbers = [frame.number for frame in heard.frames]
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert sum(event.lost for event in heard.events("gap") if not event.plate) == missing > 90


def test_a_marker_set_that_changes_is_described_anew():
    with mock("qualisys_server", "--change-markers-at", "0.3") as port:
        source = Reconnecting(QualisysSource("qtm", "127.0.0.1", port))
        first = source.open()
        heard = listen(source, lambda heard: bool(heard.infos) and len(heard.frames) > 90)
        source.close()
    assert heard.infos[-1].labels == first.labels[:-1]
    assert heard.events("gap", "fault") == []
    labels = first.labels
    for item in heard.items:
        labels = getattr(item, "labels", labels)
        assert len(getattr(item, "positions", labels)) == len(labels)


@pytest.mark.parametrize(
    ("greeting", "told"), [(b"", "does not answer"), (b"HTTP/1.1 400 Bad Request\r\n\r\n", "not QTM's")]
)
def test_other_servers_are_named_within_bounded_time(greeting, told):
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer():
            line, _ = listener.accept()
            with line:
                line.sendall(greeting)
                with contextlib.suppress(OSError):
                    while line.recv(4096):
                        pass

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        start = time.monotonic()
        with pytest.raises(LabError, match=told):
            QualisysSource("qtm", "127.0.0.1", listener.getsockname()[1], patience_s=0.3).open()
        assert time.monotonic() - start < 3
        thread.join(5)


def test_damage_on_the_line_ends_in_a_named_error_and_a_new_connection():
    with mock("qualisys_server", "--corrupt", "0.001", "--seed", "2") as port:
        source = Reconnecting(QualisysSource("qtm", "127.0.0.1", port), back_off_s=(0.05,))
        source.open()
        heard = listen(source, lambda heard: len(heard.events("connected")) >= 3)
        source.close()
    assert heard.events("disconnected")[0].text.startswith("the connection to QTM is lost: ")


def test_without_the_vendors_package_the_error_says_what_to_install(monkeypatch):
    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(InputError, match="not installed") as caught:
        QualisysSource("qtm", "127.0.0.1", 1).open()
    assert "hilbrace[qualisys]" in caught.value.hint


def test_the_mock_states_its_settings_as_they_are_read(content):
    settings = qtm_settings.read_settings(qualisys_server.parameters(content, content.labels), "mock")
    np.testing.assert_allclose(settings.plates[0].info.rotation, scene.PLATE_ROTATION)
    np.testing.assert_allclose(settings.plates[0].info.origin, content.plate_origin, atol=1e-9)
