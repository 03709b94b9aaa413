"""What mock plates measure: the load of the synthetic study, or numbers that name a sample.

The 6 x 12 matrix of the AMTI plate is the one of the unit test of Open3DMotion (AccuSway-076), whose readings
and centre of pressure are known: force in N, moment in N*mm. The self-built plate has eight piezoelectric
channels in the order of C3D's plate type 3.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

AMTI_MATRIX = np.array(
    [
        [0.046261488, 0, 0.000444822, -0.048485598, 0.003113754, -0.000444822,
         0.043592556, 0.002668932, 0.001334466, -0.044927022, -0.000889644, -0.001334466],
        [0.000444822, 0.044927022, -0.00222411, -0.004893042, 0.051599352, -0.000444822,
         -0.000889644, -0.045371844, 0, -0.003113754, -0.041813268, 0],
        [-0.007561974, -0.01112055, -0.282017148, -0.005337864, -0.005782686, -0.274010352,
         -0.011565372, -0.004003398, -0.278458572, -0.007561974, -0.003113754, -0.283796436],
        [0, 0, -52.402443, 0, 0, -49.284057, 0, 0, 51.249996, 0, 0, 52.831786],
        [0, 0, 50.142743, 0, 0, -49.7472955, 0, 0, 50.187937, 0, 0, -50.346116],
        [-12.3718575, 11.9425145, 0, 12.970678, -13.7954685, 0,
         11.592261, -12.1458875, 0, -11.9425145, 11.1968135, 0],
    ]
)  # fmt: skip
"""Load on the plate per count, N and N*mm."""

AMTI_DEPTH_MM = 20.0

CHANNELS = ("fx12", "fx34", "fy14", "fy23", "fz1", "fz2", "fz3", "fz4")
"""Channels of the self-built plate: sums of the shear of two cells, vertical force of each."""

HALF_X_M, HALF_Y_M = 0.25, 0.15
COUNTS_PER_NEWTON = 200.0


def built_matrix() -> np.ndarray:
    """Load on the self-built plate per count, N and N*m."""
    b, a = HALF_Y_M, HALF_X_M
    rows = [
        [1, 1, 0, 0, 0, 0, 0, 0],
        [0, 0, 1, 1, 0, 0, 0, 0],
        [0, 0, 0, 0, 1, 1, 1, 1],
        [0, 0, 0, 0, b, b, -b, -b],
        [0, 0, 0, 0, -a, a, a, -a],
        [-b, b, a, -a, 0, 0, 0, 0],
    ]
    return np.array(rows, float) / COUNTS_PER_NEWTON


def offsets(channels: int) -> np.ndarray:
    """Counts of the empty plate, which a reader must find and subtract."""
    return np.round(40.0 * np.sin(1.0 + np.arange(channels)))


@dataclass(frozen=True)
class Signal:
    """Counts over time, repeated when they end; or numbers, where there are no counts.

    Attributes:
        counts: Counts of every sample, (sample, channel); empty for numbers.
        channels: Number of channels.
    """

    counts: np.ndarray
    channels: int

    def at(self, number: int) -> tuple[int, ...]:
        """Counts of a sample."""
        if not len(self.counts):
            return numbered(number, self.channels)
        return tuple(self.counts[number % len(self.counts)].tolist())


def numbered(number: int, channels: int) -> tuple[int, ...]:
    """Counts that name their sample: its number first, then what follows from it and nothing else."""
    return (number, *((number * 2654435761 * k + k) % 4294967291 % 4001 - 2000 for k in range(1, channels)))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options that choose what is measured."""
    group = parser.add_argument_group("what is measured: a synthetic trial, unless told otherwise")
    group.add_argument("--recordings", nargs="*", type=Path, default=[], metavar="C3D",
                       help="files to play one after the other")  # fmt: skip
    group.add_argument("--study-seed", type=int, default=0, help="seed of the synthetic trial")
    group.add_argument("--numbers", action="store_true", help="numbers that name the sample, no load")
    group.add_argument("--empty", action="store_true", help="an empty plate")


def from_options(
    options: argparse.Namespace, matrix: np.ndarray, depth_m: float, rate_hz: float, full_scale: int
) -> Signal:
    """The signal that the command line asks for, on transducers with this calibration."""
    channels = matrix.shape[1]
    if options.numbers:
        return Signal(np.zeros((0, channels), int), channels)
    if options.empty:
        return Signal(offsets(channels).astype(int)[None], channels)
    from mocks import scene  # what it needs takes longer to load than the device takes to start

    played = scene.from_options(options)
    loads = played.loads.reshape(-1, 6)
    at = np.arange(0, len(loads), played.rate_hz * played.samples / rate_hz)
    loads = np.column_stack([np.interp(at, np.arange(len(loads)), column) for column in loads.T])
    return Signal(counts_of(loads, matrix, depth_m, full_scale), channels)


def counts_of(loads: np.ndarray, matrix: np.ndarray, depth_m: float, full_scale: int) -> np.ndarray:
    """Counts of loads on a plate whose z axis points down; moments are about the middle of its surface.

    Args:
        loads: Force on the plate [N] and moment [N*m], (sample, 6).
        matrix: Load per count, N and N*m, about the plate's origin.
        depth_m: Origin below the surface [m].
        full_scale: Largest reading.
    """
    surface = np.array([0.0, 0.0, -depth_m])
    moments = loads[:, 3:] + np.cross(surface, loads[:, :3])
    counts = np.hstack([loads[:, :3], moments]) @ np.linalg.pinv(matrix).T + offsets(matrix.shape[1])
    return np.clip(np.round(counts), -full_scale - 1, full_scale).astype(int)
