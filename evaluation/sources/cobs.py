"""Consistent overhead byte stuffing: any bytes as bytes without zero, so that a zero can end a frame.

Cheshire & Baker 1999, Consistent Overhead Byte Stuffing, IEEE/ACM Transactions on Networking 7(2), 159-172.
Every zero is replaced by the distance to the next one; at most one byte in 254 is added.
"""

from __future__ import annotations

LONGEST_RUN = 254
"""Bytes other than zero that one distance can span."""


def encode(plain: bytes) -> bytes:
    """Bytes without zero that stand for any bytes.

    Args:
        plain: What to send.
    """
    stuffed = bytearray()
    runs = plain.split(b"\0")
    for position, run in enumerate(runs):
        while len(run) >= LONGEST_RUN:
            stuffed.append(LONGEST_RUN + 1)
            stuffed += run[:LONGEST_RUN]
            run = run[LONGEST_RUN:]
            if not run and position == len(runs) - 1:
                return bytes(stuffed)
        stuffed.append(len(run) + 1)
        stuffed += run
    return bytes(stuffed)


def decode(stuffed: bytes) -> bytes | None:
    """The bytes that were sent; ``None`` if no sender could have written these.

    Args:
        stuffed: What arrived between two zeros.
    """
    plain = bytearray()
    at, size = 0, len(stuffed)
    while at < size:
        distance = stuffed[at]
        following = at + distance
        if distance == 0 or following > size:
            return None
        plain += stuffed[at + 1 : following]
        if distance <= LONGEST_RUN and following < size:
            plain.append(0)
        at = following
    return bytes(plain)
