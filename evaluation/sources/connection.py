"""TCP connections whose failures have names, and whose waits have ends."""

from __future__ import annotations

import queue
import socket
import threading
import time

from evaluation.sources.stream import LabError
from hilbrace.errors import InputError

PIECE_BYTES = 2**18
"""Most bytes that are taken from a connection at once."""


def connect(host: str, port: int, patience_s: float, whom: str) -> socket.socket:
    """A connection without delays for small messages.

    Args:
        host: Name or address.
        port: Port.
        patience_s: Longest wait [s].
        whom: What should answer there, for messages.

    Raises:
        LabError: The name is unknown, or nobody answers in time.
        InputError: The port is no port.
    """
    where = f"{host}:{port}"
    if not host or not 0 < port < 2**16:
        raise InputError(
            "this is no network address", where=where, hint="give a host and a port from 1 to 65535"
        )
    deadline = time.monotonic() + patience_s
    fault: OSError = TimeoutError()
    for family, kind, protocol, _, address in _resolve(host, port, patience_s):
        line = socket.socket(family, kind, protocol)
        line.settimeout(max(deadline - time.monotonic(), 1e-3))
        try:
            line.connect(address)
        except OSError as refusal:
            line.close()
            fault = refusal
            continue
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return line
    if isinstance(fault, TimeoutError):
        raise LabError(
            f"nobody answers within {patience_s:g} s",
            where=where,
            hint=f"check that {whom} runs there, that both computers are on one network, and the firewall",
        )
    reason = "nothing listens there" if isinstance(fault, ConnectionRefusedError) else str(fault)
    raise LabError(
        f"no connection: {reason}", where=where, hint=f"start {whom} there, or correct address and port"
    )


def _resolve(host: str, port: int, patience_s: float) -> list[tuple]:
    """Addresses of a name; the lookup itself has no time-out, so it runs aside."""
    answers: queue.SimpleQueue[list[tuple] | OSError | UnicodeError] = queue.SimpleQueue()

    def look_up() -> None:
        try:
            answers.put(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
        except (OSError, UnicodeError) as fault:
            answers.put(fault)

    threading.Thread(target=look_up, daemon=True, name="name lookup").start()
    try:
        answer = answers.get(timeout=patience_s)
    except queue.Empty:
        answer = TimeoutError()
    if isinstance(answer, list):
        return answer
    raise LabError(
        f"the name '{host}' is unknown",
        where=f"{host}:{port}",
        hint="check the spelling, or give the number address",
    ) from answer


def receive(line: socket.socket, timeout_s: float, whom: str) -> bytes:
    """What has arrived, or nothing when the time is over.

    Raises:
        LabError: The other side closed the connection, or it broke.
    """
    line.settimeout(max(timeout_s, 1e-6))
    try:
        data = line.recv(PIECE_BYTES)
    except TimeoutError:
        return b""
    except OSError as fault:
        raise _lost(whom, str(fault)) from fault
    if not data:
        raise _lost(whom, "it closed it")
    return data


def send(line: socket.socket, data: bytes, whom: str, patience_s: float = 3.0) -> None:
    """Send a short message.

    Raises:
        LabError: The connection broke.
    """
    line.settimeout(patience_s)
    try:
        line.sendall(data)
    except OSError as fault:
        raise _lost(whom, str(fault)) from fault


def _lost(whom: str, why: str) -> LabError:
    return LabError(
        f"the connection to {whom} is lost: {why}",
        where="network",
        hint="check that the server still runs, and the cable",
    )
