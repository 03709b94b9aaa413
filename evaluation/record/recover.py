"""Make a clean file of a recording that a crash, a power cut or a full disk left unfinished."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from evaluation.record.mcap_log import McapLog, create_file
from evaluation.record.messages import Mark, describe, encode, topic
from evaluation.record.reading import Recorded, interruptions, missing_numbers, read_log
from evaluation.sources.stream import MarkerFrame, PlateSamples, SourceInfo

MOST_LOST_S = 0.05
"""What a recording may lack at its end when the recorder died [s]."""

CHUNK_BYTES = 256 * 1024
"""Size of a chunk in a clean file, which nobody writes while time runs."""


@dataclass(frozen=True)
class Recovered:
    """What was found in a recording.

    Attributes:
        path: The clean file.
        finished: Whether the recording had been closed as it should.
        frames: Marker frames in it.
        samples: Plate samples in it.
        seconds: From the first item to the last [s].
        missing: Frames and samples that the devices' counters say are missing, by stream.
        discarded_bytes: Bytes that could not be read.
        damaged_chunks: Chunks that could not be read.
        gaps: What is missing, one sentence each.
    """

    path: Path
    finished: bool
    frames: int
    samples: int
    seconds: float
    missing: dict[str, int]
    discarded_bytes: int
    damaged_chunks: int
    gaps: tuple[str, ...]


def recover(path: Path, out: Path | None = None) -> Recovered:
    """Read what is there, write it to a new file, and say what is missing.

    Args:
        path: The recording; it is not touched.
        out: Name of the clean file; the recording's with ``_recovered`` if left out. An existing file is
            never touched, the next free name serves instead.

    Raises:
        InputError: The file is no recording, or the clean file cannot be written.
    """
    recorded = read_log(path)
    gaps = describe_gaps(recorded)
    clean = write_log(recorded, out or path.with_stem(f"{path.stem}_recovered"), gaps)
    times = [item.host_time_ns for item in recorded.items if not isinstance(item, SourceInfo)]
    return Recovered(
        path=clean,
        finished=recorded.finished,
        frames=sum(isinstance(item, MarkerFrame) for item in recorded.items),
        samples=sum(len(item.values) for item in recorded.items if isinstance(item, PlateSamples)),
        seconds=1e-9 * (max(times) - min(times)) if times else 0.0,
        missing=missing_numbers(recorded.items),
        discarded_bytes=recorded.discarded_bytes,
        damaged_chunks=recorded.damaged_chunks,
        gaps=gaps,
    )


def describe_gaps(recorded: Recorded) -> tuple[str, ...]:
    """What a recording lacks, one sentence each; nothing for a whole one."""
    start = next((mark.host_time_ns for mark in recorded.marks if mark.kind == "start"), 0)
    sentences = []
    if not recorded.finished:
        at = 1e-9 * (recorded.last_ns - start)
        sentences.append(
            f"The recording stops {at:.3f} s after its start without having been closed: what came after is "
            f"missing, up to {1000 * MOST_LOST_S:.0f} ms of it before the recorder died."
        )
    if recorded.discarded_bytes:
        sentences.append(
            f"{recorded.discarded_bytes} bytes could not be read"
            + (f", among them {recorded.damaged_chunks} damaged chunks." if recorded.damaged_chunks else ".")
        )
    sentences += [
        f"{stream}: {count} missing by the device's counter."
        for stream, count in missing_numbers(recorded.items).items()
        if count
    ]
    sentences += [
        f"{event.source}, {1e-9 * (event.host_time_ns - start):.3f} s: {event.text}"
        for event in interruptions(recorded.items)
    ]
    sentences += [mark.text for mark in recorded.marks if mark.kind in ("lost", "recovered")]
    return tuple(sentences)


def write_log(recorded: Recorded, path: Path, gaps: tuple[str, ...]) -> Path:
    """Write the content of a recording to a new file, with what it lacks as a mark.

    Args:
        recorded: The content.
        path: The new file's name; the next free one if it exists.
        gaps: What is missing, one sentence each.

    Returns:
        The name it got.
    """
    chosen, stream = create_file(path)
    log = McapLog(stream)
    numbers = {
        number: log.add_channel(
            channel.topic, json.loads(recorded.schemas[channel.schema_id].data), channel.metadata
        )
        for number, channel in recorded.channels.items()
    }
    size = 0
    for message in recorded.messages:
        log.add(numbers[message.channel_id], message.log_time, message.sequence, message.data)
        size += len(message.data)
        if size > CHUNK_BYTES:
            log.flush()
            size = 0
    if gaps:
        mark = Mark("recovered", recorded.last_ns, " ".join(gaps), {"gaps": list(gaps)})
        last = max((message.log_time for message in recorded.messages), default=0)
        log.add(log.add_channel(topic(mark), *describe(mark, None)), last, 0, encode(mark, None))
    log.close()
    return chosen
