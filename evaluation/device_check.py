"""Which devices this computer can reach, and whether they answer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from evaluation.record.reading import missing_numbers
from evaluation.sources.addresses import open_addresses
from evaluation.sources.probe import probe
from evaluation.sources.reconnecting import Reconnecting
from evaluation.sources.stream import Item, MarkerFrame, PlateSamples, Source, SourceInfo
from hilbrace.errors import HilbraceError


def probe_ports(ports: Sequence[str]) -> list[dict[str, str]]:
    """What answers behind some serial ports.

    Args:
        ports: The ports.
    """
    found = []
    for port in ports:
        try:
            found.append({"port": port, "text": probe(port).text})
        except HilbraceError as fault:
            found.append({"port": port, "text": f"{fault.what}; {fault.hint}"})
    return found


def check_devices(addresses: Sequence[str], seconds: float) -> list[dict[str, Any]]:
    """Connect to devices one after the other, and listen to each for a while.

    Args:
        addresses: Their addresses.
        seconds: How long to listen to each [s].

    Raises:
        InputError: An address has a mistake.
    """
    sources = open_addresses(addresses)
    return [_check(address, source, seconds) for address, source in zip(addresses, sources, strict=True)]


def _check(address: str, source: Source, seconds: float) -> dict[str, Any]:
    device = Reconnecting(source)
    try:
        info = device.open()
        items = _listen(device, seconds)
    except HilbraceError as fault:
        return {"address": address, "answers": False, "text": f"{fault.what}; {fault.hint}"}
    finally:
        device.close()
    frames = [item for item in items if isinstance(item, MarkerFrame)]
    blocks = [item for item in items if isinstance(item, PlateSamples)]
    samples = sum(len(block.values) for block in blocks)
    lost = sum(missing_numbers(tuple(items)).values())
    hidden = _hidden(frames, info)
    text = [info.device]
    if info.labels:
        text.append(
            f"{len(info.labels)} markers at {info.rate_hz:g} Hz, {len(frames)} frames in {seconds:g} s"
        )
    text += [f"plate '{plate.name}' at {plate.rate_hz:g} Hz" for plate in info.plates]
    text += [f"{samples} plate samples"] if info.plates else []
    text.append(f"{lost} lost")
    text += [f"never seen: {', '.join(hidden)}"] if hidden else []
    return {
        "address": address,
        "answers": bool(frames or blocks),
        "device": info.device,
        "labels": list(info.labels),
        "rate_hz": info.rate_hz,
        "plates": [{"name": plate.name, "rate_hz": plate.rate_hz} for plate in info.plates],
        "frames": len(frames),
        "samples": samples,
        "lost": lost,
        "hidden": hidden,
        "notes": list(info.notes),
        "text": "; ".join([*text, *info.notes]),
    }


def _listen(device: Reconnecting, seconds: float) -> list[Item]:
    items: list[Item] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        items += device.read(0.1)
    return items


def _hidden(frames: Sequence[MarkerFrame], info: SourceInfo) -> list[str]:
    """Markers that no frame shows."""
    fitting = [frame for frame in frames if len(frame.positions) == len(info.labels)]
    return [
        label for k, label in enumerate(info.labels)
        if fitting and not any(frame.positions[k, 0] == frame.positions[k, 0] for frame in fitting)
    ]  # fmt: skip
