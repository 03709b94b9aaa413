"""The packets of QTM's real-time protocol, measured before the vendor's client sees them.

The client trusts every length that it reads: a damaged one would make it wait, or loop, for ever.
Layout: QTM Real-time Server Protocol Documentation, Qualisys AB.
"""

from __future__ import annotations

import struct

from evaluation.sources.stream import LabError

MOST_PACKET_BYTES = 4 * 2**20

_HEADER = struct.Struct("<II")
_DATA, _EVENT, _LAST_KIND = 3, 6, 9
_PASSED = {0, 1, 2, _DATA, 4, _EVENT}
_FIRST_COMPONENT, _LAST_COMPONENT = 24, 19
_LAST_EVENT = 16


class Gate:
    """Cuts the stream into packets, and stops at the first that contradicts itself."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Packets that the bytes complete, as far as the vendor's client knows their types.

        Raises:
            LabError: The lengths of a packet contradict each other.
        """
        self._buffer += data
        packets: list[bytes] = []
        while len(self._buffer) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._buffer)
            if not _HEADER.size <= size <= MOST_PACKET_BYTES or kind > _LAST_KIND:
                raise damaged(f"a packet of type {kind} claims {size} bytes")
            if size > len(self._buffer):
                break
            packet = bytes(self._buffer[:size])
            del self._buffer[:size]
            if kind == _DATA:
                check_components(packet)
            if kind in _PASSED and not (kind == _EVENT and _unknown_event(packet)):
                packets.append(packet)
        return packets


def check_components(packet: bytes) -> None:
    """Refuse a data packet whose components do not fill it exactly, or are of unknown type.

    Raises:
        LabError: They do not.
    """
    if len(packet) < _FIRST_COMPONENT:
        raise damaged(f"a data packet has {len(packet)} bytes only")
    (count,) = struct.unpack_from("<I", packet, _FIRST_COMPONENT - 4)
    at = _FIRST_COMPONENT
    for _ in range(min(count, len(packet))):
        size, kind = _HEADER.unpack_from(packet, at) if at + _HEADER.size <= len(packet) else (0, 0)
        if not _HEADER.size <= size <= len(packet) - at or not 1 <= kind <= _LAST_COMPONENT:
            raise damaged("the components of a data packet do not fit it")
        at += size
    if at != len(packet):
        raise damaged("a data packet is longer than its components")


def damaged(what: str) -> LabError:
    """The error of a stream that cannot be read on."""
    return LabError(
        what, where="QTM's real-time stream", hint="connect again; check the line if it comes back"
    )


def _unknown_event(packet: bytes) -> bool:
    return len(packet) != _HEADER.size + 1 or not 1 <= packet[-1] <= _LAST_EVENT
