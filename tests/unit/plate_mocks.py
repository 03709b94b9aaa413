"""Mock plates as processes of their own, and what a test reads from a source."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from evaluation.plate_calibration import Placement, PlateCalibration, plate_info
from evaluation.sources.stream import Item, PlateInfo, PlateSamples, Source, SourceEvent
from mocks import plate_signal

ROOT = Path(__file__).resolve().parents[2]

N_AND_NMM = np.repeat([1.0, 1e-3], 3)[:, None]


def built_calibration() -> PlateCalibration:
    """Of the mock of a self-built plate."""
    matrix = -plate_signal.built_matrix()
    return PlateCalibration("built", matrix, "down", 0.0, (0.5, 0.3), 1.0, np.full(8, np.nan))


def amti_calibration() -> PlateCalibration:
    """Of the mock of an AMTI plate."""
    depth = 1e-3 * plate_signal.AMTI_DEPTH_MM
    matrix = -plate_signal.AMTI_MATRIX * N_AND_NMM
    return PlateCalibration("076", matrix, "down", -depth, (0.5, 0.5), 1.0, np.full(12, np.nan))


def raw_plate(name: str, rate_hz: float, calibration: PlateCalibration) -> PlateInfo:
    """A plate of raw counts at the laboratory's origin."""
    channels = tuple(f"c{k}" for k in range(calibration.matrix.shape[1]))
    return plate_info(name, rate_hz, channels, calibration, Placement())


class Tally:
    """What a mock says when it ends."""

    def __init__(self) -> None:
        self.sent = self.damaged = self.dropped = self.zeroed = -1


@contextmanager
def mock(module: str, link: Path, *options: str) -> Iterator[Tally]:
    """A mock that runs while the block does; its tally is there afterwards."""
    command = [sys.executable, "-m", f"mocks.{module}", "--link", str(link), *options]
    tally = Tally()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        try:
            assert json.loads(process.stdout.readline()) == {"port": str(link)}
            yield tally
        finally:
            process.terminate()
            vars(tally).update(json.loads(process.stdout.read() or "{}"))


def listen(source: Source, seconds: float, enough: int | None = None) -> list[Item]:
    """Everything that a source says for a time, or until it has given some number of samples."""
    items: list[Item] = []
    end, left = time.monotonic() + seconds, enough
    while time.monotonic() < end and (left is None or left > 0):
        news = source.read(0.05)
        items += news
        if left is not None:
            left -= sum(len(i.values) for i in news if isinstance(i, PlateSamples))
    return items


def events(items: list[Item], kind: str) -> list[SourceEvent]:
    """Events of one kind."""
    return [i for i in items if isinstance(i, SourceEvent) and i.kind == kind]


def samples(items: list[Item]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Number, device time [s], host time [s] and values of every sample; the host's is that of its block."""
    blocks = [i for i in items if isinstance(i, PlateSamples)]
    counts = [len(b.values) for b in blocks]
    within = np.concatenate([np.arange(n) for n in counts])
    number = np.repeat([b.number for b in blocks], counts) + within
    device = np.repeat([b.device_time_s for b in blocks], counts) + within * blocks[0].period_s
    host = 1e-9 * np.repeat([b.host_time_ns for b in blocks], counts)
    return number, device, host, np.concatenate([b.values for b in blocks])
