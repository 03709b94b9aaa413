"""Faults that any mock device shows on request: what happens in laboratories, at a chosen rate and seed.

A mock asks `Pace` when its next frame is due (drift, jitter and stalls act there), and `Injector` whether the
frame is sent, with which bytes, and whether the line breaks now.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Faults:
    """What goes wrong.

    Attributes:
        drop: Probability that a frame is not sent; the device's counter goes on.
        corrupt: Probability of each byte to be replaced by another.
        jitter_ms: Largest delay of a frame, uniformly distributed [ms]; the order is kept.
        drift_ppm: How much faster than nominal the device's clock runs [ppm].
        stall: Instant and length of a silence after which everything held back comes at once [s].
        disconnect_at: Instants at which the line breaks [s].
        seed: Seed of all draws.
    """

    drop: float = 0.0
    corrupt: float = 0.0
    jitter_ms: float = 0.0
    drift_ppm: float = 0.0
    stall: tuple[float, float] | None = None
    disconnect_at: tuple[float, ...] = ()
    seed: int = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add one option per fault; all times count from the start of the mock."""
    group = parser.add_argument_group("faults")
    group.add_argument("--drop", type=float, default=0.0, metavar="P", help="probability of losing a frame")
    group.add_argument("--corrupt", type=float, default=0.0, metavar="P", help="probability of a wrong byte")
    group.add_argument("--jitter", type=float, default=0.0, metavar="MS", help="largest delay of a frame")
    group.add_argument("--drift-ppm", type=float, default=0.0, metavar="PPM", help="how fast the clock runs")
    group.add_argument(
        "--stall", type=float, nargs=2, metavar=("AT_S", "FOR_S"), help="silence, then a burst"
    )
    group.add_argument("--disconnect-at", type=float, action="append", default=[], metavar="S",
                       help="break the line at this time; may be given again")  # fmt: skip
    group.add_argument("--seed", type=int, default=0, help="seed of the faults")


def from_options(options: argparse.Namespace) -> Faults:
    """Faults that the command line asks for."""
    return Faults(
        options.drop,
        options.corrupt,
        options.jitter,
        options.drift_ppm,
        tuple(options.stall) if options.stall else None,
        tuple(sorted(options.disconnect_at)),
        options.seed,
    )


class Pace:
    """When frames are due, on the device's own clock."""

    def __init__(self, rate_hz: float, faults: Faults, start: float | None = None) -> None:
        self._period = 1.0 / (rate_hz * (1.0 + 1e-6 * faults.drift_ppm))
        self._faults = faults
        self._rng = np.random.default_rng([faults.seed, 1])
        self.start = time.monotonic() if start is None else start

    def elapsed(self) -> float:
        """Time since the start [s]."""
        return time.monotonic() - self.start

    def due(self, number: int) -> float:
        """Time of a frame from the start [s], without jitter."""
        moment = number * self._period
        if self._faults.stall:
            at, length = self._faults.stall
            moment = at + length if at <= moment < at + length else moment
        return moment

    def current(self) -> int:
        """Number of the frame that was due last."""
        return max(0, int(self.elapsed() / self._period))

    def wait(self, number: int) -> None:
        """Sleep until a frame is due."""
        moment = self.due(number)
        if self._faults.jitter_ms:
            moment += 1e-3 * self._faults.jitter_ms * self._rng.random()
        delay = self.start + moment - time.monotonic()
        if delay > 0:
            time.sleep(delay)


@dataclass
class Injector:
    """Damage to single frames, and a tally of it."""

    faults: Faults
    dropped: int = 0
    damaged_bytes: int = 0
    _broken: int = 0
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.faults.seed, 2])

    def drops(self) -> bool:
        """The next frame is lost."""
        lost = self.faults.drop > 0 and bool(self._rng.random() < self.faults.drop)
        self.dropped += lost
        return lost

    def corrupted(self, data: bytes) -> bytes:
        """The bytes as they arrive; the same object if none is wrong."""
        if not self.faults.corrupt:
            return data
        wrong = np.flatnonzero(self._rng.random(len(data)) < self.faults.corrupt)
        if not len(wrong):
            return data
        self.damaged_bytes += len(wrong)
        content = np.frombuffer(data, np.uint8).copy()
        content[wrong] ^= self._rng.integers(1, 256, len(wrong), dtype=np.uint8)
        return content.tobytes()

    def breaks(self, elapsed_s: float) -> bool:
        """The line breaks now; true once for each instant of `Faults.disconnect_at`."""
        due = sum(at <= elapsed_s for at in self.faults.disconnect_at)
        if due > self._broken:
            self._broken = due
            return True
        return False
