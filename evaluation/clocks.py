"""A device's clock against the host's: its drift and offset, from the times at which its samples arrive.

A sample arrives later than it was taken, by a delay that varies and is never negative. The fastest arrivals
tell the truth best: host time less device time has a floor, and the floor's slope is the drift. An ordinary
regression follows the delays instead, of which a busy computer makes many.

The line that touches the floor goes back to Moon, Skelly & Towsley 1999, Estimation and removal of clock skew
from network delay measurements, IEEE INFOCOM. Here it says which of the windows' fastest arrivals were really
fast, and these are then fitted by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError

Array = np.ndarray

WINDOW_S = 0.25
"""The fastest arrival of each window of this length counts [s]."""

FEWEST_WINDOWS = 8

LONGEST_S = 600.0
"""Clocks wander with temperature: a tracker looks back this far [s]."""

_FAST = 2.0
"""A window's delay may be this many times the median delay above the floor."""

_ROUNDS = 10


@dataclass(frozen=True)
class ClockFit:
    """How a device's clock maps to the host's.

    The delay of the fastest arrival cannot be told from an offset, and is part of `offset_s`.

    Attributes:
        offset_s: Host time less device time at `reference_s` [s].
        reference_s: The device's time to which the offset belongs [s].
        drift_ppm: How much faster than the host's the device's clock runs [ppm].
        standard_error_ppm: Standard error of the drift [ppm].
        residual_s: Standard deviation of the fast arrivals about the fit [s].
        span_s: Time that the fit rests on [s].
    """

    offset_s: float
    reference_s: float
    drift_ppm: float
    standard_error_ppm: float
    residual_s: float
    span_s: float

    def to_host(self, device_s: Float[Array, "*any"]) -> Float[Array, "*any"]:
        """The host's time at instants of the device [s]."""
        slope = 1.0 / (1.0 + 1e-6 * self.drift_ppm)
        return self.reference_s + self.offset_s + slope * (device_s - self.reference_s)

    def to_device(self, host_s: Float[Array, "*any"]) -> Float[Array, "*any"]:
        """The device's time at instants of the host [s]."""
        return self.reference_s + (host_s - self.reference_s - self.offset_s) * (1.0 + 1e-6 * self.drift_ppm)


class ClockTracker:
    """Collects the fastest arrival of each window while samples come in; keeps no sample."""

    def __init__(self, window_s: float = WINDOW_S, longest_s: float = LONGEST_S) -> None:
        """A tracker that has seen nothing.

        Args:
            window_s: Length of a window [s].
            longest_s: How far it looks back [s].
        """
        self._window_s = window_s
        self._most = max(FEWEST_WINDOWS, round(longest_s / window_s))
        self._fastest: dict[int, tuple[float, float]] = {}

    def add(self, device_s: float, host_s: float) -> None:
        """A sample taken at a device time arrived.

        Args:
            device_s: The device's clock, unwrapped; of several samples that arrive together, the last [s].
            host_s: The host's monotonic clock [s].
        """
        window = int(device_s // self._window_s)
        best = self._fastest.get(window)
        if best is None or host_s - device_s < best[1] - best[0]:
            self._fastest[window] = (device_s, host_s)
        while len(self._fastest) > self._most:
            del self._fastest[next(iter(self._fastest))]

    def restart(self) -> None:
        """Forget everything, as after the device has started anew."""
        self._fastest.clear()

    def fit(self) -> ClockFit | None:
        """The clock as far as known; ``None`` before two seconds of samples."""
        if len(self._fastest) < FEWEST_WINDOWS:
            return None
        device, host = np.array(list(self._fastest.values())).T
        return fit_floor(device, host)


def fit_clock(device_s: Float[Array, " sample"], host_s: Float[Array, " sample"]) -> ClockFit:
    """The clock of a recording.

    Args:
        device_s: The device's clock at each sample, rising [s].
        host_s: When the sample arrived, by the host's monotonic clock [s].

    Raises:
        InputError: The recording is too short.
    """
    tracker = ClockTracker(longest_s=np.inf if len(device_s) < 2 else float(np.ptp(device_s)) + 1.0)
    for device, host in zip(device_s.tolist(), host_s.tolist(), strict=True):
        tracker.add(device, host)
    found = tracker.fit()
    if found is None:
        raise InputError(
            "the recording is too short to compare clocks",
            where=f"{len(device_s)} samples",
            hint=f"record at least {FEWEST_WINDOWS * WINDOW_S:g} s, better ten",
        )
    return found


def fit_floor(device_s: Float[Array, " window"], host_s: Float[Array, " window"]) -> ClockFit:
    """Fit the fastest arrivals of at least three windows; those that were slow do not count.

    Args:
        device_s: The device's clock at the fastest arrival of each window, rising [s].
        host_s: When it arrived [s].
    """
    middle = float(device_s.mean())
    at = device_s - middle
    start = float(host_s[0] - device_s[0])
    offset = (host_s - host_s[0]) - (device_s - device_s[0])
    slope, level = _touching(at, offset)
    used = np.ones(len(at), bool)
    for _ in range(_ROUNDS):
        above = offset - level - slope * at
        above -= above.min()
        fast = above <= _FAST * np.median(above) + 1e-9
        if fast.sum() < 3:
            break
        used = fast
        slope, level = np.polyfit(at[used], offset[used], 1)
    residual = offset[used] - level - slope * at[used]
    sigma = float(np.sqrt((residual**2).sum() / max(1, used.sum() - 2)))
    spread = float(np.sqrt(((at[used] - at[used].mean()) ** 2).sum()))
    return ClockFit(
        offset_s=start + float(level),
        reference_s=middle,
        drift_ppm=1e6 * (1.0 / (1.0 + float(slope)) - 1.0),
        standard_error_ppm=1e6 * sigma / spread,
        residual_s=sigma,
        span_s=float(np.ptp(device_s)),
    )


def _touching(at: Float[Array, " window"], offset: Float[Array, " window"]) -> tuple[float, float]:
    """Slope and level of the line that touches the points from below: an edge of their lower hull."""
    hull: list[int] = []
    for k in range(len(at)):
        while len(hull) > 1 and _is_above(at, offset, hull[-2], hull[-1], k):
            hull.pop()
        hull.append(k)
    right = min(max(int(np.searchsorted(at[hull], 0.0)), 1), len(hull) - 1)
    a, b = hull[right - 1], hull[right]
    slope = float((offset[b] - offset[a]) / (at[b] - at[a]))
    return slope, float(offset[a] - slope * at[a])


def _is_above(at: Float[Array, " window"], offset: Float[Array, " window"], a: int, b: int, c: int) -> bool:
    """Point b lies on or above the line from a to c."""
    rise, run = offset[b] - offset[a], at[b] - at[a]
    return bool(run * (offset[c] - offset[a]) <= rise * (at[c] - at[a]))
