"""What is behind a serial port: a test of the connection that says what the device said."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from evaluation.sources import amti
from evaluation.sources.amti_plate import serial_number, set_rate
from evaluation.sources.serial_plate import Wire, await_announcement
from evaluation.sources.serial_port import SerialLine
from evaluation.sources.stream import LabError

Protocol = Literal["amti", "frames", "lines"]

BAUDS: dict[Wire, tuple[int, ...]] = {"frames": (921600, 460800, 115200), "lines": (115200, 57600)}
"""Speeds at which self-built plates are looked for."""

LISTEN_S = 1.2
"""A self-built plate announces itself within this time [s]."""


@dataclass(frozen=True)
class Found:
    """A device that answered.

    Attributes:
        port: The port.
        protocol: What it speaks.
        baud: At which speed [bit/s].
        text: What it said, in a sentence.
    """

    port: str
    protocol: Protocol
    baud: int
    text: str


def probe(port: str, protocol: Protocol | None = None, baud: int | None = None) -> Found:
    """Test the connection to whatever is behind a port.

    Self-built plates are listened for first; only then an AMTI plate is spoken to, and it is left stopped.

    Args:
        port: The port.
        protocol: What to try; everything if not told.
        baud: The only speed to try self-built plates at; the usual ones if not told.

    Raises:
        LabError: The port cannot be opened, or nothing known answers; the message says what was tried.
    """
    SerialLine(port, amti.FIRST_BAUD).close()
    faults: list[LabError] = []
    for wire, speeds in BAUDS.items():
        for speed in (baud,) if baud else speeds:
            if protocol not in (None, wire):
                continue
            try:
                return _listen(port, wire, speed)
            except LabError as fault:
                faults.append(fault)
    if protocol in (None, "amti"):
        try:
            return _greet(port)
        except LabError as fault:
            faults.append(fault)
    if protocol:
        raise faults[-1]
    tried = dict.fromkeys(fault.what for fault in faults)
    raise LabError(
        "no plate that is known answers", where=f"{port}: {'; '.join(tried)}", hint=faults[-1].hint
    )


def _listen(port: str, wire: Wire, baud: int) -> Found:
    line = SerialLine(port, baud)
    try:
        plate, _ = await_announcement(line, wire, LISTEN_S)
    finally:
        line.close()
    named = f"'{plate.name}' {plate.serial}".strip()
    text = f"plate {named}: {len(plate.channels)} channels at {plate.rate_hz:g} Hz"
    return Found(port, wire, baud, text)


def _greet(port: str) -> Found:
    line = SerialLine(port, amti.FIRST_BAUD)
    try:
        set_rate(line, 50)
        serial = serial_number(line)
    finally:
        line.close()
    told = f"serial number {serial}" if serial else "which does not tell its serial number"
    return Found(port, "amti", amti.FIRST_BAUD, f"AMTI 12-channel plate, {told}")
