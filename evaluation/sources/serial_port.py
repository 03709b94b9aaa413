"""Serial ports: which there are, how one is opened and read, and what its failures mean for the person."""

from __future__ import annotations

import errno
import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import serial
from serial.tools import list_ports

from evaluation.sources.stream import LabError

if importlib.util.find_spec("termios"):
    import termios

    FAILURES: tuple[type[Exception], ...] = (OSError, termios.error)
    """What a port raises when its device is pulled out."""
else:
    FAILURES = (OSError,)


T = TypeVar("T")


@dataclass(frozen=True)
class PortInfo:
    """A serial port of this computer.

    Attributes:
        path: What to open, such as ``/dev/ttyUSB0`` or ``COM3``.
        description: What the operating system knows about it.
        serial_number: Serial number of the adapter, which stays when the path changes; empty if unknown.
    """

    path: str
    description: str
    serial_number: str


def serial_ports() -> list[PortInfo]:
    """The serial ports of this computer, those with a device behind them first."""
    ports = sorted(list_ports.comports(), key=lambda port: (port.hwid in ("", "n/a"), port.device))
    return [
        PortInfo(port.device, "" if port.description == "n/a" else port.description, port.serial_number or "")
        for port in ports
    ]


class SerialLine:
    """An open serial port.

    Attributes:
        path: The port.
    """

    def __init__(self, path: str, baud: int) -> None:
        """Open a port for this process alone.

        Args:
            path: The port.
            baud: Bits per second.

        Raises:
            LabError: The port is missing, in use, not permitted or not at this speed.
        """
        self.path = path
        try:
            self._port = serial.serial_for_url(path, baudrate=baud, timeout=0.1, exclusive=_alone(path))
        except (*FAILURES, ValueError) as fault:
            raise _cannot_open(path, baud, fault) from fault

    def read(self, timeout_s: float) -> bytes:
        """Wait for the first byte; return all there is, or nothing when the time is over.

        Args:
            timeout_s: Longest wait [s].

        Raises:
            LabError: The line went dead.
        """
        try:
            if self._port.timeout != timeout_s:
                self._port.timeout = timeout_s
            first = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else first
        except FAILURES as fault:
            raise self._dead(fault) from fault

    def collect(self, timeout_s: float, take: Callable[[bytes, int], list[T]]) -> list[T]:
        """Read until the bytes make something, or the time is over.

        Args:
            timeout_s: Longest wait [s].
            take: What bytes that arrived at a host time [ns] make.

        Raises:
            LabError: The line went dead.
        """
        end = time.monotonic() + timeout_s
        while True:
            data = self.read(max(0.0, end - time.monotonic()))
            now = time.monotonic_ns()
            made = take(data, now)
            if made or 1e-9 * now >= end:
                return made

    def read_exactly(self, count: int, timeout_s: float) -> bytes:
        """Some bytes, or fewer when the time is over.

        Args:
            count: How many.
            timeout_s: Longest wait [s].

        Raises:
            LabError: The line went dead.
        """
        try:
            self._port.timeout = timeout_s
            return self._port.read(count)
        except FAILURES as fault:
            raise self._dead(fault) from fault

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            LabError: The line went dead.
        """
        try:
            self._port.write(data)
        except FAILURES as fault:
            raise self._dead(fault) from fault

    def drain(self, quiet_s: float = 0.05, longest_s: float = 0.5) -> int:
        """Throw away what has arrived, until the line is quiet; returns how many bytes that were.

        Args:
            quiet_s: Silence that counts as quiet [s].
            longest_s: Longest wait, as for a device that never stops [s].
        """
        discarded, end = 0, time.monotonic() + longest_s
        while time.monotonic() < end and (data := self.read(quiet_s)):
            discarded += len(data)
        return discarded

    def set_baud(self, baud: int) -> None:
        """Change the speed of an open port.

        Args:
            baud: Bits per second.

        Raises:
            LabError: The line went dead.
        """
        try:
            self._port.baudrate = baud
        except FAILURES as fault:
            raise self._dead(fault) from fault

    def close(self) -> None:
        """Give the port back."""
        self._port.close()

    def _dead(self, fault: Exception) -> LabError:
        return LabError(
            "the serial line went dead", where=f"{self.path}: {fault}", hint="check the cable and the power"
        )


def _alone(path: str) -> bool | None:
    """Ports of the computer are opened for one process; addresses such as ``socket://`` know no lock."""
    return None if "://" in path else True


def _cannot_open(path: str, baud: int, fault: Exception) -> LabError:
    """What a failure to open a port means."""
    number = getattr(fault, "errno", None)
    text = str(fault).lower()
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in text or "access is denied" in text:
        return LabError(
            "the port is in use by another program",
            where=path,
            hint="close the other program (a serial monitor, a second recording), or choose another port",
        )
    if number in (errno.EACCES, errno.EPERM):
        return LabError(
            "this user may not open the port",
            where=path,
            hint="on Linux: sudo usermod -a -G dialout $USER, then log in again",
        )
    if number == errno.ENOENT or "filenotfound" in text:
        return LabError(
            "there is no such port",
            where=path,
            hint="plug the adapter in; `hilbrace evaluate devices` lists the ports",
        )
    return LabError(
        f"the port cannot be opened at {baud} baud", where=f"{path}: {fault}", hint="check port and baud rate"
    )
