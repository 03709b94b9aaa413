"""Samples lost by a device that does not count them, from the times at which the others arrive.

Sample k leaves the device at k periods and arrives later, never earlier. Host time less k periods therefore
has a floor, which moves only slowly with the device's clock. A lost sample raises the floor by a whole period
for good; a busy computer delays some samples, and the floor comes back. What this yields is an estimate, and
is reported as one: of two losses less than half a second apart it knows the sum only.
"""

from __future__ import annotations

import math

WINDOW_S = 0.25
"""The floor is the least of each window of this length [s]."""

JUMP = 0.6
"""A rise of the floor by more than this part of a period is a loss."""


class ArrivalModel:
    """The floor of arrival times, and its jumps.

    Attributes:
        lost: Samples that seem to be missing so far.
    """

    def __init__(self, period_s: float) -> None:
        """A model that has seen no sample.

        Args:
            period_s: Nominal time between samples [s].
        """
        self.lost = 0
        self._period = period_s
        self._count = 0
        self._floor = math.nan
        self._slope = 0.0
        self._window_start = math.nan
        self._least = math.inf
        self._suspected = 0

    @property
    def place(self) -> int:
        """Place of the next sample among those that the device has sent, as far as known."""
        return self._count + self.lost

    def skip(self, samples: int) -> None:
        """Samples are known to be missing here, as their remains were seen.

        Args:
            samples: How many.
        """
        self.lost += samples

    def arrive(self, samples: int, host_s: float) -> int:
        """Samples arrived; returns how many seem to have been lost before, which is seen half a second later.

        Args:
            samples: How many came together.
            host_s: When [s].
        """
        self._count += samples
        self._least = min(self._least, host_s - (self.place - 1) * self._period)
        if math.isnan(self._window_start):
            self._window_start = host_s
        if host_s - self._window_start < WINDOW_S:
            return 0
        return self._close_window(host_s)

    def _close_window(self, host_s: float) -> int:
        least, length = self._least, host_s - self._window_start
        self._window_start, self._least = host_s, math.inf
        if math.isnan(self._floor):
            self._floor = least
            return 0
        rise = least - self._floor - self._slope * length
        jump = round(rise / self._period) if rise > JUMP * self._period else 0
        if jump == 0:
            self._suspected = 0
            self._follow(least, length)
            return 0
        if jump != self._suspected:
            self._suspected = jump
            return 0
        self._suspected = 0
        self.lost += jump
        return jump

    def _follow(self, least: float, length: float) -> None:
        """Let the floor move with the device's clock, slowly enough that noise does not."""
        moved = (least - self._floor) / length
        largest = 0.1 * self._period / WINDOW_S
        self._slope += 0.1 * (min(max(moved, -largest), largest) - self._slope)
        self._floor = least
