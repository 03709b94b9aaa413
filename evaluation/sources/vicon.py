"""Vicon systems by their own network stream: labelled markers and force plates, without Vicon's software.

Nexus, Tracker, Shogun and Evoke serve a DataStream on port 801. The source asks the server to push every
frame, so that nothing is lost on a busy computer: what is not read at once waits in the connection. Forces
and moments arrive in the plate's axes as loads on the plate, moments about the plate's origin; their sign is
turned in `PlateInfo.calibration`.
"""

from __future__ import annotations

import math
import socket
import time
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Integer

from evaluation.sources import cgstream
from evaluation.sources.cgstream import Block, Kind, Packet
from evaluation.sources.connection import connect, receive, send
from evaluation.sources.stream import (
    Item,
    LabError,
    MarkerFrame,
    PlateInfo,
    PlateSamples,
    SourceEvent,
    SourceInfo,
)
from hilbrace.units import MM_PER_M

Array = np.ndarray

PORT = 801
CONNECT_S = 3.0
"""Longest wait for the server's answer, and again for its first frame."""

LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
LOAD_UNITS = ("N", "N", "N", "N*m", "N*m", "N*m")

STATIC = {
    Kind.STREAM_INFO,
    Kind.APPLICATION_INFO,
    Kind.SUBJECT_INFO,
    Kind.DEVICE_INFO,
    Kind.DEVICE_START,
    Kind.FORCE_PLATE_INFO,
}
"""Objects that the server leaves out while they do not change."""

WANTED = {*STATIC, Kind.CONTENTS, Kind.FRAME_INFO, Kind.LABELLED_MARKERS, Kind.FORCE, Kind.MOMENT}

LONGEST_NONSENSE = 2**20
"""Bytes without a single packet after which the server is not taken for a DataStream."""


@dataclass
class _Scene:
    """What the static objects said last; `missing` if one of them was lost on the way."""

    objects: dict[int, list[bytes]] = field(default_factory=dict)
    samples: dict[int, int] = field(default_factory=dict)
    period_s: float = math.nan
    up: str = "z"
    labels: tuple[str, ...] = ()
    keys: Integer[Array, " marker"] = field(default_factory=lambda: np.zeros(0, np.uint64))
    columns: Integer[Array, " marker"] = field(default_factory=lambda: np.zeros(0, int))
    devices: dict[int, tuple[float, str]] = field(default_factory=dict)
    starts: dict[int, float] = field(default_factory=dict)
    plates: dict[int, cgstream.Plate] = field(default_factory=dict)
    missing: bool = False

    def update(self, packet: Packet) -> bool:
        """Take over what a frame says anew; true if it was news."""
        present, unchanged = STATIC, set()
        new: dict[int, list[bytes]] = {}
        for kind, payload in packet:
            if kind == Kind.CONTENTS:
                present, unchanged = cgstream.read_contents(payload)
            elif kind in STATIC:
                new.setdefault(kind, []).append(payload)
        kept = {kind: old for kind, old in self.objects.items() if kind in unchanged and kind in present}
        objects = {**kept, **new}
        self.missing = bool((unchanged & present & STATIC) - objects.keys())
        if objects == self.objects:
            return False
        self._interpret(objects)
        self.objects = objects
        return True

    def count_samples(self, blocks: list[Block]) -> bool:
        """Learn how many samples a device sends at once; true if it was news."""
        seen = {block.device: len(block.values) for block in blocks if len(block.values)}
        if all(self.samples.get(device) == count for device, count in seen.items()):
            return False
        self.samples.update(seen)
        return True

    def positions(self, payload: bytes) -> Float[Array, "marker 3"]:
        """Markers in the order of the labels [m]; NaN where occluded."""
        out = np.full((len(self.labels), 3), np.nan)
        keys, places = cgstream.read_labelled(payload)
        if not len(self.keys) or not len(keys):
            return out
        found = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        known = self.keys[found] == keys
        out[self.columns[found[known]]] = places[known] / MM_PER_M
        return out

    def _interpret(self, objects: dict[int, list[bytes]]) -> None:
        for payload in objects.get(Kind.STREAM_INFO, []):
            self.period_s = cgstream.read_period(payload)
        for payload in objects.get(Kind.APPLICATION_INFO, []):
            self.up = "y" if payload[:1] == b"\x01" else "z"
        devices = [cgstream.read_device(payload) for payload in objects.get(Kind.DEVICE_INFO, [])]
        plates = [cgstream.read_plate(payload) for payload in objects.get(Kind.FORCE_PLATE_INFO, [])]
        self.devices = {number: (period, name) for number, period, name in devices}
        self.starts = dict(
            cgstream.read_device_start(payload) for payload in objects.get(Kind.DEVICE_START, [])
        )
        self.plates = {plate.device: plate for plate in plates}
        self._name_markers([cgstream.read_subject(payload) for payload in objects.get(Kind.SUBJECT_INFO, [])])

    def _name_markers(self, subjects: list[cgstream.Subject]) -> None:
        prefixed = len(subjects) > 1
        markers = [(s, number, name) for s in subjects for number, name in s.markers.items()]
        self.labels = tuple(f"{s.name}:{name}" if prefixed else name for s, _, name in markers)
        numbers = np.array([(s.number, number) for s, number, _ in markers], np.uint64).reshape(-1, 2)
        keys = cgstream.marker_key(numbers[:, 0], numbers[:, 1])
        self.columns = np.argsort(keys)
        self.keys = keys[self.columns]


