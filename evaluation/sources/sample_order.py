"""Samples of a serial plate on one axis of numbers and time, although counter and clock wrap and restart.

A sample says two things about its place: a counter of 16 bits and a clock of 32 bits. They must agree with
each other, and the clock must not run ahead of the host. What disagrees is held back until its successor
bears it out: then the device has started anew. A frame that passes the checksum by chance is dropped here.
"""

from __future__ import annotations

from dataclasses import dataclass

from evaluation.sources.serial_frame import Sample

CLOCK_RANGE_US = 1 << 32
COUNTER_RANGE = 1 << 16

AHEAD_S = 0.5
"""How far a device's clock may seem ahead of the host's, against the fastest arrival so far [s]."""

RATE_TOLERANCE = 0.15
"""How far the true rate of a device may be from the one it states."""

_LEAK = 0.01
"""Drift that the record of the fastest arrival allows for; a ceramic resonator keeps 0.005."""


@dataclass(frozen=True)
class Placed:
    """A sample in its place.

    Attributes:
        number: Counter of samples that never wraps.
        device_time_s: The device's clock, unwrapped [s].
        counts: Raw value of every channel.
        host_time_ns: When the sample arrived [ns].
    """

    number: int
    device_time_s: float
    counts: tuple[int, ...]
    host_time_ns: int


@dataclass(frozen=True)
class _Mark:
    """Where the last sample stands; ``clock_us`` is what its device said."""

    sequence: int | None
    clock_us: int
    number: int
    time_s: float
    host_ns: int


class SampleOrder:
    """Numbers and times of the samples of one plate, over interruptions.

    Attributes:
        restarts: How often the device began anew.
        implausible: Samples dropped because nothing bore them out.
    """

    def __init__(self, rate_hz: float) -> None:
        """An order that knows no sample yet.

        Args:
            rate_hz: Samples per second as the device states it [Hz].
        """
        self.restarts = 0
        self.implausible = 0
        self._rate = rate_hz
        self._last: _Mark | None = None
        self._held: tuple[Sample, int] | None = None
        self._fastest_s = 0.0
        self._reopened = False

    def reopen(self) -> None:
        """The line was closed and opened again: nothing that comes now is old."""
        self._held = None
        self._reopened = True

    def place(self, sample: Sample, host_time_ns: int) -> list[Placed]:
        """The sample in its place, and before it the one that it bears out.

        Args:
            sample: The next sample of the line.
            host_time_ns: When it arrived [ns].
        """
        if self._last is not None and (mark := self._successor(self._last, sample, host_time_ns)):
            self.implausible += self._held is not None
            self._held = None
            return [self._accept(mark, sample)]
        held, self._held = self._held, (sample, host_time_ns)
        if held is None:
            return []
        first = self._beginning(*held)
        second = self._step(first, sample, host_time_ns)
        if second is None or _seems_ahead(first, second):
            self.implausible += 1
            return []
        self.restarts += self._last is not None
        self._held = None
        self._fastest_s = 1e-9 * first.host_ns - first.time_s
        return [self._accept(first, held[0]), self._accept(second, sample)]

    def time_of(self, clock_us: int) -> float:
        """Unwrapped time of an instant near the last sample [s]; NaN before the first one.

        Args:
            clock_us: The device's clock [us].
        """
        if self._last is None:
            return float("nan")
        half = CLOCK_RANGE_US // 2
        return self._last.time_s + 1e-6 * ((clock_us - self._last.clock_us + half) % CLOCK_RANGE_US - half)

    def _accept(self, mark: _Mark, sample: Sample) -> Placed:
        elapsed = 0.0 if self._last is None else 1e-9 * (mark.host_ns - self._last.host_ns)
        self._fastest_s = min(self._fastest_s + _LEAK * elapsed, 1e-9 * mark.host_ns - mark.time_s)
        self._last, self._reopened = mark, False
        return Placed(mark.number, mark.time_s, sample.counts, mark.host_ns)

    def _successor(self, last: _Mark, sample: Sample, host_ns: int) -> _Mark | None:
        """Place of a sample after the last one; ``None`` if counter, clock and host do not agree."""
        mark = self._step(last, sample, host_ns)
        if mark is None:
            return None
        late_s = 1e-9 * host_ns - mark.time_s - self._fastest_s
        slack = AHEAD_S + _LEAK * 1e-9 * (host_ns - last.host_ns)
        if late_s < -slack or (self._reopened and late_s > slack):
            return None
        return mark

    def _step(self, last: _Mark, sample: Sample, host_ns: int) -> _Mark | None:
        """Place of a sample from the one before; ``None`` if counter and clock do not agree."""
        seconds = 1e-6 * ((sample.microseconds - last.clock_us) % CLOCK_RANGE_US)
        step = round(seconds * self._rate)
        if sample.sequence is None or last.sequence is None:
            step = max(step, 1)
        else:
            half = COUNTER_RANGE // 2
            excess = (sample.sequence - last.sequence - step + half) % COUNTER_RANGE - half
            if abs(excess) > 2 + min(RATE_TOLERANCE * step, COUNTER_RANGE // 4) or step + excess < 1:
                return None
            step += excess
        return _Mark(sample.sequence, sample.microseconds, last.number + step, last.time_s + seconds, host_ns)

    def _beginning(self, sample: Sample, host_ns: int) -> _Mark:
        """Place of the first sample, or of the first after a restart: where the host's clock puts it."""
        if self._last is None:
            return _Mark(
                sample.sequence,
                sample.microseconds,
                sample.sequence or 0,
                1e-6 * sample.microseconds,
                host_ns,
            )
        step = max(1, round(1e-9 * (host_ns - self._last.host_ns) * self._rate))
        return _Mark(
            sample.sequence,
            sample.microseconds,
            self._last.number + step,
            self._last.time_s + step / self._rate,
            host_ns,
        )


def _seems_ahead(first: _Mark, second: _Mark) -> bool:
    """More time has passed on the device than on the host, and more than a late arrival explains."""
    host_s = 1e-9 * (second.host_ns - first.host_ns)
    return second.time_s - first.time_s > (1 + _LEAK) * host_s + AHEAD_S
