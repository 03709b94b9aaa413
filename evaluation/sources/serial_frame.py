"""The frame of self-built force plates: what crosses the wire, byte by byte (docs/serial_plate.md).

::

    00 | COBS(payload, CRC-32) | 00

A zero stands on either side, so that damage to one frame cannot swallow its neighbour's bounds: every frame
that arrives whole is kept, whatever happens to the others. Payloads are little endian:

==== ======= =====================================================================================
type name    rest of the payload
==== ======= =====================================================================================
1    sample  u16 sequence, u32 microseconds, n times i32 counts
2    info    JSON object: name, serial, rate_hz, channels (names), calibration (optional)
3    edge    u32 microseconds, u8 level of the trigger input
==== ======= =====================================================================================

The check is CRC-32 (IEEE 802.3). It misses a frame of random bytes once in 4.3e9; with 16 bits that would be
once in 65 536, which at 1 kHz and one damaged byte in a hundred is a wrong force every quarter of an hour.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass
from typing import Any

from evaluation.sources import cobs

SAMPLE, INFO, EDGE = 1, 2, 3
"""Types of frames."""

LONGEST_FRAME = 1024
"""Bytes between two zeros; more is noise or another protocol."""

MOST_CHANNELS = 32

_SAMPLE_HEAD = struct.Struct("<BHI")
_EDGE = struct.Struct("<BIB")
_CHECK = struct.Struct("<I")


@dataclass(frozen=True)
class Sample:
    """One sample of all channels.

    Attributes:
        sequence: Counter of samples, modulo 65 536; ``None`` where the protocol has none.
        microseconds: The device's clock, modulo 2^32 [us].
        counts: Raw value of every channel.
    """

    sequence: int | None
    microseconds: int
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Edge:
    """The trigger input changed.

    Attributes:
        microseconds: The device's clock, modulo 2^32 [us].
        level: The new level.
    """

    microseconds: int
    level: int


@dataclass(frozen=True)
class Announcement:
    """What a plate says about itself.

    Attributes:
        name: How the plate calls itself.
        serial: Its serial number.
        rate_hz: Samples per second [Hz].
        channels: Names of the channels.
        calibration: Name of the calibration it was built with; empty if it names none.
    """

    name: str
    serial: str
    rate_hz: float
    channels: tuple[str, ...]
    calibration: str = ""


@dataclass(frozen=True)
class Damage:
    """Bytes that are no frame.

    Attributes:
        size: How many.
    """

    size: int


Message = Sample | Edge | Announcement | Damage


def frame(payload: bytes) -> bytes:
    """A payload as it crosses the wire.

    Args:
        payload: Type and content.
    """
    return b"\0" + cobs.encode(payload + _CHECK.pack(zlib.crc32(payload))) + b"\0"


def sample_frame(sequence: int, microseconds: int, counts: tuple[int, ...]) -> bytes:
    """Frame of one sample; counter and clock wrap.

    Args:
        sequence: Counter of samples.
        microseconds: The device's clock [us].
        counts: Raw value of every channel.
    """
    head = _SAMPLE_HEAD.pack(SAMPLE, sequence & 0xFFFF, microseconds & 0xFFFFFFFF)
    return frame(head + struct.pack(f"<{len(counts)}i", *counts))


def edge_frame(microseconds: int, level: int) -> bytes:
    """Frame of a change at the trigger input.

    Args:
        microseconds: The device's clock [us].
        level: The new level, 0 or 1.
    """
    return frame(_EDGE.pack(EDGE, microseconds & 0xFFFFFFFF, level))


def info_frame(plate: Announcement) -> bytes:
    """Frame in which a plate says what it is.

    Args:
        plate: What it says.
    """
    return frame(bytes([INFO]) + announcement_json(plate).encode())


def announcement_json(plate: Announcement) -> str:
    """An announcement as the JSON object that plates send."""
    told = {key: value for key, value in vars(plate).items() if value}
    return json.dumps(told | {"channels": list(plate.channels)}, separators=(",", ":"))


def read_announcement(text: str) -> Announcement | None:
    """What a plate says about itself; ``None`` if the text does not say what is needed.

    Args:
        text: JSON object.
    """
    try:
        told = json.loads(text)
    except (json.JSONDecodeError, RecursionError):
        return None
    if not isinstance(told, dict):
        return None
    channels, rate = told.get("channels"), told.get("rate_hz")
    if not (isinstance(channels, list) and 0 < len(channels) <= MOST_CHANNELS):
        return None
    if not (isinstance(rate, int | float) and 0 < rate <= 1e5):
        return None
    return Announcement(
        name=_text(told, "name", "unnamed plate"),
        serial=_text(told, "serial", ""),
        rate_hz=float(rate),
        channels=tuple(str(c) for c in channels),
        calibration=_text(told, "calibration", ""),
    )


class FrameDecoder:
    """Turns a stream of bytes, in pieces of any length, into messages.

    Attributes:
        channels: Number of counts in a sample; frames with another number are damage. 0 accepts any until
            the plate has announced itself.
    """

    def __init__(self, channels: int = 0) -> None:
        """A decoder that knows nothing yet.

        Args:
            channels: Number of counts in a sample, if known.
        """
        self.channels = channels
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """Messages that these bytes complete.

        Args:
            data: Bytes in the order of their arrival.
        """
        *blocks, self._rest = (self._rest + data).split(b"\0")
        messages = [self._message(block) for block in blocks if block]
        if len(self._rest) > LONGEST_FRAME:
            messages.append(Damage(len(self._rest)))
            self._rest = b""
        return messages

    def _message(self, block: bytes) -> Message:
        plain = cobs.decode(block) if len(block) <= LONGEST_FRAME else None
        if plain is None or len(plain) <= _CHECK.size:
            return Damage(len(block))
        payload = plain[: -_CHECK.size]
        if zlib.crc32(payload) != _CHECK.unpack(plain[-_CHECK.size :])[0]:
            return Damage(len(block))
        message = self._content(payload)
        if isinstance(message, Announcement):
            self.channels = len(message.channels)
        return message or Damage(len(block))

    def _content(self, payload: bytes) -> Message | None:
        """What an intact payload says; ``None`` if it is of no known form."""
        if payload[0] == SAMPLE:
            count, odd = divmod(len(payload) - _SAMPLE_HEAD.size, 4)
            if odd or not 0 < count <= MOST_CHANNELS or self.channels not in (0, count):
                return None
            _, sequence, microseconds = _SAMPLE_HEAD.unpack_from(payload)
            return Sample(
                sequence, microseconds, struct.unpack_from(f"<{count}i", payload, _SAMPLE_HEAD.size)
            )
        if payload[0] == EDGE and len(payload) == _EDGE.size and payload[-1] <= 1:
            _, microseconds, level = _EDGE.unpack(payload)
            return Edge(microseconds, level)
        if payload[0] == INFO:
            return read_announcement(payload[1:].decode("utf-8", "replace"))
        return None


def _text(told: dict[str, Any], key: str, default: str) -> str:
    """A short printable text that a plate says."""
    text = str(told.get(key, default))
    return "".join(c if c.isprintable() else "?" for c in text)[:80]
