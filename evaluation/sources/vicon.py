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

import numpy as np
from jaxtyping import Float

from evaluation.sources import cgstream
from evaluation.sources.cgstream import Block, Kind, Packet
from evaluation.sources.connection import connect, receive, send
from evaluation.sources.stream import (
    Item,
    LabError,
    MarkerFrame,
    PlateSamples,
    SourceEvent,
    SourceInfo,
)
from evaluation.sources.vicon_scene import STATIC, Scene, centre_error, check_labels
from hilbrace.errors import InputError

Array = np.ndarray

PORT = 801
CONNECT_S = 3.0
"""Longest wait for the server's answer, and again for its first frame."""

LOAD_KINDS = (Kind.FORCE, Kind.MOMENT, Kind.CENTRE_OF_PRESSURE)

WANTED = {*STATIC, Kind.CONTENTS, Kind.FRAME_INFO, Kind.LABELLED_MARKERS, *LOAD_KINDS}

FARTHEST_CENTRE_M = 0.01
"""How far the server's centre of pressure may be from that of force and moment."""

LONGEST_NONSENSE = 2**20
"""Bytes without a single packet after which the server is not taken for a DataStream."""


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
        self._scene = Scene()
        self._reported = self._intact = 0
        self._doubted: set[str] = set()
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
        InputError: Two markers have one name.
        """
        self.close()
        self._framer, self._scene, self._waiting = cgstream.Framer(), Scene(), []
        self._reported = self._intact = 0
        self._doubted = set()
        self._socket = connect(self._host, self._port, self._patience, "a DataStream server")
        try:
            self._shake_hands(time.monotonic() + self._patience)
            return self._first_frame(time.monotonic() + self._patience)
        except (LabError, InputError):
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
                    check_labels(item, self.address)
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
        forces, moments, centres = (
            [cgstream.read_block(payload) for kind, payload in packet if kind == wanted]
            for wanted in LOAD_KINDS
        )
        news = self._scene.count_samples(forces) or news
        items: list[Item] = []
        if news and math.isfinite(self._scene.period_s):
            items.append(self._scene.info(self._name, self.address))
        number = cgstream.Reader(payloads[Kind.FRAME_INFO], "the frame's number").word()
        moment_s = number * self._scene.period_s
        if Kind.LABELLED_MARKERS in payloads:
            positions = self._scene.positions(payloads[Kind.LABELLED_MARKERS])
            items.append(MarkerFrame(self._name, number, moment_s, now, positions))
        return items + [item for force in forces for item in self._samples(force, moments, centres, now)]

    def _samples(self, force: Block, moments: list[Block], centres: list[Block], now: int) -> list[Item]:
        scene = self._scene
        if force.device not in scene.plates or force.device not in scene.devices or not len(force.values):
            return []
        count = len(force.values)
        moment, centre = _matching(moments, force), _matching(centres, force)
        block_s, name = scene.devices[force.device]
        start = scene.starts.get(force.device, 0.0) + force.number * block_s
        values = np.hstack([force.values, moment])
        samples = PlateSamples(self._name, name, force.number * count, start, block_s / count, now, values)
        apart = 0.0 if name in self._doubted else centre_error(force.values, moment, centre)
        if not apart > FARTHEST_CENTRE_M:
            return [samples]
        self._doubted.add(name)
        text = (
            f"force and moment of plate '{name}' put the centre of pressure {1e3 * apart:.0f} mm from where "
            "the server has it: the moments are about another point than the plate's origin"
        )
        return [SourceEvent(self._name, "fault", now, math.nan, text, plate=name), samples]

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


def _matching(blocks: list[Block], force: Block) -> Float[Array, "sample 3"]:
    """Samples of the same plate and time; NaN if there are none."""
    for block in blocks:
        if (block.device, block.number, len(block.values)) == (force.device, force.number, len(force.values)):
            return block.values
    return np.full(force.values.shape, np.nan)
