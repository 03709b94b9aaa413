"""Devices by their addresses, as ``vicon://192.168.1.10`` or ``serial:///dev/ttyUSB0?calibration=plate.toml``.

Only the module of the device asked for is imported.
"""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import parse_qsl, unquote, urlsplit

from evaluation.sources.stream import Source
from hilbrace.errors import InputError

if TYPE_CHECKING:
    from evaluation.plate_calibration import Placement, PlateCalibration

EXAMPLES = {
    "vicon": "vicon://192.168.1.10:801",
    "qualisys": "qualisys://192.168.1.11",
    "serial": "serial:///dev/ttyUSB0?protocol=cobs&calibration=plate.toml&x=0.3&y=0.2",
    "amti": "amti:///dev/ttyS0?calibration=plate.acl&units=lb, in*lb&depth_mm=41.3",
    "lsl": "lsl://ForcePlate",
    "c3d": "c3d:///recordings/trial.c3d?speed=1",
}
"""An address of each kind of device."""

_PLACEMENT = ("x", "y", "z", "heading", "up")
_PLATE = ("calibration", "units", "depth_mm", *_PLACEMENT)


@dataclass(frozen=True)
class Address:
    """The parts of an address.

    Attributes:
        text: All of it, for messages.
        scheme: Kind of device.
        host: Computer or name behind ``//``; empty without one.
        port: Port; ``None`` without one.
        path: File or serial port; empty without one.
        options: What follows the question mark.
    """

    text: str
    scheme: str
    host: str
    port: int | None
    path: str
    options: dict[str, str]

    @property
    def place(self) -> str:
        """Serial port, file or stream: path and host together, so that ``serial://COM3`` works too."""
        return f"{self.host}{self.path}"


def open_addresses(addresses: Sequence[str]) -> list[Source]:
    """Sources of some devices, none of them connected yet.

    Args:
        addresses: Their addresses; a device without a ``name`` is called after its kind, and numbered if
            there are several.

    Raises:
        InputError: An address has a mistake, or a file or package that it needs is missing.
    """
    parsed = [parse_address(address) for address in addresses]
    seen: Counter[str] = Counter()
    sources = []
    for address in parsed:
        seen[address.scheme] += 1
        number = seen[address.scheme]
        default = address.scheme if number == 1 else f"{address.scheme}_{number}"
        sources.append(make_source(address, address.options.get("name") or default))
    return sources


def parse_address(text: str) -> Address:
    """Take an address apart.

    Raises:
        InputError: It is none, or an option is unknown.
    """
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError as fault:
        raise _wrong(text, str(fault), "write it as one of " + ", ".join(EXAMPLES.values())) from None
    if parts.scheme not in _KINDS or not text.startswith(f"{parts.scheme}://"):
        near = difflib.get_close_matches(parts.scheme, _KINDS, n=1)
        hint = f"did you mean {EXAMPLES[near[0]]}?" if near else f"write {', '.join(EXAMPLES.values())}"
        raise _wrong(text, "this is no address of a device", hint)
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    _, known = _KINDS[parts.scheme]
    for key in options:
        if key not in ("name", *known):
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(('name', *known))}"
            raise _wrong(text, f"unknown option '{key}'", hint)
    network = parts.netloc.rsplit("@", 1)[-1]
    if parts.scheme in ("vicon", "qualisys"):
        host = parts.hostname or ""
    else:
        host, port = unquote(network), None
    return Address(text, parts.scheme, host, port, unquote(parts.path), options)


def make_source(address: Address, name: str) -> Source:
    """The source behind an address.

    Args:
        address: The address.
        name: The source's name.

    Raises:
        InputError: A file or package that it needs is missing, or a value is wrong.
    """
    make, _ = _KINDS[address.scheme]
    return make(address, name)


def _vicon(address: Address, name: str) -> Source:
    from evaluation.sources.vicon import PORT, ViconSource

    return ViconSource(name, _host(address), address.port or PORT)


