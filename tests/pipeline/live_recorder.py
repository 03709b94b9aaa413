"""Records two made-up devices until it is killed: python -m tests.pipeline.live_recorder OUT.mcap.

Each number is written to standard output as soon as it was handed on, so that whoever kills it knows
what the recorder had been given.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np

from evaluation.live.acquisition import Acquisition, Answer, Begin
from evaluation.sources.stream import Item, MarkerFrame, PlateSamples, SourceInfo
from tests.unit.evaluation_devices import INFO

RATE_HZ = 200


class Metronome:
    """Thirteen markers and a plate at 1 kHz, in real time."""

    name = INFO.source

    def __init__(self) -> None:
        self._number, self._start = 0, 0.0
        self._labels = tuple(f"M{k}" for k in range(13))

    def open(self) -> SourceInfo:
        self._start = time.monotonic()
        return SourceInfo(INFO.source, "a metronome", self._labels, RATE_HZ, "z", INFO.plates)

    def read(self, timeout_s: float) -> list[Item]:
        if self._number:
            # What the last reading returned has been handed on by now.
            os.write(1, f"{self._number - 1}\n".encode())
        time.sleep(max(0.0, self._start + self._number / RATE_HZ - time.monotonic()))
        number, now = self._number, time.monotonic_ns()
        self._number += 1
        device = number / RATE_HZ
        positions = np.full((13, 3), device) + np.arange(13)[:, None]
        return [
            MarkerFrame(self.name, number, device, now, positions),
            PlateSamples(self.name, "1", 5 * number, device, 0.001, now, np.full((5, 6), float(number))),
        ]

    def close(self) -> None:
        pass


def main() -> None:
    acquisition = Acquisition([Metronome()], analyse=False)
    acquisition.recorder.mailbox.order(Begin(Path(sys.argv[1]), {}, Answer()))
    acquisition.start()
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main()
