"""A Vicon system as the network sees it: markers, segments and a force plate by the DataStream protocol.

    python -m mocks.vicon_server --port 8801 --drop 0.01
    python -m mocks.vicon_server standing.c3d trial.c3d --once

It prints its address as one line of JSON, serves on the loopback address only, and starts its clock when the
first client asks for frames.
"""

from __future__ import annotations

import argparse
import socket
import struct
import sys
import threading

import numpy as np

from evaluation.sources.cgstream import (
    NO_PARENT,
    TICKS_PER_S,
    Framer,
    Kind,
    pack_object,
    pack_packet,
    pack_types,
    read_types,
)
from mocks import faults, scene, serving

SUBJECT = "Limb"
"""Name of the subject and of its first segment; some clients know a body only where both agree."""

DEVICE, FORCE_CHANNEL, MOMENT_CHANNEL, CENTRE_CHANNEL = 1, 0, 1, 2
PLATE_NAME = "Plate 1"
SEGMENT_TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
"""Orientation of the segment, constant and about z."""

Objects = dict[int, list[bytes]]


def word(*values: int) -> bytes:
    """Unsigned 32-bit numbers."""
    return struct.pack(f"<{len(values)}I", *values)


def text(content: str) -> bytes:
    """A string."""
    raw = content.encode()
    return word(len(raw)) + raw


def static_objects(content: scene.Scene, labels: tuple[str, ...]) -> Objects:
    """What changes rarely: the stream, the subject, the plate and its channels."""
    ticks = round(TICKS_PER_S / content.rate_hz)
    segment = word(NO_PARENT, 0) + struct.pack("<6f", *[0.0] * 6) + text(SUBJECT)
    markers = b"".join(word(number) + text(label) for number, label in enumerate(labels))
    attached = b"".join(word(number, 0) for number in range(len(labels)))
    subject = word(0) + text(SUBJECT) + word(1) + segment
    subject += word(len(labels)) + markers + word(len(labels)) + attached
    channels = [
        (FORCE_CHANNEL, "Force", ("Fx", "Fy", "Fz"), "N"),
        (MOMENT_CHANNEL, "Moment", ("Mx", "My", "Mz"), "Nm"),
        (CENTRE_CHANNEL, "CoP", ("Cx", "Cy", "Cz"), "m"),
    ]
    half = 500.0 * np.array(scene.PLATE_SIZE_M)
    place = struct.pack("<12f", *(1e3 * content.plate_origin), *scene.PLATE_ROTATION.ravel())
    bounds = struct.pack("<6f", -half[0], -half[1], 0.0, half[0], half[1], 0.0)
    return {
        Kind.STREAM_INFO: [struct.pack("<q", ticks)],
        Kind.APPLICATION_INFO: [b"\0"],
        Kind.SUBJECT_INFO: [subject],
        Kind.DEVICE_INFO: [word(DEVICE) + struct.pack("<Q", ticks) + text(PLATE_NAME)],
        Kind.DEVICE_START: [word(DEVICE) + struct.pack("<Q", 0)],
        Kind.CHANNEL_INFO: [
            word(DEVICE, number) + text(name) + word(3) + b"".join(text(part) for part in parts)
            for number, name, parts, _ in channels
        ],
        Kind.CHANNEL_UNITS: [
            word(DEVICE, number) + text(unit) + text(name) for number, name, _, unit in channels
        ],
        Kind.FORCE_PLATE_INFO: [
            word(DEVICE) + place + bounds + struct.pack("<12f", 0, 0, 0, *np.eye(3).ravel())
        ],
    }


def dynamic_objects(content: scene.Scene, number: int, markers: int) -> Objects:
    """What is new in every frame."""
    at = number % len(content)
    places = 1e3 * content.positions[at, :markers]
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
    labelled = b"".join(
        word(0, k) + struct.pack("<13d", 7.0, *places[k], *[0.0] * 9) + word(k + 1) for k in seen
    )
    root = places[seen].mean(axis=0) if len(seen) else np.zeros(3)
    segments = word(0, 1, 0) + struct.pack("<12d", *root, *SEGMENT_TURN.ravel())
    objects = {
        Kind.FRAME_INFO: [word(number)],
        Kind.HARDWARE_FRAME: [word(number)],
        Kind.LATENCY_INFO: [word(1) + text("Data Collected") + struct.pack("<d", 0.003)],
        Kind.FRAME_RATE: [word(1) + text("System") + struct.pack("<d", content.rate_hz)],
        Kind.LABELLED_MARKERS: [word(len(seen)) + labelled],
        Kind.UNLABELLED_MARKERS: [word(0)],
        Kind.GLOBAL_SEGMENTS: [segments],
        Kind.LOCAL_SEGMENTS: [segments],
    }
    load = content.loads[at]
    for kind, channel, values in (
        (Kind.FORCE, FORCE_CHANNEL, load[:, :3]),
        (Kind.MOMENT, MOMENT_CHANNEL, load[:, 3:]),
        (Kind.CENTRE_OF_PRESSURE, CENTRE_CHANNEL, content.centres[at]),
    ):
        samples = values.T.astype("<f4").tobytes()
        objects[kind] = [word(number, DEVICE, channel, values.size) + samples]
    return objects


