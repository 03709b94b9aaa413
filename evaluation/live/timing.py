"""How long angles take from the last byte of a frame to the screen's numbers, in constant memory."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int

Array = np.ndarray

LATEST = 1000
"""Delays that count as recent: five seconds at 200 Hz."""

BIN_MS = 0.05
BINS = 4000
"""Bins of 0.05 ms up to 0.2 s; the last one holds whatever took longer."""


@dataclass
class Latency:
    """A histogram of delays.

    Attributes:
        counts: Delays in each bin.
        largest_ms: The longest delay [ms].
        latest: The last delays, a few seconds of them [ms].
    """

    counts: Int[Array, " bin"] = field(default_factory=lambda: np.zeros(BINS, int))
    largest_ms: float = 0.0
    latest: deque[float] = field(default_factory=lambda: deque(maxlen=LATEST))

    def add(self, delay_ms: float) -> None:
        """Count a delay [ms]."""
        self.counts[min(int(delay_ms / BIN_MS), BINS - 1)] += 1
        self.largest_ms = max(self.largest_ms, delay_ms)
        self.latest.append(delay_ms)

    def recent(self, percent: float) -> float:
        """Delay that a share of the last delays stays below [ms]; NaN before the first."""
        latest = sorted(self.latest.copy())
        return latest[min(int(percent / 100 * len(latest)), len(latest) - 1)] if latest else float("nan")

    def percentile(self, percent: float) -> float:
        """Delay that a share of all delays stays below [ms]; NaN before the first."""
        total = int(self.counts.sum())
        if not total:
            return float("nan")
        place = int(np.searchsorted(np.cumsum(self.counts), percent / 100 * total))
        return min((place + 1) * BIN_MS, self.largest_ms)
