"""One thread per device, and one that records: nothing that a screen does can hold them up.

What a device sends goes into two bounded queues, one for the recorder and one for the analysis. A queue that
is full drops the newest items and counts them; the recorder writes the count into the recording.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evaluation.live.health import DeviceHealth, HealthWatch
from evaluation.live.mailbox import Mailbox
from evaluation.record.messages import MarkKind
from evaluation.record.recorder import Recorder, Written
from evaluation.sources.reconnecting import Reconnecting
from evaluation.sources.stream import (
    Item,
    LabError,
    Source,
    SourceEvent,
    SourceInfo,
)
from hilbrace.errors import HilbraceError, InputError

READ_S = 0.1
"""Longest time that a reading thread waits for news, and so for an order to stop [s]."""

IDLE_S = 0.005
"""Longest wait of the recording thread, which looks after its chunk meanwhile [s]."""

WAITING_BLOCKS = 20_000
"""Blocks that a queue holds: more than a minute of a device that sends 200 times a second."""


@dataclass
class Answer:
    """What became of an order to the recorder.

    Attributes:
        done: Set as soon as it was carried out.
        written: The recording it concerned.
        fault: Why it could not be carried out.
    """

    done: threading.Event = field(default_factory=threading.Event)
    written: Written | None = None
    fault: HilbraceError | None = None

    def wait(self, timeout_s: float = 10.0) -> Written:
        """The recording, once the order was carried out.

        Raises:
            HilbraceError: It could not be carried out, or not in time.
        """
        if not self.done.wait(timeout_s):
            raise LabError(
                "the recorder does not answer", where="recorder", hint="check the disk; stop and start again"
            )
        if self.fault is not None:
            raise self.fault
        if self.written is None:
            raise InputError("nothing is being recorded", where="recorder", hint="start a recording first")
        return self.written


@dataclass(frozen=True)
class Begin:
    """Order to start a recording."""

    path: Path
    content: dict[str, Any]
    answer: Answer


@dataclass(frozen=True)
class Note:
    """Order to write a mark into the recording."""

    kind: MarkKind
    text: str
    content: dict[str, Any]


@dataclass(frozen=True)
class End:
    """Order to finish the recording."""

    answer: Answer


Entry = Item | Begin | Note | End


class RecordingThread:
    """The thread that owns the recorder."""

    def __init__(self) -> None:
        self.mailbox: Mailbox[Entry] = Mailbox(WAITING_BLOCKS)
        self._infos: dict[str, SourceInfo] = {}
        self._recorder: Recorder | None = None
        self._reported = 0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self.fault = ""
        self.written: Written | None = None

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def stop(self) -> None:
        """Finish the recording, if there is one, and the thread."""
        answer = Answer()
        self.mailbox.order(End(answer))
        answer.done.wait(10.0)
        self._stopped.set()
        self._thread.join(10.0)

    @property
    def recording(self) -> bool:
        """Whether a file is open."""
        return self._recorder is not None

    def _run(self) -> None:
        try:
            while not self._stopped.is_set():
                for entry in self.mailbox.take(IDLE_S):
                    self._handle(entry)
                if self._recorder is not None:
                    self._guard(self._care)
        finally:
            if not self._stopped.is_set():
                self.fault = "the thread that records has ended"

    def _handle(self, entry: Entry) -> None:
        match entry:
            case Begin():
                self._begin(entry)
            case End():
                self._end(entry.answer)
            case Note():
                if self._recorder is not None:
                    recorder = self._recorder
                    self._guard(lambda: recorder.mark(entry.kind, entry.text, entry.content))
            case _:
                if isinstance(entry, SourceInfo):
                    self._infos[entry.source] = entry
                if self._recorder is not None:
                    recorder = self._recorder
                    self._guard(lambda: recorder.add(entry))

    def _begin(self, order: Begin) -> None:
        if self._recorder is not None:
            order.answer.fault = InputError(
                "a recording is running", where=str(self._recorder.path), hint="stop it first"
            )
        else:
            try:
                self._recorder = Recorder(order.path, tuple(self._infos.values()), order.content)
            except InputError as fault:
                order.answer.fault = fault
            else:
                self.fault, self._reported = "", self.mailbox.dropped
                self.written = order.answer.written = self._recorder.written()
        order.answer.done.set()

    def _end(self, answer: Answer) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            try:
                self._care_for(recorder)
                self.written = answer.written = recorder.close()
            except OSError as fault:
                answer.fault = _disk_fault(fault, recorder.path)
                self.fault = answer.fault.what
        elif self.fault and self.written is not None:
            answer.fault = InputError(
                self.fault, where=str(self.written.path), hint="hilbrace evaluate recover reads what is there"
            )
        answer.done.set()

    def _care(self) -> None:
        if self._recorder is not None:
            self._care_for(self._recorder)
            self._recorder.tick()
            self.written = self._recorder.written()

    def _care_for(self, recorder: Recorder) -> None:
        """Write into the recording how many items the queue had to drop."""
        dropped = self.mailbox.dropped
        if dropped > self._reported:
            count = dropped - self._reported
            text = f"The recorder could not keep up: {count} items are missing."
            recorder.mark("lost", text, {"items": count})
            self._reported = dropped

    def _guard(self, action: Any) -> None:
        """Give the recording up if the disk does not take it."""
        try:
            action()
        except OSError as fault:
            if self._recorder is not None:
                self.fault = _disk_fault(fault, self._recorder.path).what
                self._recorder.abandon()
                self._recorder = None


def _disk_fault(fault: OSError, path: Path) -> InputError:
    return InputError(
        f"the disk no longer takes the recording: {fault.strerror}",
        where=str(path),
        hint="make room, then record again; hilbrace evaluate recover reads what was written",
    )


class Acquisition:
    """Reads devices into the queues of recorder and analysis.

    Args:
        sources: The devices; each is reconnected when it breaks off.
        analyse: Whether somebody empties `analysis`.
    """

    def __init__(self, sources: Sequence[Source], analyse: bool) -> None:
        names = [source.name for source in sources]
        repeated = [name for name in names if names.count(name) > 1]
        if repeated:
            raise InputError(
                f"two devices are called '{repeated[0]}'",
                where="devices",
                hint="give one of them another name",
            )
        self.recorder = RecordingThread()
        self.analysis: Mailbox[Item] = Mailbox(WAITING_BLOCKS)
        self._analyse = analyse
        self._stopped = threading.Event()
        self._watches = {name: HealthWatch(name) for name in names}
        self._sources = [Reconnecting(source) for source in sources]
        self._threads = [
            threading.Thread(target=self._read, args=(source,), name=f"read-{source.name}", daemon=True)
            for source in self._sources
        ]
        self._opened: set[str] = set()

    def connect(self) -> tuple[SourceInfo, ...]:
        """Connect to every device, or say which one does not answer.

        Raises:
            LabError: A device does not answer.
            InputError: Its address or settings cannot work.
        """
        infos = []
        try:
            for source in self._sources:
                infos.append(source.open())
                self._opened.add(source.name)
                self._pass_on(source.name, [infos[-1]])
        except HilbraceError:
            for source in self._sources:
                source.close()
            raise
        return tuple(infos)

    def start(self) -> None:
        """Begin to read; devices that are not connected yet are tried until they answer."""
        self.recorder.start()
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Stop reading, finish the recording, and let the devices go."""
        self._stopped.set()
        for thread in self._threads:
            thread.join(10.0)
        self.recorder.stop()

    def health(self) -> tuple[DeviceHealth, ...]:
        """How the devices are doing."""
        now = time.monotonic_ns()
        return tuple(watch.look(now) for watch in self._watches.values())

    def _read(self, source: Reconnecting) -> None:
        watch = self._watches[source.name]
        try:
            if source.name not in self._opened:
                self._open_late(source, watch)
            while not self._stopped.is_set():
                self._pass_on(source.name, source.read(READ_S))
        except HilbraceError as fault:
            self._pass_on(source.name, [_fault_event(source.name, fault)])
            watch.fail("fault", f"{fault.what}; {fault.hint}")
        finally:
            if not self._stopped.is_set():
                watch.give_up("the thread that reads it has ended")
            source.close()

    def _open_late(self, source: Reconnecting, watch: HealthWatch) -> None:
        try:
            self._pass_on(source.name, [source.open()])
        except LabError as fault:
            watch.fail("waiting", f"{fault.what}; {fault.hint}")

    def _pass_on(self, name: str, items: list[Item]) -> None:
        if not items:
            return
        watch = self._watches[name]
        for item in items:
            watch.add(item)
        self.recorder.mailbox.offer(list(items))
        if self._analyse:
            self.analysis.offer(items)


def _fault_event(source: str, fault: HilbraceError) -> SourceEvent:
    return SourceEvent(source, "fault", time.monotonic_ns(), float("nan"), fault.what)
