"""The clock of one device against this computer's, from everything that the device sends."""

from __future__ import annotations

from evaluation.clocks import ClockFit, ClockTracker
from evaluation.sources.stream import Item, MarkerFrame, PlateSamples, SourceEvent

LARGEST_PPM = 10_000.0
"""What drifts more is no clock, but a replay at another speed."""

BACKWARDS_S = 0.5
"""A time that lies so far before the last one belongs to a device that began anew [s]."""


class DeviceClock:
    """Follows the clock of one source; markers and plates of one device share it.

    It begins again where the device started anew, where the line was connected again, and where the device's
    time runs backwards.
    """

    def __init__(self) -> None:
        self._tracker = ClockTracker()
        self._markers = False
        self._last_s = -float("inf")

    def add(self, item: Item) -> None:
        """Take an item of the source."""
        match item:
            case MarkerFrame():
                self._markers = True
                self._arrive(item.device_time_s, item.host_time_ns)
            case PlateSamples() if not self._markers:
                last_s = item.device_time_s + item.period_s * (len(item.values) - 1)
                self._arrive(last_s, item.host_time_ns)
            case SourceEvent(kind="restarted" | "connected"):
                self._restart()

    def fit(self) -> ClockFit | None:
        """The clock as far as known; ``None`` before two seconds, and for what keeps no time at all."""
        found = self._tracker.fit()
        return found if found is not None and abs(found.drift_ppm) <= LARGEST_PPM else None

    def _arrive(self, device_s: float, host_time_ns: int) -> None:
        if device_s < self._last_s - BACKWARDS_S:
            self._restart()
        if device_s > self._last_s:
            self._last_s = device_s
            self._tracker.add(device_s, 1e-9 * host_time_ns)

    def _restart(self) -> None:
        self._tracker.restart()
        self._last_s = -float("inf")