def _qualisys(address: Address, name: str) -> Source:
    from evaluation.sources.qualisys import PORT, QualisysSource

    return QualisysSource(name, _host(address), address.port or PORT)


def _serial(address: Address, name: str) -> Source:
    from evaluation.sources.serial_plate import SerialPlate

    wires = {"cobs": "frames", "frames": "frames", "lines": "lines"}
    spoken = address.options.get("protocol", "cobs")
    if spoken not in wires:
        raise _wrong(address.text, f"unknown protocol '{spoken}'", f"choose one of {', '.join(wires)}")
    return SerialPlate(
        name,
        _port(address),
        _calibration(address),
        _placement(address),
        baud=int(_number(address, "baud", 921600)),
        wire="lines" if wires[spoken] == "lines" else "frames",
    )


def _amti(address: Address, name: str) -> Source:
    from evaluation.sources.amti_plate import AmtiPlate

    return AmtiPlate(
        name,
        _port(address),
        _calibration(address),
        _placement(address),
        rate_hz=int(_number(address, "rate", 200)),
        auto_zero=address.options.get("auto_zero", "no") == "yes",
    )


def _lsl(address: Address, name: str) -> Source:
    from evaluation.sources.lsl import LslStream

    if not address.place:
        raise _wrong(address.text, "the name of the stream is missing", f"write {EXAMPLES['lsl']}")
    calibration = _calibration(address) if "calibration" in address.options else None
    return LslStream(name, address.place, calibration, _placement(address))


def _replay(address: Address, name: str) -> Source:
    from evaluation.sources.c3d_replay import C3DReplay

    if not address.place:
        raise _wrong(address.text, "the file is missing", f"write {EXAMPLES['c3d']}")
    up = _up(address)
    return C3DReplay(name, Path(address.place), _number(address, "speed", 1.0), up)


def _calibration(address: Address) -> PlateCalibration:
    from evaluation.plate_calibration import load_calibration

    path = address.options.get("calibration")
    if not path:
        raise _wrong(
            address.text, "a plate needs its calibration", "add ?calibration=FILE, the file that came with it"
        )
    depth = _number(address, "depth_mm", float("nan"))
    return load_calibration(Path(path), address.options.get("units"), depth if depth == depth else None)


def _placement(address: Address) -> Placement:
    from evaluation.plate_calibration import Placement

    x, y, z = (_number(address, axis, 0.0) for axis in "xyz")
    return Placement((x, y, z), _number(address, "heading", 0.0), _up(address))


def _up(address: Address) -> Literal["y", "z"]:
    up = address.options.get("up", "z")
    if up not in ("y", "z"):
        raise _wrong(address.text, f"up = '{up}' is no vertical axis", "write up=y or up=z")
    return "y" if up == "y" else "z"


def _host(address: Address) -> str:
    if not address.host:
        raise _wrong(address.text, "the computer is missing", f"write {EXAMPLES[address.scheme]}")
    return address.host


def _port(address: Address) -> str:
    if not address.place:
        raise _wrong(address.text, "the serial port is missing", f"write {EXAMPLES[address.scheme]}")
    return address.place


def _number(address: Address, key: str, default: float) -> float:
    try:
        return float(address.options.get(key, default))
    except ValueError:
        raise _wrong(
            address.text, f"{key} = '{address.options[key]}' is no number", "write a number"
        ) from None


def _wrong(text: str, what: str, hint: str) -> InputError:
    return InputError(what, where=text, hint=hint)


_KINDS: dict[str, tuple[Callable[[Address, str], Source], tuple[str, ...]]] = {
    "vicon": (_vicon, ()),
    "qualisys": (_qualisys, ()),
    "serial": (_serial, ("protocol", "baud", *_PLATE)),
    "amti": (_amti, ("rate", "auto_zero", *_PLATE)),
    "lsl": (_lsl, _PLATE),
    "c3d": (_replay, ("speed", "up")),
}
