"""Flexion peaks while they happen, and which of them are the bending and the landing."""

from __future__ import annotations

from dataclasses import dataclass, field

from evaluation.events import (
    APART_SECONDS,
    LONGEST_FLIGHT_S,
    PROMINENCE_DEG,
    SHORTEST_FLIGHT_S,
    UNLOADED_N,
)


@dataclass(frozen=True)
class Peak:
    """One flexion peak.

    Attributes:
        time_s: When [s].
        flexion_deg: Flexion, positive [deg].
        adduction_deg: Adduction at that instant [deg].
    """

    time_s: float
    flexion_deg: float
    adduction_deg: float


@dataclass
class PeakWatch:
    """Finds flexion peaks that stand out by 15 degrees on both sides, as soon as the knee has extended again.

    Attributes:
        peaks: The peaks so far, in order.
        highest: The deepest flexion since the watch began, whether a peak yet or not.
    """

    peaks: list[Peak] = field(default_factory=list)
    highest: Peak | None = None
    _lowest_deg: float = float("inf")
    _rising: Peak | None = None

    def add(self, time_s: float, flexion_deg: float, adduction_deg: float) -> None:
        """Take the angles of one frame.

        Args:
            time_s: Instant [s].
            flexion_deg: Flexion, positive [deg]; NaN is passed over.
            adduction_deg: Adduction [deg].
        """
        if not flexion_deg == flexion_deg:
            return
        here = Peak(time_s, flexion_deg, adduction_deg)
        if self.highest is None or flexion_deg > self.highest.flexion_deg:
            self.highest = here
        if self._rising is None:
            self._lowest_deg = min(self._lowest_deg, flexion_deg)
            if flexion_deg - self._lowest_deg >= PROMINENCE_DEG:
                self._rising = here
        elif flexion_deg > self._rising.flexion_deg:
            self._rising = here
        elif self._rising.flexion_deg - flexion_deg >= PROMINENCE_DEG:
            self._confirm(self._rising)
            self._rising, self._lowest_deg = None, flexion_deg

    def _confirm(self, peak: Peak) -> None:
        if self.peaks and peak.time_s - self.peaks[-1].time_s < APART_SECONDS:
            self.peaks[-1] = max(self.peaks[-1], peak, key=lambda one: one.flexion_deg)
        else:
            self.peaks.append(peak)


@dataclass
class FlightWatch:
    """Finds the longest time without load between two with load, as soon as the foot is back.

    Attributes:
        flight: Take-off and touch-down [s]; ``None`` before the first.
    """

    flight: tuple[float, float] | None = None
    _loaded: bool | None = None
    _left_s: float = float("nan")

    def add(self, time_s: float, vertical_n: float) -> None:
        """Take the vertical force on all plates at one instant.

        Args:
            time_s: Instant, on the markers' clock [s].
            vertical_n: Vertical force of the ground on the subject [N].
        """
        loaded = vertical_n >= UNLOADED_N
        if loaded and self._loaded is False:
            length = time_s - self._left_s
            known = 0.0 if self.flight is None else self.flight[1] - self.flight[0]
            if SHORTEST_FLIGHT_S <= length <= LONGEST_FLIGHT_S and length > known:
                self.flight = (self._left_s, time_s)
        elif not loaded and self._loaded:
            self._left_s = time_s
        self._loaded = loaded


def bending_and_landing(
    peaks: list[Peak], flight: tuple[float, float] | None
) -> tuple[Peak | None, Peak | None]:
    """The deepest peak before the flight and the first after it; without a flight the first two peaks.

    Args:
        peaks: Peaks in order.
        flight: Take-off and touch-down [s].
    """
    if flight is None:
        return (peaks[0] if peaks else None), (peaks[1] if len(peaks) > 1 else None)
    before = [peak for peak in peaks if peak.time_s <= flight[0]]
    after = [peak for peak in peaks if peak.time_s > flight[1]]
    bending = max(before, key=lambda peak: peak.flexion_deg) if before else None
    return bending, (after[0] if after else None)