class ViconSource:
    """A DataStream server as a source.

    Args:
        name: Name of the source.
        host: Address of the computer that serves the stream.
        port: Its port.
        patience_s: Longest wait for an answer [s].
    """

    def __init__(self, name: str, host: str, port: int = PORT, patience_s: float = CONNECT_S) -> None:
        self._name, self._host, self._port, self._patience = name, host, port, patience_s
        self._socket: socket.socket | None = None
        self._framer = cgstream.Framer()
        self._scene = _Scene()
        self._reported = self._intact = 0
        self._waiting: list[Item] = []

    @property
    def name(self) -> str:
        """Name of the source."""
        return self._name

    @property
    def address(self) -> str:
        """Host and port, for messages."""
        return f"{self._host}:{self._port}"

    def open(self) -> SourceInfo:
        """Connect, ask for markers and plates, and wait for the first frame.

        Raises:
            LabError: Nobody answers, something else than a DataStream answers, or no frame comes.
        """
        self.close()
        self._framer, self._scene, self._waiting = cgstream.Framer(), _Scene(), []
        self._reported = self._intact = 0
        self._socket = connect(self._host, self._port, self._patience, "a DataStream server")
        try:
            self._shake_hands(time.monotonic() + self._patience)
            return self._first_frame(time.monotonic() + self._patience)
        except LabError:
            self.close()
            raise

    def read(self, timeout_s: float) -> list[Item]:
        """Frames and samples that have arrived.

        Args:
            timeout_s: Longest wait [s].

        Raises:
            LabError: The server closed the connection, or sends nonsense.
        """
        waiting, self._waiting = self._waiting, []
        if waiting:
            return waiting
        if self._scene.missing:
            raise LabError(
                "the description of the scene was lost",
                where=self.address,
                hint="connect again to get it anew",
            )
        deadline = time.monotonic() + timeout_s
        while True:
            left = deadline - time.monotonic()
            packets, now = self._receive(max(left, 0.0))
            items = [
                *self._damage(packets, now),
                *(item for packet in packets for item in self._items(packet, now)),
            ]
            if items or left <= 0:
                return items

    def close(self) -> None:
        """Leave the server."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _receive(self, timeout_s: float) -> tuple[list[Packet], int]:
        if self._socket is None:
            raise LabError("the source is not open", where=self.address, hint="call open first")
        data = receive(self._socket, timeout_s, f"the DataStream server {self.address}")
        return (self._framer.feed(data) if data else []), time.monotonic_ns()

    def _shake_hands(self, deadline: float) -> None:
        """The server lists what it has; the client answers with what it wants, and asks for every frame."""
        while (left := deadline - time.monotonic()) > 0:
            packets, _ = self._receive(left)
            listed = [payload for packet in packets for kind, payload in packet if kind == Kind.OBJECT_TYPES]
            if listed and self._socket is not None:
                wanted = WANTED & {*cgstream.read_types(listed[0]), Kind.CONTENTS}
                request = cgstream.pack_object(Kind.REQUEST_FRAME, b"\x01")
                message = cgstream.pack_packet([cgstream.pack_types(wanted)]) + cgstream.pack_packet(
                    [request]
                )
                send(self._socket, message, f"the DataStream server {self.address}")
                return
            if packets or self._framer.skipped:
                break
        raise LabError(
            "the answer is not a DataStream"
            if self._framer.skipped
            else "the server does not introduce itself",
            where=self.address,
            hint=f"check address and port (a DataStream is on port {PORT}) and that Nexus or Tracker runs",
        )

    def _first_frame(self, deadline: float) -> SourceInfo:
        items: list[Item] = []
        while (left := deadline - time.monotonic()) > 0:
            items += self.read(left)
            for index, item in enumerate(items):
                if isinstance(item, SourceInfo):
                    self._waiting = items[:index] + items[index + 1 :]
                    return item
        raise LabError(
            "the server sends no frames",
            where=self.address,
            hint="go live in Nexus or Tracker, or play a trial in a loop",
        )

    def _items(self, packet: Packet, now: int) -> list[Item]:
        try:
            return self._decode(packet, now)
        except LabError as fault:
            return [SourceEvent(self._name, "fault", now, math.nan, f"a packet was discarded: {fault.what}")]

    def _decode(self, packet: Packet, now: int) -> list[Item]:
        payloads = dict(packet)
        if Kind.FRAME_INFO not in payloads:
            return []
        news = self._scene.update(packet)
        forces = [cgstream.read_block(payload) for kind, payload in packet if kind == Kind.FORCE]
        moments = [cgstream.read_block(payload) for kind, payload in packet if kind == Kind.MOMENT]
        news = self._scene.count_samples(forces) or news
        items: list[Item] = [self._info()] if news and math.isfinite(self._scene.period_s) else []
        number = cgstream.Reader(payloads[Kind.FRAME_INFO], "the frame's number").word()
        moment_s = number * self._scene.period_s
        if Kind.LABELLED_MARKERS in payloads:
            positions = self._scene.positions(payloads[Kind.LABELLED_MARKERS])
            items.append(MarkerFrame(self._name, number, moment_s, now, positions))
        return items + [item for force in forces for item in self._samples(force, moments, now)]

    def _samples(self, force: Block, moments: list[Block], now: int) -> list[Item]:
        scene = self._scene
        if force.device not in scene.plates or force.device not in scene.devices or not len(force.values):
            return []
        count = len(force.values)
        matching = [m.values for m in moments if (m.device, m.number) == (force.device, force.number)]
        moment = matching[0] if matching and len(matching[0]) == count else np.full((count, 3), np.nan)
        block_s, name = scene.devices[force.device]
        start = scene.starts.get(force.device, 0.0) + force.number * block_s
        values = np.hstack([force.values, moment])
        return [PlateSamples(self._name, name, force.number * count, start, block_s / count, now, values)]

    def _info(self) -> SourceInfo:
        scene = self._scene
        plates = [
            _plate_info(name, scene.samples.get(number, 0) / block_s, scene.plates[number])
            for number, (block_s, name) in scene.devices.items()
            if number in scene.plates and block_s > 0
        ]
        up = "y" if scene.up == "y" else "z"
        device = f"Vicon DataStream at {self.address}"
        return SourceInfo(self._name, device, scene.labels, 1.0 / scene.period_s, up, tuple(plates))

    def _damage(self, packets: list[Packet], now: int) -> list[Item]:
        """Report bytes that belong to no packet; many of them without a packet are no DataStream."""
        skipped = self._framer.skipped
        new, self._reported = skipped - self._reported, skipped
        if packets:
            self._intact = skipped
        if skipped - self._intact > LONGEST_NONSENSE:
            raise LabError("what comes is no DataStream", where=self.address, hint="restart the server")
        text = f"{new} bytes that belong to no packet were discarded"
        return [SourceEvent(self._name, "fault", now, math.nan, text)] if new else []


def _plate_info(name: str, rate_hz: float, plate: cgstream.Plate) -> PlateInfo:
    low, high = plate.low, plate.high
    local = np.array([[high[0], high[1]], [low[0], high[1]], [low[0], low[1]], [high[0], low[1]]], float)
    surface = np.column_stack([local, np.full(4, high[2])])
    origin = plate.translation / MM_PER_M
    corners = origin + surface @ plate.rotation.T / MM_PER_M
    return PlateInfo(
        name, rate_hz, LOADS, LOAD_UNITS, -np.eye(6), plate.rotation, origin, corners, zeroed=True
    )
