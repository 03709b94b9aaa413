"""An append-only MCAP file whose every chunk is complete in itself.

The format is MCAP version 0 (mcap.dev/spec): a chunk holds some milliseconds of messages, uncompressed, with
its own checksum, and goes to the operating system in one write. A process that dies leaves a file whose
chunks all read; only the summary that lets programs jump about is missing, and `evaluation.record.recover`
writes it. The library's own writer keeps one object per chunk until the file is closed, which at fifty chunks
a second is megabytes a minute; here the index of the chunks is kept as the bytes that will be written.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterator
from io import FileIO
from itertools import count
from pathlib import Path
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Schema,
    Statistics,
)

from hilbrace.errors import InputError

MAGIC = b"\x89MCAP0\r\n"

LIBRARY = "hilbrace"

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS = _MESSAGE.size - 9
_COUNTER = 2**32


class McapLog:
    """Writes messages as JSON, chunk by chunk; nothing of a finished chunk stays in this process.

    Args:
        stream: An empty file, unbuffered.
    """

    def __init__(self, stream: FileIO) -> None:
        self._stream = stream
        self._definitions: list[Schema | Channel] = []
        self._topics: dict[int, int] = {}
        self._chunk = bytearray()
        self._places: dict[int, list[tuple[int, int]]] = {}
        self._span = (0, 0)
        self._chunks = RecordBuilder()
        self._chunk_count = 0
        self._start_ns, self._end_ns = 0, 0
        self.bytes_written = 0
        self._write(MAGIC + _encoded(Header("", LIBRARY)))

    def add_channel(self, topic: str, schema: dict[str, Any], metadata: dict[str, str]) -> int:
        """Announce a kind of message.

        Args:
            topic: Where viewers list it, as ``/vicon/markers``.
            schema: JSON schema of its messages; its ``title`` names it.
            metadata: What else readers need to know.

        Returns:
            The channel's number, for `add`.
        """
        number = len(self._topics) + 1
        content = json.dumps(schema).encode()
        for record in (
            Schema(id=number, name=str(schema["title"]), encoding="jsonschema", data=content),
            Channel(id=number, topic=topic, message_encoding="json", schema_id=number, metadata=metadata),
        ):
            self._definitions.append(record)
            self._chunk += _encoded(record)
        self._topics[number] = 0
        return number

    def add(self, channel: int, time_ns: int, sequence: int, content: bytes) -> None:
        """Put a message into the chunk under way.

        Args:
            channel: Number that `add_channel` gave.
            time_ns: When it arrived, by the wall clock [ns].
            sequence: The device's own counter.
            content: The message, as JSON.
        """
        self._span = (min(self._span[0], time_ns), max(self._span[1], time_ns)) if self._places else (
            time_ns, time_ns,
        )  # fmt: skip
        self._places.setdefault(channel, []).append((time_ns, len(self._chunk)))
        self._topics[channel] += 1
        self._chunk += _MESSAGE.pack(
            Opcode.MESSAGE, _MESSAGE_FIELDS + len(content), channel, sequence % _COUNTER, time_ns, time_ns
        )
        self._chunk += content

    @property
    def pending(self) -> bool:
        """Whether the chunk under way holds messages."""
        return bool(self._places)

    def flush(self) -> None:
        """Finish the chunk under way and hand it to the operating system.

        Raises:
            OSError: It could not be written, as on a full disk.
        """
        if not self._places:
            return
        data = bytes(self._chunk)
        chunk = _encoded(Chunk("", data, self._span[1], self._span[0], zlib.crc32(data), len(data)))
        indexes, offsets = bytearray(), {}
        for channel, places in self._places.items():
            offsets[channel] = self.bytes_written + len(chunk) + len(indexes)
            indexes += _encoded(MessageIndex(channel, places))
        start = self.bytes_written
        self._write(chunk + bytes(indexes))
        entry = ChunkIndex(
            chunk_length=len(chunk), chunk_start_offset=start, compression="", compressed_size=len(data),
            message_end_time=self._span[1], message_index_length=len(indexes), message_index_offsets=offsets,
            message_start_time=self._span[0], uncompressed_size=len(data),
        )  # fmt: skip
        entry.write(self._chunks)
        first = self._chunk_count == 0
        self._start_ns = self._span[0] if first else min(self._start_ns, self._span[0])
        self._end_ns = self._span[1] if first else max(self._end_ns, self._span[1])
        self._chunk_count += 1
        self._chunk, self._places = bytearray(), {}

    def close(self) -> None:
        """Write the summary, bring everything to the disk, and close the file.

        Raises:
            OSError: It could not be written; the chunks before it are in the file.
        """
        try:
            self.flush()
            self._write(_encoded(DataEnd(0)))
            start = self.bytes_written
            summary = b"".join(map(_encoded, [*self._definitions, self._statistics()])) + self._chunks.end()
            head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
            checksum = zlib.crc32(head, zlib.crc32(summary))
            self._write(summary + _encoded(Footer(start, 0, checksum)) + MAGIC)
            os.fsync(self._stream.fileno())
        finally:
            self._stream.close()

    def abandon(self) -> None:
        """Close the file without a summary; finished chunks stay readable."""
        self._stream.close()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0, channel_count=len(self._topics), channel_message_counts=dict(self._topics),
            chunk_count=self._chunk_count, message_count=sum(self._topics.values()),
            message_end_time=self._end_ns, message_start_time=self._start_ns, metadata_count=0,
            schema_count=len(self._topics),
        )  # fmt: skip

    def _write(self, content: bytes) -> None:
        rest = memoryview(content)
        while rest:
            written = self._stream.write(rest) or 0
            self.bytes_written += written
            rest = rest[written:]


def create_file(path: Path) -> tuple[Path, FileIO]:
    """Create a file that was not there: the name given, or the next free one.

    Args:
        path: The wanted name, as ``take.mcap``; ``take_2.mcap`` is next.

    Returns:
        The name it got, and the open file, unbuffered.

    Raises:
        InputError: The folder is missing or cannot be written.
    """
    for candidate in _names(path):
        try:
            return candidate, FileIO(candidate, "xb")
        except FileExistsError:
            continue
        except OSError as fault:
            raise InputError(
                f"cannot create the recording: {fault.strerror}",
                where=str(candidate),
                hint="name a folder that exists and may be written",
            ) from None
    raise InputError("no free name", where=str(path), hint="name another file")


def _names(path: Path) -> Iterator[Path]:
    yield path
    for number in count(2):
        yield path.with_stem(f"{path.stem}_{number}")


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
