"""The 12-channel RS-232 protocol of AMTI's AccuSway+ and AccuGait class, as public programs speak it.

Sources: the LabStreamingLayer app for AMTI force plates, and the AccuSwayPlus libraries in C#, which agree.
No manual was at hand and no hardware: what is here is verified against these programs' descriptions only.

Commands are single bytes at 8N1, first at 57 600 baud; most are echoed. A sample is twelve 16-bit words,
little endian: the low 12 bits are the reading plus 2048, the high 4 bits the channel's number, which is 15
for channel 0 while the trigger input is set. There is neither a counter nor a checksum: lost bytes show in
the channel numbers, a wrong bit in a reading does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

Array = np.ndarray

CHANNELS = 12
FRAME_BYTES = 2 * CHANNELS
ZERO_READING = 2048

FIRST_BAUD = 57600

STOP, START, AUTO_ZERO, SERIAL_NUMBER = b"R", b"Q", b"S", b"X"
"""Commands; STOP has no answer."""

STARTED, ZEROED, SERIAL_FOLLOWS = b"U", b"T", b"x"
"""First bytes of the answers; a zeroed plate adds 12 bytes, the serial number has 4 characters."""

TWO_PLATES = (b"V", b"d")
"""Answers of two plates that share a line: to START, to AUTO_ZERO."""

ZEROED_BYTES, SERIAL_BYTES = 12, 4


@dataclass(frozen=True)
class Rate:
    """A sampling rate that the plate knows.

    Attributes:
        command: What sets it; echoed.
        baud: Speed of the line from then on [bit/s].
    """

    command: bytes
    baud: int


RATES_HZ = {50: Rate(b"r", 57600), 100: Rate(b"f", 115200), 200: Rate(b"v", 115200)}
"""Sampling rates; the last is known from one of the programs only."""

CHANNEL_NAMES = tuple(f"channel {k}" for k in range(1, CHANNELS + 1))

_NUMBERS = tuple(range(1, CHANNELS))


@dataclass(frozen=True)
class AmtiSample:
    """One sample.

    Attributes:
        counts: Reading of every channel, -2048 to 2047.
        trigger: The trigger input is set.
    """

    counts: Int[Array, " channel"]
    trigger: bool


@dataclass(frozen=True)
class Skipped:
    """Bytes that were passed over to find the next sample.

    Attributes:
        size: How many.
    """

    size: int


def encode_sample(counts: tuple[int, ...], trigger: bool = False) -> bytes:
    """A sample as the plate sends it.

    Args:
        counts: Reading of every channel, -2048 to 2047.
        trigger: The trigger input is set.
    """
    numbers = [15 if trigger and k == 0 else k for k in range(CHANNELS)]
    words = [((c + ZERO_READING) & 0xFFF) | (k << 12) for c, k in zip(counts, numbers, strict=True)]
    return np.array(words, "<u2").tobytes()


class AmtiDecoder:
    """Turns a stream of bytes, in pieces of any length, into samples."""

    def __init__(self) -> None:
        """A decoder that knows nothing yet."""
        self._rest = b""
        self._skipping = 0

    def feed(self, data: bytes) -> list[AmtiSample | Skipped]:
        """Samples that these bytes complete, and what was passed over on the way to each.

        Args:
            data: Bytes in the order of their arrival.
        """
        buffer, at = self._rest + data, 0
        found: list[AmtiSample | Skipped] = []
        while len(buffer) - at >= FRAME_BYTES:
            if not _begins(buffer, at):
                at += 1
                self._skipping += 1
                continue
            if self._skipping:
                found.append(Skipped(self._skipping))
                self._skipping = 0
            words = np.frombuffer(buffer, "<u2", CHANNELS, at)
            found.append(AmtiSample((words & 0xFFF).astype(int) - ZERO_READING, bool(words[0] >> 12)))
            at += FRAME_BYTES
        self._rest = buffer[at:]
        return found


def _begins(buffer: bytes, at: int) -> bool:
    """A whole sample stands here, by its channel numbers."""
    if buffer[at + 1] >> 4 not in (0, 15):
        return False
    return all(buffer[at + 2 * k + 1] >> 4 == k for k in _NUMBERS)
