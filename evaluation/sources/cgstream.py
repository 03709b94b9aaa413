"""The wire format of Vicon's DataStream ("CGStream"): packets of typed objects, little endian.

    packet = u32 0x1A2B0001, u32 length, object ...
    object = u32 type, u32 length, payload
    string, list = u32 count, items

Written from the format that the MIT-licensed DataStream SDK 1.12 shows on the wire; none of its code is used.
Every count is checked against the bytes that are there before anything is made of it, so that damaged or
foreign bytes cost neither memory nor time.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Integer, Shaped

from evaluation.sources.stream import LabError

Array = np.ndarray

MAGIC = 0x1A2B0001
TICKS_PER_S = 135_000_000
"""Periods are counted in ticks of 135 MHz."""

MOST_PACKET_BYTES = 4 * 2**20
"""Larger packets are refused: a hundred markers and ten plates take 20 kB."""

MOST_OBJECTS = 4096

NO_PARENT = 0xFFFFFFFF

_MAGIC_BYTES = struct.pack("<I", MAGIC)
_PAIR = struct.Struct("<II")
_WORD = struct.Struct("<I")
_BLOCK = struct.Struct("<4I")
_LABELLED = np.dtype(
    [
        ("subject", "<u4"),
        ("marker", "<u4"),
        ("radius", "<f8"),
        ("position", "<f8", 3),
        ("covariance", "<f8", 9),
        ("trajectory", "<u4"),
    ]
)


class Kind(IntEnum):
    """Types of objects that this client or its tests speak of."""

    STREAM_INFO = 1
    SUBJECT_INFO = 2
    DEVICE_INFO = 3
    CHANNEL_INFO = 4
    FRAME_INFO = 5
    LABELLED_MARKERS = 6
    UNLABELLED_MARKERS = 7
    LOCAL_SEGMENTS = 8
    GLOBAL_SEGMENTS = 9
    FORCE = 10
    MOMENT = 11
    CENTRE_OF_PRESSURE = 12
    FORCE_PLATE_INFO = 20
    LATENCY_INFO = 26
    CHANNEL_UNITS = 34
    HARDWARE_FRAME = 36
    APPLICATION_INFO = 37
    DEVICE_START = 38
    FRAME_RATE = 39
    PING = 42
    OBJECT_TYPES = 100001
    REQUEST_FRAME = 100002
    CONTENTS = 100004
    FILTER = 100007
    REQUEST_NEXT = 100008


Packet = list[tuple[int, bytes]]
"""Types and payloads of one packet's objects, in order."""


