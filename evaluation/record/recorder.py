"""One recording while it grows: items in, complete chunks on the disk every few milliseconds."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from dataclasses import asdict, dataclass
from io import FileIO
from pathlib import Path
from typing import Any

from evaluation.device_clock import DeviceClock
from evaluation.record.mcap_log import McapLog, create_file
from evaluation.record.messages import (
    Mark,
    MarkKind,
    channels_of,
    describe,
    encode,
    labels_of,
    plate_of,
    topic,
)
from evaluation.sources.stream import Item, MarkerFrame, PlateSamples, SourceEvent, SourceInfo
from hilbrace import __version__
from hilbrace.errors import InputError

FLUSH_NS = 20_000_000
"""Oldest that a message may grow before its chunk goes to the operating system [ns]: what a crash costs."""

SYNC_SECONDS = 1.0
"""How often the file is brought to the disk itself, which is what a power cut costs."""


@dataclass(frozen=True)
class Written:
    """What is in a recording.

    Attributes:
        path: The file.
        bytes: Its size.
        frames: Marker frames.
        samples: Plate samples.
        lost: Frames and samples missing by the devices' counters while it ran.
        dropped: Items that this program could not keep up with.
        seconds: Its length [s].
    """

    path: Path
    bytes: int
    frames: int
    samples: int
    lost: int
    dropped: int
    seconds: float


class Recorder:
    """Writes items to a new file; used by one thread.

    Args:
        path: Name of the file; an existing one is never touched, the next free name serves instead.
        infos: What the sources deliver, as far as known; written first.
        content: What the recording is about, for its first mark: condition, subject, protocol.

    Raises:
        InputError: The file cannot be created.
    """

    def __init__(self, path: Path, infos: tuple[SourceInfo, ...], content: dict[str, Any]) -> None:
        self.path, stream = create_file(path)
        try:
            self._log = McapLog(stream)
        except OSError as fault:
            stream.close()
            raise InputError(
                f"cannot write the recording: {fault.strerror}",
                where=str(self.path),
                hint="make room on the disk, or name another folder",
            ) from None
        self._sync = _PeriodicSync(stream)
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._infos: dict[str, SourceInfo] = {}
        self._channels: dict[tuple[str, tuple[str, ...]], int] = {}
        self._counts: Counter[str] = Counter()
        self._clocks: dict[str, DeviceClock] = {}
        self._oldest_ns = 0
        self._started_ns = self._last_ns = time.monotonic_ns()
        self.mark("start", self.path.stem, content | {"program": f"hilbrace {__version__}"})
        for info in infos:
            self.add(info)
        self._log.flush()

    def add(self, item: Item) -> None:
        """Write an item.

        Raises:
            OSError: The disk is full or gone; what was written before stays readable.
        """
        match item:
            case SourceInfo():
                self._infos[item.source] = item
            case MarkerFrame():
                self._counts["frames"] += 1
            case PlateSamples():
                self._counts["samples"] += len(item.values)
            case SourceEvent():
                self._counts["lost"] += item.lost
        self._clocks.setdefault(item.source, DeviceClock()).add(item)
        self._put(item, self._number(item))

    def mark(self, kind: MarkKind, text: str, content: dict[str, Any] | None = None) -> None:
        """Write a mark of the operator or of the recorder itself.

        Args:
            kind: What it says.
            text: Name of the condition, or a sentence.
            content: Whatever else belongs to it.
        """
        if kind == "lost":
            self._counts["dropped"] += int((content or {}).get("items", 0))
        self._put(Mark(kind, time.monotonic_ns(), text, content or {}), 0)

    def tick(self) -> None:
        """Hand over the chunk under way if it is old enough; to be called every few milliseconds.

        Raises:
            OSError: The disk is full or gone.
        """
        if self._sync.fault is not None:
            raise self._sync.fault
        if self._log.pending and time.monotonic_ns() - self._oldest_ns >= FLUSH_NS:
            self._log.flush()

    def written(self) -> Written:
        """What the recording holds so far."""
        return Written(
            path=self.path,
            bytes=self._log.bytes_written,
            frames=self._counts["frames"],
            samples=self._counts["samples"],
            lost=self._counts["lost"],
            dropped=self._counts["dropped"],
            seconds=1e-9 * (self._last_ns - self._started_ns),
        )

    def close(self) -> Written:
        """Write the last mark with counts and the devices' clocks, and the summary, and close the file.

        Raises:
            OSError: It could not be finished; `evaluation.record.recover` reads what is there.
        """
        self._sync.stop()
        try:
            self.mark("stop", self.path.stem, self._summary())
        finally:
            self._log.close()
        return self.written()

    def abandon(self) -> None:
        """Close the file as it is, after a fault of the disk."""
        self._sync.stop()
        self._log.abandon()

    def _summary(self) -> dict[str, Any]:
        """Counts, and how each device's clock ran against this computer's."""
        fits = {source: clock.fit() for source, clock in self._clocks.items()}
        clocks = {source: asdict(fit) for source, fit in fits.items() if fit is not None}
        return {name: self._counts[name] for name in ("frames", "samples", "lost", "dropped")} | {
            "clocks": clocks
        }

    def _put(self, item: Item | Mark, number: int) -> None:
        source = "" if isinstance(item, Mark) else item.source
        info = self._infos.get(source)
        key = (topic(item), _columns(item, info))
        if key not in self._channels:
            self._channels[key] = self._log.add_channel(key[0], *describe(item, info))
        now = time.monotonic_ns()
        if not self._log.pending:
            self._oldest_ns = now
        self._last_ns = now if isinstance(item, SourceInfo) else item.host_time_ns
        self._log.add(self._channels[key], self._epoch_ns + self._last_ns, number, encode(item, info))
        if now - self._oldest_ns >= FLUSH_NS:
            self._log.flush()

    def _number(self, item: Item) -> int:
        return item.number if isinstance(item, MarkerFrame | PlateSamples) else 0


def _columns(item: Item | Mark, info: SourceInfo | None) -> tuple[str, ...]:
    """Names of the columns of an item; other columns need another channel."""
    match item:
        case MarkerFrame():
            return labels_of(info, item)
        case PlateSamples():
            return channels_of(plate_of(info, item.plate), item)
    return ()


class _PeriodicSync:
    """A thread that brings a file to the disk every second, so that nobody who writes waits for it."""

    def __init__(self, stream: FileIO) -> None:
        self._descriptor = os.dup(stream.fileno())
        self._stopped = threading.Event()
        self.fault: OSError | None = None
        self._thread = threading.Thread(target=self._run, name="recording-sync", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        if not self._stopped.is_set():
            self._stopped.set()
            self._thread.join()
            os.close(self._descriptor)

    def _run(self) -> None:
        while not self._stopped.wait(SYNC_SECONDS):
            try:
                os.fsync(self._descriptor)
            except OSError as fault:
                self.fault = fault
                return
