"""A Qualisys Track Manager as the network sees it: the real-time protocol with markers and one force plate.

    python -m mocks.qualisys_server --port 22223 --stall 5 2

It prints its address as one line of JSON, serves on the loopback address only, and starts its clock when the
first client asks for frames. Layout: QTM Real-time Server Protocol Documentation, Qualisys AB.
"""

from __future__ import annotations

import argparse
import socket
import struct
import threading
from xml.sax.saxutils import escape

import numpy as np

from mocks import faults, scene, serving

ERROR, COMMAND, XML, DATA, NO_MORE, EVENT = 0, 1, 2, 3, 4, 6
COMPONENT_3D, COMPONENT_FORCE = 1, 4
CONNECTED, SETTINGS_CHANGED = 1, 11
OCCLUDED = np.frombuffer(b"\xff" * 12, "<f4")
LONGEST_COMMAND = 4096


def packet(kind: int, body: bytes) -> bytes:
    """One packet."""
    return struct.pack("<II", 8 + len(body), kind) + body


def point(place_m: np.ndarray) -> str:
    """A point in millimetres."""
    return "".join(f"<{axis}>{1e3 * x:.6f}</{axis}>" for axis, x in zip("XYZ", place_m, strict=True))


def parameters(content: scene.Scene, labels: tuple[str, ...]) -> bytes:
    """The settings of a measurement."""
    half = np.array(scene.PLATE_SIZE_M) / 2
    # Corners in the order of the C3D standard: plus-plus, minus-plus, minus-minus, plus-minus of the plate.
    signs = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    places = content.plate_origin + (signs * [*half, 0]) @ scene.PLATE_ROTATION.T
    corners = "".join(f"<Corner{k}>{point(place)}</Corner{k}>" for k, place in enumerate(places, 1))
    names = "".join(f"<Label><Name>{escape(name)}</Name><RGBColor>0</RGBColor></Label>" for name in labels)
    return (
        "<QTM_Parameters_Ver_1.25>"
        f"<General><Frequency>{content.rate_hz:g}</Frequency></General>"
        f"<The_3D><AxisUpwards>+Z</AxisUpwards><Labels>{len(labels)}</Labels>{names}</The_3D>"
        "<Force><Unit_Length>mm</Unit_Length><Unit_Force>N</Unit_Force><Plate><Plate_ID>1</Plate_ID>"
        f"<Frequency>{content.rate_hz * content.samples:g}</Frequency><Type>AMTI</Type><Name>Plate 1</Name>"
        f"<Length>{1e3 * scene.PLATE_SIZE_M[0]:g}</Length><Width>{1e3 * scene.PLATE_SIZE_M[1]:g}</Width>"
        f"<Location>{corners}</Location></Plate></Force>"
        "</QTM_Parameters_Ver_1.25>"
    ).encode()


def frame(content: scene.Scene, number: int, markers: int, components: list[str]) -> bytes:
    """One data packet."""
    at = number % len(content)
    parts = []
    if "3d" in components:
        places = (1e3 * content.positions[at, :markers]).astype("<f4")
        lost = ~np.isfinite(places).all(axis=1)
        raw = places.view("<u4")
        raw[lost] = 0xFFFFFFFF
        parts.append((COMPONENT_3D, struct.pack("<Ihh", markers, 0, 0) + raw.tobytes()))
    if "force" in components:
        count = content.samples
        values = np.hstack([content.loads[at], 1e3 * content.centres[at]]).astype("<f4")
        head = struct.pack("<iiii", 1, 1, count, number * count)
        parts.append((COMPONENT_FORCE, head + values.tobytes()))
    body = b"".join(packet(kind, part) for kind, part in parts)
    time_us = round(1e6 * number / content.rate_hz)
    return packet(DATA, struct.pack("<qII", time_us, number, len(parts)) + body)


