"""TCP connections whose failures have names, and whose waits have ends."""

from __future__ import annotations

import socket

from evaluation.sources.stream import LabError

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
    """
    where = f"{host}:{port}"
    try:
        line = socket.create_connection((host, port), timeout=patience_s)
    except socket.gaierror as fault:
        raise LabError(
            f"the name '{host}' is unknown",
            where=where,
            hint="check the spelling, or give the number address",
        ) from fault
    except TimeoutError as fault:
        raise LabError(
            f"nobody answers within {patience_s:g} s",
            where=where,
            hint=f"check that {whom} runs there, that both computers are on one network, and the firewall",
        ) from fault
    except OSError as fault:
        reason = "nothing listens there" if isinstance(fault, ConnectionRefusedError) else str(fault)
        raise LabError(
            f"no connection: {reason}", where=where, hint=f"start {whom} there, or correct address and port"
        ) from fault
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return line


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
