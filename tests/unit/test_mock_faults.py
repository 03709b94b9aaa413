"""The faults of the mock devices are those asked for, the same ones for the same seed."""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from evaluation.sources.cgstream import Framer, Kind, pack_object, pack_packet, pack_types
from mocks import faults, scene
from tests.unit.mock_process import ROOT, mock


def asked_for(*options: str) -> faults.Faults:
    parser = argparse.ArgumentParser()
    faults.add_arguments(parser)
    return faults.from_options(parser.parse_args(options))


def test_options_become_faults():
    wanted = asked_for("--drop", "0.1", "--stall", "2", "1", "--disconnect-at", "5", "--disconnect-at", "3")
    assert wanted == faults.Faults(drop=0.1, stall=(2.0, 1.0), disconnect_at=(3.0, 5.0))
    assert asked_for() == faults.Faults()


def test_bytes_are_damaged_at_the_rate_asked_for_and_alike_for_one_seed():
    data = bytes(range(256)) * 400
    damaged = [faults.Injector(faults.Faults(corrupt=0.01, seed=seed)).corrupted(data) for seed in (1, 1, 2)]
    assert damaged[0] == damaged[1] != damaged[2]
    injector = faults.Injector(faults.Faults(corrupt=0.01))
    out = injector.corrupted(data)
    wrong = np.count_nonzero(np.frombuffer(out, np.uint8) != np.frombuffer(data, np.uint8))
    assert wrong == injector.damaged_bytes == pytest.approx(1024, rel=0.15)
    assert faults.Injector(faults.Faults()).corrupted(data) is data


def test_frames_are_dropped_at_the_rate_asked_for():
    injector = faults.Injector(faults.Faults(drop=0.05, seed=3))
    lost = sum(injector.drops() for _ in range(10_000))
    assert lost == injector.dropped == pytest.approx(500, rel=0.2)


def test_the_line_breaks_once_at_each_instant():
    injector = faults.Injector(faults.Faults(disconnect_at=(1.0, 2.0)))
    assert [injector.breaks(at) for at in (0.5, 1.0, 1.5, 2.5, 3.0)] == [False, True, False, True, False]


def test_drift_and_stalls_move_the_frames():
    fast = faults.Pace(1000.0, faults.Faults(drift_ppm=100.0))
    assert fast.due(10_000) == pytest.approx(10.0 / (1 + 1e-4), abs=1e-9)
    stalled = faults.Pace(10.0, faults.Faults(stall=(1.0, 0.5)))
    assert [stalled.due(k) for k in (9, 10, 14, 15)] == pytest.approx([0.9, 1.5, 1.5, 1.5])
    start = time.monotonic()
    soon = faults.Pace(100.0, faults.Faults(jitter_ms=5.0))
    soon.wait(5)
    assert time.monotonic() - start >= 0.05


def test_a_client_that_asks_frame_by_frame_is_served_too():
    with mock("vicon_server") as port, socket.create_connection(("127.0.0.1", port)) as line:
        line.settimeout(10)
        framer, packets = Framer(), []
        line.sendall(pack_packet([pack_types([Kind.FRAME_INFO, Kind.CONTENTS])]))
        line.sendall(pack_packet([pack_object(Kind.REQUEST_FRAME, b"\0")]))
        while len(packets) < 4:
            packets += framer.feed(line.recv(65536))
            if len(packets) in (2, 3):
                line.sendall(pack_packet([pack_object(Kind.REQUEST_NEXT)]))
        line.settimeout(0.2)
        with pytest.raises(TimeoutError):
            line.recv(1)
    kinds = [[kind for kind, _ in packet] for packet in packets[1:]]
    assert kinds == [[Kind.CONTENTS, Kind.FRAME_INFO]] * 3


@pytest.mark.parametrize("module", ["vicon_server", "qualisys_server"])
def test_every_mock_says_what_it_can_do(module):
    text = subprocess.run(
        [sys.executable, "-m", f"mocks.{module}", "--help"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for option in ("--drop", "--corrupt", "--jitter", "--drift-ppm", "--stall", "--disconnect-at", "--port"):
        assert option in text


def test_the_scene_states_the_load_on_the_plate():
    content = scene.synthetic()
    assert content.positions.shape == (len(content), 13, 3)
    assert content.loads.shape == (len(content), 5, 6)
    assert content.loads[..., 2].max() > 600
    standing = content.loads[420, 0]
    centre = np.array([-standing[4], standing[3]]) / standing[2]
    np.testing.assert_allclose(centre, content.centres[420, 0, :2], atol=1e-9)
