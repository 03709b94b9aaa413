"""How each device is doing, by what came and by its own counter."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from typing import Literal

from evaluation.device_clock import DeviceClock
from evaluation.sources.stream import Item, MarkerFrame, PlateSamples, SourceEvent, SourceInfo

State = Literal["waiting", "ok", "silent", "lost", "fault", "ended"]

SILENT_S = 0.5
"""A device that should send and does not for so long is shown as silent [s]."""

FIT_S = 2.0
"""How often the clock is fitted while somebody looks [s]."""

_RATE_WINDOW_S = 1.0


@dataclass(frozen=True)
class DeviceHealth:
    """One device at one instant.

    Attributes:
        name: The source's name.
        device: How the device calls itself.
        state: ``ok``; ``waiting`` for its first answer; ``silent`` while connected; ``lost`` connection;
            ``fault`` that needs a person; ``ended`` for a replay that is over.
        text: What happened last, in a sentence.
        rate_hz: Marker frames per second, of a plate alone its samples [Hz].
        frames: Marker frames received.
        samples: Plate samples received.
        lost: Frames and samples missing by the device's counter.
        drift_ppm: How much faster than this computer's its clock runs [ppm]; ``None`` while unknown.
        drift_error_ppm: Standard error of that [ppm].
    """

    name: str
    device: str
    state: State
    text: str
    rate_hz: float
    frames: int
    samples: int
    lost: int
    drift_ppm: float | None
    drift_error_ppm: float | None


class HealthWatch:
    """Follows one source; filled by the thread that reads it, looked at by any.

    Args:
        name: The source's name.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._device = name
        self._state: State = "waiting"
        self._text = "connecting"
        self._frames = self._samples = self._lost = 0
        self._heard_ns = 0
        self._window: deque[tuple[int, int]] = deque(maxlen=4096)
        self._quiet = False
        self._clock = DeviceClock()
        self._fitted_ns = 0
        self._drift: tuple[float, float] | tuple[None, None] = (None, None)

    def add(self, item: Item) -> None:
        """Take an item of the source."""
        self._clock.add(item)
        match item:
            case MarkerFrame():
                self._frames += 1
                self._hear(item.host_time_ns)
            case PlateSamples():
                self._samples += len(item.values)
                self._hear(item.host_time_ns)
            case SourceInfo():
                self._device = item.device
                self._quiet = not item.rate_hz and not item.plates
            case SourceEvent():
                self._happen(item)

    def fail(self, state: State, text: str) -> None:
        """Note that the source cannot be read.

        Args:
            state: What that means.
            text: Why.
        """
        self._state, self._text = state, text

    def give_up(self, text: str) -> None:
        """Note that nobody reads the source any more, unless the reason is known already.

        Args:
            text: What happened.
        """
        if self._state not in ("fault", "ended"):
            self.fail("fault", text)

    def look(self, now_ns: int) -> DeviceHealth:
        """The device now.

        Args:
            now_ns: ``time.monotonic_ns()``.
        """
        state, text = self._state, self._text
        silence = 1e-9 * (now_ns - self._heard_ns)
        if state == "ok" and not self._quiet and silence > SILENT_S:
            state, text = "silent", f"nothing for {silence:.1f} s"
        if now_ns - self._fitted_ns > 1e9 * FIT_S:
            fit = self._clock.fit()
            self._drift = (None, None) if fit is None else (fit.drift_ppm, fit.standard_error_ppm)
            self._fitted_ns = now_ns
        return DeviceHealth(
            self._name, self._device, state, text, self._rate(now_ns),
            self._frames, self._samples, self._lost, *self._drift,
        )  # fmt: skip

    def _hear(self, host_time_ns: int) -> None:
        self._heard_ns = host_time_ns
        self._window.append((host_time_ns, self._frames or self._samples))
        if self._state in ("waiting", "lost"):
            self._state, self._text = "ok", "connected"

    def _happen(self, event: SourceEvent) -> None:
        self._lost += event.lost
        match event.kind:
            case "connected":
                self._state, self._heard_ns = "ok", time.monotonic_ns()
            case "disconnected":
                self._state = "lost"
                self._window.clear()
            case "ended":
                self._state = "ended"
        if event.kind != "info":
            self._text = event.text

    def _rate(self, now_ns: int) -> float:
        recent = [entry for entry in self._window.copy() if now_ns - entry[0] < _RATE_WINDOW_S * 1e9]
        if len(recent) < 2 or recent[-1][0] == recent[0][0]:
            return 0.0
        return 1e9 * (recent[-1][1] - recent[0][1]) / (recent[-1][0] - recent[0][0])
