"""How a mock serves: on the loopback address only, one thread per client, its port on its first line."""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from collections.abc import Callable

LOOPBACK = "127.0.0.1"


class Clock:
    """The device's clock, which starts when the first client asks for frames."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._start: float | None = None

    def start(self) -> float:
        """Start of the clock by ``time.monotonic()`` [s]."""
        with self._lock:
            if self._start is None:
                self._start = time.monotonic()
            return self._start


def serve(port: int, handle: Callable[[socket.socket], None]) -> None:
    """Accept clients for ever, each in a thread of its own.

    Args:
        port: Port; 0 for any that is free.
        handle: Serves one client until it leaves.
    """
    listener = socket.create_server((LOOPBACK, port))
    say({"host": LOOPBACK, "port": listener.getsockname()[1]})
    while True:
        line, _ = listener.accept()
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        threading.Thread(target=_until_gone, args=(line, handle), daemon=True).start()


def say(message: dict) -> None:
    """Print one JSON object on a line of its own."""
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def _until_gone(line: socket.socket, handle: Callable[[socket.socket], None]) -> None:
    try:
        handle(line)
        # Another thread may still wait for this client: closing alone would keep the line open.
        line.shutdown(socket.SHUT_RDWR)
    except OSError:
        pass
    finally:
        line.close()