class Client:
    """One client's connection: what it wants, and whether it is pushed to or asks."""

    def __init__(self, line: socket.socket) -> None:
        self.line = line
        self.wants: set[int] = set()
        self.push = False
        self.asked = threading.Semaphore(0)
        self.gone = False
        self.pings: list[bytes] = []

    def listen(self) -> None:
        """Take requests until the client leaves."""
        framer = Framer()
        while True:
            try:
                data = self.line.recv(65536)
            except OSError:
                data = b""
            if not data:
                self.gone = True
                self.asked.release()
                return
            for packet in framer.feed(data):
                for kind, payload in packet:
                    self._take(kind, payload)

    def _take(self, kind: int, payload: bytes) -> None:
        if kind == Kind.OBJECT_TYPES:
            self.wants = read_types(payload)
        elif kind == Kind.REQUEST_FRAME:
            self.push = payload[:1] != b"\0"
            self.asked.release()
        elif kind == Kind.REQUEST_NEXT:
            self.asked.release()
        elif kind == Kind.PING:
            self.pings.append(payload)


class Server:
    """The system behind all connections."""

    def __init__(self, content: scene.Scene, wrong: faults.Faults, options: argparse.Namespace) -> None:
        self.content, self.wrong, self.options = content, wrong, options
        self.clock = serving.Clock()
        self.injector = faults.Injector(wrong)
        self.sent = 0

    def handle(self, line: socket.socket) -> None:
        """Serve one client."""
        available = {*static_objects(self.content, self.content.labels), Kind.CONTENTS}
        available |= set(dynamic_objects(self.content, 0, len(self.content.labels)))
        line.sendall(pack_packet([pack_types(available)]))
        client = Client(line)
        threading.Thread(target=client.listen, daemon=True).start()
        client.asked.acquire()
        fresh = not self.sent
        pace = faults.Pace(self.content.rate_hz * self.options.speed, self.wrong, self.clock.start())
        self._stream(client, pace, 0 if fresh else pace.current() + 1)
        serving.say(
            {
                "sent": self.sent,
                "dropped": self.injector.dropped,
                "damaged_bytes": self.injector.damaged_bytes,
            }
        )

    def _stream(self, client: Client, pace: faults.Pace, number: int) -> None:
        known: tuple[set[int], tuple[str, ...]] | None = None
        last = len(self.content) if self.options.once else None
        asks = False
        while not client.gone and (last is None or number < last):
            if asks and not client.push:
                client.asked.acquire()
            asks = True
            if client.gone:
                return
            pace.wait(number)
            if self.injector.breaks(pace.elapsed()):
                return
            labels = self._labels(pace.elapsed())
            if not self.injector.drops():
                message = self._frame(client, number, labels, known)
                client.line.sendall(self.injector.corrupted(message))
                known = set(client.wants), labels
                self.sent += 1
                if self.options.patient:
                    sys.stdin.readline()
            number = number + 1 if client.push else max(number + 1, pace.current())

    def _labels(self, elapsed_s: float) -> tuple[str, ...]:
        change = self.options.change_markers_at
        return self.content.labels[:-1] if change is not None and elapsed_s >= change else self.content.labels

    def _frame(
        self,
        client: Client,
        number: int,
        labels: tuple[str, ...],
        known: tuple[set[int], tuple[str, ...]] | None,
    ) -> bytes:
        """The table of contents first, then what the client wants and does not know yet."""
        static = static_objects(self.content, labels)
        objects = {**static, **dynamic_objects(self.content, number, len(labels))}
        send = {kind: payloads for kind, payloads in sorted(objects.items()) if kind in client.wants}
        same = sorted(set(send) & set(static)) if known == (client.wants, labels) else []
        counts = b"".join(word(kind, len(payloads)) for kind, payloads in send.items())
        contents = word(len(send)) + counts + word(len(same), *same)
        # One static object always comes along: it makes the vendor's client copy the others.
        body = [
            pack_object(kind, payload)
            for kind, payloads in send.items()
            if kind not in same or kind == Kind.STREAM_INFO
            for payload in payloads
        ]
        pings = [pack_object(Kind.PING, ping) for ping in client.pings]
        client.pings.clear()
        return pack_packet([pack_object(Kind.CONTENTS, contents), *body, *pings])


def main() -> None:
    """Serve from the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--port", type=int, default=0, help="port on the loopback address; 0 for any")
    parser.add_argument(
        "--change-markers-at", type=float, metavar="S", help="lose the last marker at this time"
    )
    parser.add_argument("--patient", action="store_true",
                        help="wait for a line on standard input after each frame, for clients such as the "
                        "vendor's SDK that keep one frame only and lose some on a busy computer")  # fmt: skip
    scene.add_arguments(parser)
    faults.add_arguments(parser)
    options = parser.parse_args()
    server = Server(scene.from_options(options), faults.from_options(options), options)
    serving.serve(options.port, server.handle)


if __name__ == "__main__":
    main()
