"""Time to decode one frame of 13 markers and five samples of a plate; 0.3 ms are allowed."""

from __future__ import annotations

import argparse

import qtm_rt

from evaluation.sources import qtm_settings, vicon
from evaluation.sources.cgstream import Framer
from evaluation.sources.qtm_gate import Gate
from evaluation.sources.qualisys import QualisysSource
from mocks import faults, qualisys_server, scene, vicon_server

FRAMES = 400


def test_vicon(benchmark):
    content = scene.synthetic()
    options = argparse.Namespace(once=True, speed=1.0, change_markers_at=None, patient=False)
    server = vicon_server.Server(content, faults.Faults(), options)
    client = argparse.Namespace(wants=set(vicon.WANTED), pings=[])
    known = set(client.wants), content.labels
    first = server._frame(client, 0, content.labels, None)
    frames = [server._frame(client, k, content.labels, known) for k in range(1, FRAMES)]
    source, framer = vicon.ViconSource("vicon", "localhost"), Framer()
    source._items(framer.feed(first)[0], 0)

    def once() -> None:
        for frame in frames:
            for packet in framer.feed(frame):
                source._items(packet, 0)

    benchmark.pedantic(once, rounds=10, warmup_rounds=1)


def test_qualisys(benchmark):
    content = scene.synthetic()
    source, gate = QualisysSource("qtm", "localhost"), Gate()
    source._settings = qtm_settings.read_settings(qualisys_server.parameters(content, content.labels), "mock")
    frames = [qualisys_server.frame(content, k, 13, ["3d", "force"]) for k in range(FRAMES)]

    def once() -> None:
        for frame in frames:
            for packet in gate.feed(frame):
                source._frame(qtm_rt.QRTPacket(packet[8:]), 0)

    benchmark.pedantic(once, rounds=10, warmup_rounds=1)
