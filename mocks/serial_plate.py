"""A self-built force plate on a pseudo-terminal: ``python -m mocks.serial_plate --link plate``.

It prints one line when the port is there, and one with a tally when it ends.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path

from evaluation.sources.ascii_lines import info_line, sample_line
from evaluation.sources.serial_frame import Announcement, edge_frame, info_frame, sample_frame
from mocks import faults, plate_signal
from mocks.pty_port import PtyPort
from mocks.serving import say

INFO_EVERY_S = 1.0


class Plate:
    """The device: samples, announcements and edges on its own clock, at the speed of its line."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.faults = faults.from_options(options)
        matrix = plate_signal.built_matrix()
        self.signal = plate_signal.from_options(options, matrix, 0.0, options.rate, 2**31 - 1)
        self.told = Announcement(
            options.name, options.serial, float(options.rate), plate_signal.CHANNELS, options.calibration
        )
        self.port = PtyPort(options.link)
        self.injector = faults.Injector(self.faults)
        self.sent = self.damaged = self.edges = 0
        self.first = 0
        self.restart()

    def restart(self) -> None:
        """Begin anew, as after the power was gone; what is measured goes on."""
        self.pace = faults.Pace(self.options.rate, self.faults)
        self.number = 0

    def run(self) -> None:
        """Send until the time is over."""
        begun = time.monotonic()
        next_info = 0.0
        while (elapsed := time.monotonic() - begun) < self.options.duration:
            if self.injector.breaks(elapsed):
                self.interrupt()
            if self.number / self.options.rate >= next_info or b"?" in self.port.read():
                self.put(self.info())
                next_info = self.number / self.options.rate + INFO_EVERY_S
            self.trigger(elapsed)
            self.pace.wait(self.number)
            self.sample()
        self.port.unplug()

    def interrupt(self) -> None:
        """The plug is pulled and comes back later."""
        self.port.unplug()
        time.sleep(self.options.replug_after)
        if self.options.restart:
            self.first += self.number
            self.restart()
        else:
            self.number = self.pace.current()
        self.port.plug()

    def sample(self) -> None:
        """Send the next sample, unless it gets lost."""
        number, clock = self.number, round(1e6 * self.number / self.options.rate)
        self.number += 1
        if self.injector.drops():
            return
        counts = self.signal.at(self.first + number)
        frames = self.options.wire == "frames"
        self.sent += 1
        self.put(sample_frame(number, clock, counts) if frames else sample_line(clock, counts))

    def info(self) -> bytes:
        """What the plate says about itself."""
        return info_frame(self.told) if self.options.wire == "frames" else info_line(self.told)

    def trigger(self, elapsed: float) -> None:
        """Send an edge when the trigger input changes."""
        due = sum(at <= elapsed for at in self.options.trigger_at)
        if due > self.edges and self.options.wire == "frames":
            self.edges += 1
            self.put(edge_frame(round(1e6 * self.number / self.options.rate), self.edges % 2))

    def put(self, data: bytes) -> None:
        """Bytes on the line, damaged on the way; noise at another speed than the host's."""
        damaged = self.injector.corrupted(data)
        self.damaged += damaged is not data
        wrong_speed = self.options.baud and not self.port.is_at(self.options.baud)
        self.port.write(bytes(b ^ 0xA6 for b in damaged[::2]) if wrong_speed else damaged)


def parser() -> argparse.ArgumentParser:
    """Options of the mock."""
    options = argparse.ArgumentParser(prog="python -m mocks.serial_plate", description=__doc__)
    options.add_argument("--link", type=Path, required=True, help="name under which the port appears")
    options.add_argument("--wire", choices=("frames", "lines"), default="frames", help="how it speaks")
    options.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="samples per second")
    options.add_argument("--baud", type=int, default=0, help="the only speed it understands; 0: any, as USB")
    options.add_argument("--name", default="bench", help="how the plate calls itself")
    options.add_argument("--serial", default="7", help="its serial number")
    options.add_argument("--calibration", default="", help="the calibration that it names")
    options.add_argument("--duration", type=float, default=float("inf"), metavar="S", help="when to end")
    options.add_argument("--trigger-at", type=float, action="append", default=[], metavar="S",
                         help="change the trigger input at this time")  # fmt: skip
    options.add_argument(
        "--replug-after", type=float, default=1.0, metavar="S", help="length of a disconnect"
    )
    options.add_argument("--restart", action="store_true", help="counter and clock begin anew after it")
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
        say({"sent": plate.sent, "damaged": plate.damaged, "dropped": plate.injector.dropped})


if __name__ == "__main__":
    main()
