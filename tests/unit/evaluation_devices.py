"""Devices that live in the test's own process, and the frames that they send."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np

from evaluation.sources.stream import (
    Item,
    LabError,
    MarkerFrame,
    PlateInfo,
    PlateSamples,
    SourceEvent,
    SourceInfo,
)

PLATE = PlateInfo(
    name="1",
    rate_hz=1000.0,
    channels=("Fx", "Fy", "Fz", "Mx", "My", "Mz"),
    units=("N", "N", "N", "N*m", "N*m", "N*m"),
    calibration=np.eye(6),
    rotation=np.eye(3),
    origin=np.zeros(3),
    corners=np.full((4, 3), np.nan),
    zeroed=True,
    noise_n=0.7,
    empty=(0.5, 0.0, 1.0, 0.0, 0.0, 2.0),
)
INFO = SourceInfo("lab", "a device", ("TH1", "TH2", "HIP"), 200.0, "z", (PLATE,))


def frame(number: int, rng: np.random.Generator, source: str = "lab", markers: int = 3) -> MarkerFrame:
    positions = rng.normal(size=(markers, 3))
    if number % 7 == 0:
        positions[number % markers] = np.nan
    return MarkerFrame(source, number, number / 200, time.monotonic_ns(), positions)


def samples(number: int, rng: np.random.Generator, source: str = "lab") -> PlateSamples:
    values = rng.normal(0, 300, (5, 6))
    return PlateSamples(source, "1", 5 * number, number / 200, 0.001, time.monotonic_ns(), values)


def stream(count: int, seed: int = 0, first: int = 0) -> Iterator[Item]:
    """Frames and samples as one device sends them."""
    rng = np.random.default_rng(seed)
    for number in range(first, first + count):
        yield frame(number, rng)
        yield samples(number, rng)


class ScriptedSource:
    """Delivers lists of items, one per reading; an exception among them is raised."""

    def __init__(self, blocks: list[list[Item] | Exception], info: SourceInfo = INFO) -> None:
        self.name, self.info = info.source, info
        self.blocks = list(blocks)
        self.opened = 0
        self.finished = threading.Event()

    def open(self) -> SourceInfo:
        self.opened += 1
        return self.info

    def read(self, timeout_s: float) -> list[Item]:
        if not self.blocks:
            self.finished.set()
            time.sleep(min(timeout_s, 0.01))
            return []
        block = self.blocks.pop(0)
        if isinstance(block, Exception):
            raise block
        return block

    def close(self) -> None:
        pass


def lost_line() -> LabError:
    return LabError("the line went dead", where="lab", hint="plug it in again")


def ended() -> SourceEvent:
    return SourceEvent("lab", "ended", time.monotonic_ns(), float("nan"), "The replay is over.")
