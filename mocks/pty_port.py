"""A serial port without hardware: a pseudo-terminal that can be pulled out and plugged in under one name."""

from __future__ import annotations

import os
import termios
import tty
from pathlib import Path


class PtyPort:
    """The device's end of a serial line, whose other end appears as a link to a terminal.

    Args:
        link: Name under which programs open the port.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self._device = self._host = -1
        self.plug()

    def plug(self) -> None:
        """Make the port appear."""
        self._device, self._host = os.openpty()
        tty.setraw(self._device)
        tty.setraw(self._host)
        os.set_blocking(self._device, False)
        fresh = self.link.with_name(self.link.name + ".new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(self._host))
        fresh.replace(self.link)

    def unplug(self) -> None:
        """Make the port vanish; whoever has it open gets an error."""
        if self._device < 0:
            return
        self.link.unlink(missing_ok=True)
        os.close(self._device)
        os.close(self._host)
        self._device = self._host = -1

    def write(self, data: bytes) -> None:
        """Send bytes; what no one fetches is lost, as on a wire."""
        try:
            os.write(self._device, data)
        except BlockingIOError:
            return

    def read(self) -> bytes:
        """What the host has sent since the last call."""
        try:
            return os.read(self._device, 256)
        except BlockingIOError:
            return b""

    def is_at(self, baud: int) -> bool:
        """Whether the host has set its end to this speed."""
        return termios.tcgetattr(self._host)[5] == getattr(termios, f"B{baud}")
