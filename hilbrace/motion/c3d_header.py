"""The header of a C3D file, checked before any library opens it.

Layout: The C3D File Format, Motion Lab Systems (c3d.org). The first block of 512 bytes counts points,
analog samples and frames; a parameter section repeats the counts; the frames follow. A file that is shorter
than its own counts ask for is cut short, and refused.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

from hilbrace.errors import InputError

BLOCK = 512
KEY = 0x50
INTEL, DEC, MIPS = 84, 85, 86
_MAX_COUNT_16 = 65535


@dataclass(frozen=True)
class C3DHeader:
    """What the file says about itself.

    Attributes:
        points: Trajectories.
        frames: Frames of markers.
        analog_per_frame: Samples of each analog channel per frame of markers.
        analog_values: Analog values per frame of markers, all channels together.
        expected_bytes: Length of the file up to its last frame.
        processor: Byte order and number format: 84 (Intel), 85 (DEC) or 86 (MIPS, as in SGI computers).
        analog_described: The parameters give the analog values' channels and rate, or there are no values.
        step: Step of points that are stored as whole numbers, in the file's units; 0 for floats.
    """

    points: int
    frames: int
    analog_per_frame: int
    analog_values: int
    expected_bytes: int
    processor: int
    analog_described: bool
    step: float


def check_c3d(path: Path) -> C3DHeader:
    """Read the header and the counts among the parameters, and compare them with the file's length.

    Raises:
        InputError: The file is missing, is no C3D file, is cut short, or contradicts itself.
    """
    content = _bytes(path)
    if len(content) < 2 * BLOCK or content[1] != KEY or content[0] < 2:
        raise InputError("not a C3D file", where=str(path), hint="choose a C3D file; its second byte is 0x50")
    processor = _processor(content, path)
    order = byte_order(processor)
    parameters = _parameters(content, processor)
    points, values, first, last = struct.unpack_from(order + "4H", content, 2)
    data_start, per_frame = struct.unpack_from(order + "2H", content, 16)
    frames = _frames(first, last, parameters, path)
    _same("points", points, parameters.get("POINT:USED"), path)
    channels = parameters.get("ANALOG:USED", 0)
    if values != channels * per_frame and (channels or 0) > 0:
        raise _contradiction(
            f"header has {values} analog values a frame, parameters {channels} channels", path
        )
    if points == 0 or data_start < content[0]:
        raise _contradiction(f"{points} points from block {data_start} on", path)
    width = 4 if holds_floats(content, processor) else 2
    expected = (data_start - 1) * BLOCK + frames * (4 * points + values) * width
    padded = -(-expected // BLOCK) * BLOCK
    if len(content) < padded and len(content) != expected:
        raise InputError(
            f"cut short: {frames} frames need {expected} bytes, the file has {len(content)}",
            where=str(path),
            hint="copy or export the file again",
        )
    unread = len(content) - padded > 2 * BLOCK + (4 * points + values) * width
    if last == _MAX_COUNT_16 and (unread or parameters.get("TRIAL:ACTUAL_END_FIELD", 0) > last):
        raise InputError(
            f"holds more than the {frames} frames that it can count",
            where=str(path),
            hint="export the recording in parts of less than 65536 frames",
        )
    described = not values or bool(channels and parameters.get("ANALOG:RATE"))
    step = max(0.0, real(content[12:16], processor))
    return C3DHeader(points, frames, per_frame, values, expected, processor, described, step)


def byte_order(processor: int) -> str:
    """Sign of `struct` for the byte order of a processor."""
    return ">" if processor == MIPS else "<"


def holds_floats(content: bytes, processor: int) -> bool:
    """Whether the data are floats: POINT:SCALE in the header is negative."""
    sign_at = {INTEL: 15, DEC: 13, MIPS: 12}[processor]
    return bool(content[sign_at] & 0x80)


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", where=str(path), hint="check the path") from None
    except OSError as fault:
        raise InputError(
            f"cannot be read: {fault.strerror}", where=str(path), hint="check the path"
        ) from None


def _frames(first: int, last: int, parameters: dict[str, int], path: Path) -> int:
    """Frames by the header, which sixteen bits have to hold (ezc3d reads no more either)."""
    frames = last - first + 1
    if frames < 1:
        raise _contradiction(f"frames run from {first} to {last}", path)
    _same("frames", frames & _MAX_COUNT_16, parameters.get("POINT:FRAMES"), path)
    return frames


def _same(what: str, header: int, parameter: int | None, path: Path) -> None:
    if parameter is not None and parameter & _MAX_COUNT_16 not in (header, _MAX_COUNT_16):
        raise _contradiction(f"header counts {header} {what}, the parameters {parameter}", path)


def _contradiction(detail: str, path: Path) -> InputError:
    return InputError(
        f"the file contradicts itself: {detail}",
        where=str(path),
        hint="it is damaged: copy or export it again",
    )


def _processor(content: bytes, path: Path) -> int:
    start = (content[0] - 1) * BLOCK
    if start + 4 > len(content):
        raise InputError("cut short before the parameters", where=str(path), hint="copy the file again")
    processor = content[start + 3]
    if processor not in (INTEL, DEC, MIPS):
        raise _contradiction(f"unknown processor type {processor}", path)
    return processor


def _parameters(content: bytes, processor: int) -> dict[str, int]:
    """Whole-number parameters by ``GROUP:NAME`` (those that count things)."""
    start, order = (content[0] - 1) * BLOCK, byte_order(processor)
    groups: dict[int, str] = {}
    entries: list[tuple[int, str, int]] = []
    position = start + 4
    for _ in range(10_000):
        if position + 4 > len(content) or content[position] == 0:
            break
        length, group = abs(_int8(content[position])), _int8(content[position + 1])
        name = content[position + 2 : position + 2 + length].decode("latin-1").upper()
        offset_at = position + 2 + length
        if offset_at + 2 > len(content):
            break
        offset = struct.unpack_from(order + "h", content, offset_at)[0]
        if group < 0:
            groups[-group] = name
        elif (value := _first_value(content, offset_at + 2, processor)) is not None:
            entries.append((group, name, value))
        if offset <= 0:
            break
        position = offset_at + offset
    return {f"{groups.get(group, '')}:{name}": value for group, name, value in entries}


def _first_value(content: bytes, at: int, processor: int) -> int | None:
    """First number of a parameter: an integer, a pair of words of a 32-bit count, or a float."""
    if at + 2 > len(content):
        return None
    kind, rank = _int8(content[at]), content[at + 1]
    data = at + 2 + rank
    size = 1
    for extent in content[at + 2 : data]:
        size *= extent
    if size < 1 or data + 4 > len(content):
        return None
    if kind == 2:
        words = struct.unpack_from(byte_order(processor) + "2H", content, data)
        return words[0] + (words[1] << 16 if size == 2 else 0)
    if kind == 4:
        value = real(content[data : data + 4], processor)
        return int(value) if value == value and abs(value) < 2**31 else None
    return None


def real(raw: bytes, processor: int) -> float:
    """A number of four bytes in the format of a processor."""
    if processor == DEC:
        return struct.unpack("<f", raw[2:4] + raw[0:2])[0] / 4
    return struct.unpack(byte_order(processor) + "f", raw)[0]


def _int8(byte: int) -> int:
    return byte - 256 if byte > 127 else byte