class Framer:
    """Cuts a stream of bytes into packets; after damage it goes on at the next packet.

    Attributes:
        skipped: Bytes discarded so far because they belong to no packet.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.skipped = 0

    def feed(self, data: bytes) -> list[Packet]:
        """Packets that the bytes complete.

        Args:
            data: Bytes in the order of arrival, in pieces of any size.
        """
        self._buffer += data
        packets: list[Packet] = []
        while len(self._buffer) >= _PAIR.size:
            end, spans = self._measure()
            if end == 0:
                self._resynchronise()
            elif end > len(self._buffer):
                break
            else:
                packets.append([(kind, bytes(self._buffer[start:stop])) for kind, start, stop in spans])
                del self._buffer[:end]
        return packets

    def _measure(self) -> tuple[int, list[tuple[int, int, int]]]:
        """End of the first packet and its objects so far; an end of 0 means that this is none."""
        magic, length = _PAIR.unpack_from(self._buffer, 0)
        end = _PAIR.size + length
        spans: list[tuple[int, int, int]] = []
        if magic != MAGIC or length > MOST_PACKET_BYTES:
            return 0, spans
        at = _PAIR.size
        while at + _PAIR.size <= min(end, len(self._buffer)):
            kind, size = _PAIR.unpack_from(self._buffer, at)
            start, at = at + _PAIR.size, at + _PAIR.size + size
            if kind == MAGIC or at > end or len(spans) >= MOST_OBJECTS:
                return 0, spans
            spans.append((kind, start, at))
        return (0 if at < end < at + _PAIR.size else end), spans

    def _resynchronise(self) -> None:
        found = self._buffer.find(_MAGIC_BYTES, 1)
        gone = found if found >= 0 else max(1, len(self._buffer) - len(_MAGIC_BYTES) + 1)
        self.skipped += gone
        del self._buffer[:gone]


def pack_object(kind: int, payload: bytes = b"") -> bytes:
    """One object."""
    return _PAIR.pack(kind, len(payload)) + payload


def pack_packet(objects: Iterable[bytes]) -> bytes:
    """Objects as one packet."""
    body = b"".join(objects)
    return _PAIR.pack(MAGIC, len(body)) + body


def pack_types(kinds: Iterable[int]) -> bytes:
    """The object that lists types: those that a server has, or those that a client wants."""
    ordered = sorted(set(kinds))
    return pack_object(Kind.OBJECT_TYPES, struct.pack(f"<{len(ordered) + 1}I", len(ordered), *ordered))


class Reader:
    """Values of one payload, one after the other; reading past its end is a `LabError`."""

    def __init__(self, payload: bytes, what: str) -> None:
        self._data = payload
        self._what = what
        self._at = 0

    def values(self, pattern: str) -> tuple:
        """Values of a `struct` pattern without byte order."""
        pattern = "<" + pattern
        return struct.unpack(pattern, self._take(struct.calcsize(pattern)))

    def word(self) -> int:
        """An unsigned 32-bit number."""
        return _WORD.unpack(self._take(_WORD.size))[0]

    def count(self, least_bytes: int) -> int:
        """Length of a list whose items take at least so many bytes each."""
        number = self.word()
        if number * least_bytes > len(self._data) - self._at:
            raise malformed(f"{self._what} claims {number} items, more than its bytes can hold")
        return number

    def text(self) -> str:
        """A string."""
        return self._take(self.count(1)).decode("utf-8", "replace")

    def array(self, kind: np.dtype | str) -> Shaped[Array, " item"]:
        """A list of equal items."""
        kind = np.dtype(kind)
        number = self.count(kind.itemsize)
        return np.frombuffer(self._take(number * kind.itemsize), kind)

    def _take(self, size: int) -> bytes:
        piece = self._data[self._at : self._at + size]
        if len(piece) < size:
            raise malformed(f"{self._what} ends too early")
        self._at += size
        return piece


def malformed(what: str) -> LabError:
    """The error of an object that contradicts itself."""
    return LabError(
        what,
        where="DataStream",
        hint="the server's DataStream may be newer than version 1.12, or the line damages data",
    )


@dataclass(frozen=True)
class Subject:
    """A tracked subject.

    Attributes:
        number: Its identifier on the wire.
        name: Its name.
        markers: Names of its markers by identifier.
    """

    number: int
    name: str
    markers: dict[int, str]


@dataclass(frozen=True)
class Plate:
    """Where a force plate is.

    Attributes:
        device: Identifier of its device.
        translation: The plate's origin in the laboratory [mm].
        rotation: The plate's axes as columns.
        low: Lower bounds of the surface in the plate's axes [mm].
        high: Upper bounds [mm].
    """

    device: int
    translation: Float[Array, " 3"]
    rotation: Float[Array, "3 3"]
    low: Float[Array, " 3"]
    high: Float[Array, " 3"]


@dataclass(frozen=True)
class Block:
    """Samples of one three-component channel over one period of its device.

    Attributes:
        number: Counter of the device's periods.
        device: Identifier of the device.
        values: The samples, in N, N*m or m.
    """

    number: int
    device: int
    values: Float[Array, "sample 3"]


def read_types(payload: bytes) -> set[int]:
    """Types in a list of types."""
    return set(Reader(payload, "the list of types").array("<u4").tolist())


def read_contents(payload: bytes) -> tuple[set[int], set[int]]:
    """Types that a frame has, and those of them that are not sent again since they have not changed."""
    reader = Reader(payload, "the table of contents")
    present = {kind for kind, number in (reader.values("II") for _ in range(reader.count(8))) if number}
    return present, set(reader.array("<u4").tolist())


def read_period(payload: bytes) -> float:
    """Time from frame to frame [s] of the object about the stream."""
    (ticks,) = Reader(payload, "the stream's description").values("q")
    if ticks <= 0:
        raise malformed("the frame rate is not positive")
    return ticks / TICKS_PER_S


def read_subject(payload: bytes) -> Subject:
    """A subject with its markers; segments are passed over."""
    reader = Reader(payload, "a subject")
    number, name = reader.word(), reader.text()
    for _ in range(reader.count(36)):
        reader.values("II6f")
        reader.text()
    return Subject(number, name, {reader.word(): reader.text() for _ in range(reader.count(8))})


def read_device(payload: bytes) -> tuple[int, float, str]:
    """Identifier, period of one block of samples [s] and name of a device."""
    reader = Reader(payload, "a device")
    number, ticks = reader.values("IQ")
    return number, ticks / TICKS_PER_S, reader.text()


def read_device_start(payload: bytes) -> tuple[int, float]:
    """Identifier of a device and time of its first sample [s]."""
    number, ticks = Reader(payload, "a device's start").values("IQ")
    return number, ticks / TICKS_PER_S


def read_plate(payload: bytes) -> Plate:
    """Place and bounds of a force plate."""
    number, *values = Reader(payload, "a force plate").values("I18f")
    numbers = np.array(values, float)
    return Plate(number, numbers[:3], numbers[3:12].reshape(3, 3), numbers[12:15], numbers[15:18])


def read_labelled(payload: bytes) -> tuple[Integer[Array, " marker"], Float[Array, "marker 3"]]:
    """Visible markers: keys as `marker_key` makes them, and positions [mm]."""
    markers = Reader(payload, "the markers").array(_LABELLED)
    return marker_key(markers["subject"], markers["marker"]), markers["position"].astype(float)


def marker_key(
    subject: Integer[Array, " marker"], marker: Integer[Array, " marker"]
) -> Integer[Array, " marker"]:
    """One number for a marker of a subject."""
    return (subject.astype(np.uint64) << np.uint64(32)) | marker.astype(np.uint64)


def read_block(payload: bytes) -> Block:
    """Samples of a force, moment or centre of pressure; the wire has one component after the other."""
    if len(payload) < _BLOCK.size:
        raise malformed("a block of samples ends too early")
    number, device, _, count = _BLOCK.unpack_from(payload)
    if count % 3 or _BLOCK.size + 4 * count > len(payload):
        raise malformed(f"a block of {count} samples does not fit its {len(payload)} bytes")
    values = np.frombuffer(payload, "<f4", count, _BLOCK.size).reshape(3, -1).T
    return Block(number, device, values.astype(float))