class Server:
    """The system behind all connections."""

    def __init__(self, content: scene.Scene, wrong: faults.Faults, options: argparse.Namespace) -> None:
        self.content, self.wrong, self.options = content, wrong, options
        self.clock = serving.Clock()
        self.injector = faults.Injector(wrong)
        self.sent = 0

    def handle(self, line: socket.socket) -> None:
        """Serve one client."""
        Client(self, line).serve()
        serving.say(
            {
                "sent": self.sent,
                "dropped": self.injector.dropped,
                "damaged_bytes": self.injector.damaged_bytes,
            }
        )

    def labels(self, elapsed_s: float) -> tuple[str, ...]:
        """Markers at some time after the start."""
        change = self.options.change_markers_at
        return self.content.labels[:-1] if change is not None and elapsed_s >= change else self.content.labels


class Client:
    """One client's connection: its commands, and the stream it asked for."""

    def __init__(self, server: Server, line: socket.socket) -> None:
        self.server, self.line = server, line
        self.lock = threading.Lock()
        self.stop = threading.Event()
        self.pace: faults.Pace | None = None

    def serve(self) -> None:
        """Answer commands until the client leaves."""
        self.answer(COMMAND, b"QTM RT Interface connected\0")
        buffer = b""
        try:
            while data := self.line.recv(4096):
                buffer += data
                while len(buffer) >= 8 and len(buffer) >= (size := struct.unpack_from("<I", buffer)[0]):
                    if not 8 <= size <= LONGEST_COMMAND:
                        return
                    self.obey(buffer[8:size].rstrip(b"\0").decode("ascii", "replace"))
                    buffer = buffer[size:]
        finally:
            self.stop.set()

    def answer(self, kind: int, body: bytes) -> None:
        """Send one packet, never in the middle of another."""
        with self.lock:
            self.line.sendall(packet(kind, body))

    def obey(self, command: str) -> None:
        """Carry out one command."""
        words = command.lower().split()
        elapsed = self.pace.elapsed() if self.pace else 0.0
        if words[:1] == ["version"]:
            self.answer(COMMAND, f"Version set to {words[1]}".encode() + b"\0")
        elif words == ["qtmversion"]:
            self.answer(COMMAND, b"QTM Version is 2024.1 (build 1)\0")
        elif words == ["byteorder"]:
            self.answer(COMMAND, b"Byte order is little endian\0")
        elif words == ["getstate"]:
            self.answer(EVENT, bytes([CONNECTED]))
        elif words[:1] == ["getparameters"]:
            self.answer(XML, parameters(self.server.content, self.server.labels(elapsed)) + b"\0")
        elif words == ["streamframes", "stop"]:
            self.stop.set()
        elif words[:2] == ["streamframes", "allframes"]:
            self.stop = threading.Event()
            threading.Thread(target=self.stream, args=(words[2:], self.stop), daemon=True).start()
        else:
            self.answer(ERROR, b"Parse error\0")

    def stream(self, components: list[str], stop: threading.Event) -> None:
        """Send frames until told to stop."""
        try:
            self._stream(components, stop)
        except OSError:
            stop.set()

    def _stream(self, components: list[str], stop: threading.Event) -> None:
        server, content = self.server, self.server.content
        fresh = not server.sent
        self.pace = pace = faults.Pace(
            content.rate_hz * server.options.speed, server.wrong, server.clock.start()
        )
        number = 0 if fresh else pace.current() + 1
        labels = server.labels(pace.elapsed())
        while not stop.is_set():
            pace.wait(number)
            if server.injector.breaks(pace.elapsed()) or (server.options.once and number >= len(content)):
                self.line.shutdown(socket.SHUT_RDWR)
                return
            if labels != server.labels(pace.elapsed()):
                labels = server.labels(pace.elapsed())
                self.answer(EVENT, bytes([SETTINGS_CHANGED]))
            if not server.injector.drops():
                message = frame(content, number, len(labels), components)
                with self.lock:
                    self.line.sendall(server.injector.corrupted(message))
                server.sent += 1
            number += 1


def main() -> None:
    """Serve from the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--port", type=int, default=0, help="port on the loopback address; 0 for any")
    parser.add_argument(
        "--change-markers-at", type=float, metavar="S", help="lose the last marker at this time"
    )
    scene.add_arguments(parser)
    faults.add_arguments(parser)
    options = parser.parse_args()
    server = Server(scene.from_options(options), faults.from_options(options), options)
    serving.serve(options.port, server.handle)


if __name__ == "__main__":
    main()
