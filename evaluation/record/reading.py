"""Read a recording, finished or cut anywhere."""

from __future__ import annotations

import io
import struct
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Message, Schema
from mcap.stream_reader import breakup_chunk

from evaluation.record.mcap_log import MAGIC
from evaluation.record.messages import Mark, decode
from evaluation.sources.stream import Item, MarkerFrame, PlateSamples, SourceEvent, SourceInfo
from hilbrace.errors import InputError

LARGEST_RECORD = 64 * 2**20
"""Bytes of the largest record that is read; this program writes kilobytes, other writers a few megabytes."""

_HEAD = struct.Struct("<BQ")
_BROKEN = (McapError, ValueError, KeyError, TypeError, IndexError, AttributeError, struct.error)


@dataclass(frozen=True)
class Recorded:
    """The content of a recording.

    Attributes:
        path: The file.
        items: What the sources sent, in the order in which it arrived.
        marks: What operator and recorder wrote.
        finished: Whether it was closed as it should be.
        discarded_bytes: Bytes at the end, or in damaged chunks, that hold nothing readable.
        damaged_chunks: Chunks whose checksum or content is wrong; they are left out.
        schemas: The file's schemas by number.
        channels: The file's channels by number.
        messages: The file's messages, of which items and marks are the content.
    """

    path: Path
    items: tuple[Item, ...]
    marks: tuple[Mark, ...]
    finished: bool
    discarded_bytes: int
    damaged_chunks: int
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    messages: tuple[Message, ...]

    @property
    def infos(self) -> tuple[SourceInfo, ...]:
        """What the sources said they deliver, in order."""
        return tuple(item for item in self.items if isinstance(item, SourceInfo))

    @property
    def condition(self) -> str:
        """The brace condition that was marked last; empty without one."""
        named = [mark.text for mark in self.marks if mark.kind == "condition"]
        return named[-1] if named else ""

    @property
    def last_ns(self) -> int:
        """Arrival of the last item or mark, by the clock of `MarkerFrame.host_time_ns` [ns]; 0 if empty."""
        times = [item.host_time_ns for item in self.items if not isinstance(item, SourceInfo)]
        return max([*times, *(mark.host_time_ns for mark in self.marks)], default=0)


def read_log(path: Path) -> Recorded:
    """Read a recording; one that a crash cut gives everything up to the cut.

    Raises:
        InputError: The file is missing, or none of ours.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such recording", where=str(path), hint="name an .mcap file") from None
    except OSError as fault:
        raise InputError(
            f"cannot read the recording: {fault.strerror}", where=str(path), hint="name an .mcap file"
        ) from None
    if not content.startswith(MAGIC):
        raise InputError(
            "this is no MCAP file", where=str(path), hint="name a file that 'hilbrace evaluate record' wrote"
        )
    found = _Found()
    end, finished = _scan(content, found)
    recorded = Recorded(
        path=path,
        items=tuple(item for item in found.items if not isinstance(item, Mark)),
        marks=tuple(item for item in found.items if isinstance(item, Mark)),
        finished=finished,
        discarded_bytes=found.damaged_bytes + (0 if finished else len(content) - end),
        damaged_chunks=found.damaged,
        schemas=found.schemas,
        channels=found.channels,
        messages=tuple(found.messages),
    )
    if not recorded.marks and not recorded.items:
        raise InputError(
            "the recording holds nothing of a laboratory's device" + (f", and {found.damaged} damaged chunks"
                                                                      if found.damaged else ""),
            where=str(path),
            hint="name a file that 'hilbrace evaluate record' wrote",
        )  # fmt: skip
    return recorded


def missing_numbers(items: tuple[Item, ...]) -> dict[str, int]:
    """Frames and samples that the devices' counters say are missing between the first and the last.

    Args:
        items: What the sources sent.

    Returns:
        By stream, as ``vicon markers``; streams without a gap too.
    """
    nexts: dict[str, int] = {}
    lost: Counter[str] = Counter()
    for item in items:
        if isinstance(item, MarkerFrame):
            stream, count = f"{item.source} markers", 1
        elif isinstance(item, PlateSamples):
            stream, count = f"{item.source} {item.plate}", len(item.values)
        else:
            continue
        lost[stream] += max(0, item.number - nexts.get(stream, item.number))
        nexts[stream] = item.number + count
    return dict(lost)


def interruptions(items: tuple[Item, ...]) -> tuple[SourceEvent, ...]:
    """Events that tell of something missing: gaps, faults and disconnections."""
    return tuple(
        item for item in items
        if isinstance(item, SourceEvent) and item.kind in ("gap", "fault", "disconnected")
    )  # fmt: skip


class _Found:
    """What a scan gathers."""

    def __init__(self) -> None:
        self.items: list[Item | Mark] = []
        self.messages: list[Message] = []
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.damaged = 0
        self.damaged_bytes = 0


def _scan(content: bytes, found: _Found) -> tuple[int, bool]:
    """Read records until the end, or the first that is cut; returns where, and whether the file is closed."""
    place = len(MAGIC)
    while place + _HEAD.size <= len(content):
        opcode, length = _HEAD.unpack_from(content, place)
        start, end = place + _HEAD.size, place + _HEAD.size + length
        if not 0 < opcode <= Opcode.DATA_END or length > LARGEST_RECORD or end > len(content):
            break
        body = content[start:end]
        if opcode == Opcode.FOOTER:
            return end + len(MAGIC), _is_footer(body) and content[end:].startswith(MAGIC)
        try:
            _take(opcode, body, found)
        except _BROKEN:
            found.damaged += 1
            found.damaged_bytes += length
        place = end
    return place, False


def _take(opcode: int, body: bytes, found: _Found) -> None:
    stream = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.CHUNK:
        chunk = Chunk.read(stream)
        if len(chunk.data) != chunk.uncompressed_size and not chunk.compression:
            raise ValueError("a chunk is not as long as it says")
        records = breakup_chunk(chunk, validate_crc=True)
    elif opcode == Opcode.SCHEMA:
        records = [Schema.read(stream)]
    elif opcode == Opcode.CHANNEL:
        records = [Channel.read(stream)]
    elif opcode == Opcode.MESSAGE:
        records = [Message.read(stream, len(body))]
    else:
        return
    for record in records:
        if isinstance(record, Schema):
            found.schemas[record.id] = record
        elif isinstance(record, Channel):
            found.channels[record.id] = record
    messages = [record for record in records if isinstance(record, Message)]
    found.items += [decode(message.data, found.channels[message.channel_id].metadata) for message in messages]
    found.messages += messages


def _is_footer(body: bytes) -> bool:
    return len(body) == 20 and Footer.read(ReadDataStream(io.BytesIO(body))).summary_start >= 0
