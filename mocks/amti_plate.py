"""An AMTI plate of the AccuSway+ class on a pseudo-terminal: ``python -m mocks.amti_plate --link plate``.

It prints one line when the port is there, and one with a tally when it ends.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path

import numpy as np

from evaluation.sources import amti
from hilbrace.units import MM_PER_M
from mocks import faults, plate_signal
from mocks.pty_port import PtyPort
from mocks.serving import say

IDLE_S = 0.005


class Plate:
    """The device: commands in, samples out, each at the speed that the host must follow."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.faults = faults.from_options(options)
        matrix = plate_signal.AMTI_MATRIX / np.repeat([1.0, MM_PER_M], 3)[:, None]
        depth_m = plate_signal.AMTI_DEPTH_MM / MM_PER_M
        self.signals = {
            rate: plate_signal.from_options(options, matrix, depth_m, rate, amti.ZERO_READING - 1)
            for rate in amti.RATES_HZ
        }
        self.port = PtyPort(options.link)
        self.injector = faults.Injector(self.faults)
        self.baud = amti.FIRST_BAUD
        self.rate = 0
        self.streaming = self.trigger = False
        self.number = self.sent = self.damaged = self.edges = 0
        self.zero = np.zeros(amti.CHANNELS, int)
        self.zeroed = 0

    def run(self) -> None:
        """Answer and send until the time is over."""
        begun = time.monotonic()
        while (elapsed := time.monotonic() - begun) < self.options.duration:
            if self.injector.breaks(elapsed):
                self.port.unplug()
                time.sleep(self.options.replug_after)
                self.port.plug()
                self.number = self.pace.current() if self.streaming else 0
            for command in self.port.read():
                self.obey(bytes([command]))
            if self.streaming:
                self.pace.wait(self.number)
                self.sample(elapsed)
            else:
                time.sleep(IDLE_S)
        self.port.unplug()

    def obey(self, command: bytes) -> None:
        """Do what one byte asks for, if it came at the speed that the plate listens to."""
        if not self.port.is_at(self.baud) or self.options.mute:
            return
        if command == amti.STOP:
            self.streaming = False
        elif command == amti.START and self.rate:
            self.put(amti.STARTED)
            self.begin()
        elif command == amti.AUTO_ZERO:
            self.zeroed += 1
            self.zero = plate_signal.offsets(amti.CHANNELS).astype(int)
            self.put(amti.ZEROED + bytes(amti.ZEROED_BYTES))
        elif command == amti.SERIAL_NUMBER and self.options.serial:
            self.put(amti.SERIAL_FOLLOWS + self.options.serial.encode())
        for rate, settings in amti.RATES_HZ.items():
            if command == settings.command:
                self.put(command)
                self.rate, self.baud = rate, settings.baud

    def begin(self) -> None:
        """Start to send."""
        self.streaming, self.number = True, 0
        self.pace = faults.Pace(self.rate, self.faults)
        self.signal = self.signals[self.rate]

    def sample(self, elapsed: float) -> None:
        """Send the next sample, unless it gets lost or loses its end."""
        due = sum(at <= elapsed for at in self.options.trigger_at)
        self.trigger = bool(due % 2)
        number = self.number
        self.number += 1
        if self.injector.drops():
            return
        if self.options.numbers:
            first, *rest = plate_signal.numbered(number, amti.CHANNELS)
            readings = (first % 4096 - 2048, *rest)
        else:
            readings = tuple((np.array(self.signal.at(number)) - self.zero).clip(-2048, 2047).tolist())
        self.sent += 1
        self.put(self.cut(amti.encode_sample(readings, self.trigger)))

    def cut(self, data: bytes) -> bytes:
        """A sample that may have lost its end on the line."""
        if self.options.cut and self.sent % self.options.cut == 0:
            self.damaged += 1
            return data[: 1 + self.sent // self.options.cut % (amti.FRAME_BYTES - 1)]
        return data

    def put(self, data: bytes) -> None:
        """Bytes on the line, damaged on the way; noise at another speed than the host's."""
        damaged = self.injector.corrupted(data)
        self.damaged += damaged is not data
        self.port.write(damaged if self.port.is_at(self.baud) else bytes(b ^ 0xA6 for b in damaged[::2]))


def parser() -> argparse.ArgumentParser:
    """Options of the mock."""
    options = argparse.ArgumentParser(prog="python -m mocks.amti_plate", description=__doc__)
    options.add_argument("--link", type=Path, required=True, help="name under which the port appears")
    options.add_argument("--serial", default="0983", help="serial number of four characters; empty: not told")
    options.add_argument("--mute", action="store_true", help="never answer, as with the switches A+B wrong")
    options.add_argument("--cut", type=int, default=0, metavar="N", help="every Nth sample loses its end")
    options.add_argument("--duration", type=float, default=float("inf"), metavar="S", help="when to end")
    options.add_argument("--trigger-at", type=float, action="append", default=[], metavar="S",
                         help="change the trigger input at this time")  # fmt: skip
    options.add_argument(
        "--replug-after", type=float, default=1.0, metavar="S", help="length of a disconnect"
    )
    plate_signal.add_arguments(options)
    faults.add_arguments(options)
    return options


def main(arguments: list[str] | None = None) -> None:
    """Serve until the time is over or the process is told to end."""
    plate = Plate(parser().parse_args(arguments))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    say({"port": str(plate.port.link)})
    try:
        plate.run()
    finally:
        plate.port.unplug()
        told = {"sent": plate.sent, "damaged": plate.damaged, "dropped": plate.injector.dropped}
        say(told | {"zeroed": plate.zeroed})


if __name__ == "__main__":
    main()
