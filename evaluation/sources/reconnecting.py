"""Any source, connected again whenever it breaks off, with its losses counted by the device's own counter."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from evaluation.sources.stream import (
    EventKind,
    Item,
    LabError,
    MarkerFrame,
    PlateSamples,
    Source,
    SourceEvent,
    SourceInfo,
)

BACK_OFF_S = (0.5, 0.5, 1.0)
"""Waits between attempts to connect; the last one repeats. A plug put back is in use within two seconds."""

SILENCE_S = 3.0
"""A source that has nothing for so long counts as broken off, since a pulled cable ends no connection."""


class Reconnecting:
    """A source that outlives its device.

    `open` fails as the source's own does, since a person waits for the answer. From then on a lost connection
    is an event, and `read` tries again, after half a second at first, then every second. What is missing
    follows from the numbers of the frames before and after, and stands in a ``gap`` event before the latter.

    Args:
        source: The source.
        back_off_s: Waits before each further attempt [s]; the last one repeats.
        silence_s: Silence after which the connection is given up [s]; infinity for devices that may be quiet.
    """

    def __init__(
        self, source: Source, back_off_s: Sequence[float] = BACK_OFF_S, silence_s: float = SILENCE_S
    ) -> None:
        self._source = source
        self._back_off = tuple(back_off_s)
        self._silence = silence_s
        self._connected = False
        self._ended = False
        self._attempt = 0
        self._next_attempt = 0.0
        self._heard = 0.0
        self._expected: dict[str, int] = {}
        self._waiting: list[Item] = []

    @property
    def name(self) -> str:
        """Name of the source."""
        return self._source.name

    def open(self) -> SourceInfo:
        """Connect for the first time.

        Raises:
            LabError: The device does not answer.
            InputError: The settings cannot work.
        """
        info = self._source.open()
        self._expected, self._waiting, self._ended = {}, [], False
        self._arrive(f"{info.device} is connected")
        return info

    def read(self, timeout_s: float) -> list[Item]:
        """Items in their order, with events about the connection and the losses among them.

        Args:
            timeout_s: Longest wait [s]; an attempt to connect may take as long as the source's `open`.
        """
        waiting, self._waiting = self._waiting, []
        if waiting:
            return waiting
        if self._ended:
            time.sleep(timeout_s)
            return []
        return self._listen(timeout_s) if self._connected else self._retry(timeout_s)

    def close(self) -> None:
        """Let the device go."""
        self._connected = False
        self._source.close()

    def _listen(self, timeout_s: float) -> list[Item]:
        try:
            items = self._source.read(timeout_s)
        except LabError as fault:
            return [self._leave(fault.what)]
        now = time.monotonic()
        if items:
            self._heard = now
        elif now - self._heard > self._silence:
            return [self._leave(f"nothing came for {self._silence:g} s")]
        return [counted for item in items for counted in self._count(item)]

    def _retry(self, timeout_s: float) -> list[Item]:
        delay = self._next_attempt - time.monotonic()
        time.sleep(max(0.0, min(delay, timeout_s)))
        if delay > timeout_s:
            return []
        try:
            info = self._source.open()
        except LabError:
            self._attempt += 1
            self._schedule()
            return []
        self._arrive(f"{info.device} is connected again")
        items, self._waiting = [*self._waiting, info], []
        return items

    def _arrive(self, text: str) -> None:
        self._connected, self._attempt, self._heard = True, 0, time.monotonic()
        self._waiting.append(self._event("connected", text))

    def _leave(self, why: str) -> SourceEvent:
        self._source.close()
        self._connected, self._attempt = False, 0
        self._schedule()
        return self._event("disconnected", why)

    def _schedule(self) -> None:
        wait = self._back_off[min(self._attempt, len(self._back_off) - 1)]
        self._next_attempt = time.monotonic() + wait

    def _count(self, item: Item) -> list[Item]:
        """The item, and before it what the device's counter says about its forerunners."""
        if isinstance(item, SourceEvent):
            self._ended = self._ended or item.kind == "ended"
            return [item]
        if isinstance(item, SourceInfo):
            return [item]
        plate = item.plate if isinstance(item, PlateSamples) else ""
        expected = self._expected.get(plate, item.number)
        self._expected[plate] = item.number + (1 if isinstance(item, MarkerFrame) else len(item.values))
        if item.number == expected:
            return [item]
        return [self._gap(item, item.number - expected, plate), item]

    def _gap(self, item: MarkerFrame | PlateSamples, lost: int, plate: str) -> SourceEvent:
        what = f"samples of plate '{plate}'" if plate else "frames"
        text = (
            f"{lost} {what} are missing before number {item.number}"
            if lost > 0
            else f"the counter of the {what} began again at {item.number}: what is missing is unknown"
        )
        return SourceEvent(
            self.name, "gap", item.host_time_ns, item.device_time_s, text, lost=max(lost, 0), plate=plate
        )

    def _event(self, kind: EventKind, text: str) -> SourceEvent:
        return SourceEvent(self.name, kind, time.monotonic_ns(), math.nan, text)
