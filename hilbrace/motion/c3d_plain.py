"""A reader of C3D files in plain Python, for those that ezc3d does not read right.

These are files of SGI computers, and files with analog values of no channel or rate. It reads points,
residuals and texts. Layout: The C3D File Format, Motion Lab Systems (c3d.org).
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.motion.c3d_header import BLOCK, DEC, C3DHeader, byte_order, holds_floats, real
from hilbrace.motion.c3d_worker import OUTPUTS, gather

Array = np.ndarray

_MOST_RECORDS = 10_000


def read_plain(path: Path, header: C3DHeader) -> dict[str, Any]:
    """Points and texts of a file, under the names that the reading process of ezc3d uses; no plates.

    Args:
        path: The file, checked before.
        header: What `hilbrace.motion.c3d_header.check_c3d` found.

    Raises:
        InputError: The parameters hold no labels, rate or scale.
    """
    content = path.read_bytes()
    texts, numbers = _parameters(content, header.processor)
    point = {name: values for (group, name), values in texts.items() if group == "POINT"}
    rate = numbers.get(("POINT", "RATE"), real(content[20:24], header.processor))
    if "LABELS" not in point or not rate > 0:
        raise InputError("no labels or no rate of the markers", where=str(path), hint="export the file again")
    points, residuals = _data(content, header, abs(numbers.get(("POINT", "SCALE"), 1.0)))
    return {
        "points": points,
        "residuals": residuals,
        "point_rate": rate,
        "labels": gather(point, "LABELS"),
        "outputs": [name for group in OUTPUTS for name in gather(point, group)],
        "units": (point.get("UNITS") or [""])[0],
        "plates": 0,
        "measured": [name for group, name in numbers if group == "PROCESSING"],
        "measurements": np.array([v for (group, _), v in numbers.items() if group == "PROCESSING"], float),
    }


def _data(
    content: bytes, header: C3DHeader, scale: float
) -> tuple[Float[Array, "frame point 3"], Float[Array, "frame point"]]:
    """Positions in the file's unit, and residuals (negative where hidden)."""
    order = byte_order(header.processor)
    start = (struct.unpack_from(order + "H", content, 16)[0] - 1) * BLOCK
    width = 4 * header.points + header.analog_values
    floats = holds_floats(content, header.processor)
    if floats and header.processor == DEC:
        words = np.frombuffer(content, "<u2", 2 * header.frames * width, start).reshape(-1, 2)
        values = np.ascontiguousarray(words[:, ::-1]).view("<f4").ravel().astype(float) / 4
    else:
        kind = order + ("f4" if floats else "i2")
        values = np.frombuffer(content, kind, header.frames * width, start).astype(float)
    frames = values.reshape(header.frames, width)[:, : 4 * header.points]
    frames = frames.reshape(header.frames, header.points, 4)
    positions = frames[:, :, :3] if floats else scale * frames[:, :, :3]
    words = np.nan_to_num(frames[:, :, 3])
    return positions, np.where(words < 0, -1.0, scale * np.mod(words, 256))


def _parameters(
    content: bytes, processor: int
) -> tuple[dict[tuple[str, str], list[str]], dict[tuple[str, str], float]]:
    """Texts and single numbers by group and name."""
    order = byte_order(processor)
    groups: dict[int, str] = {}
    found: list[tuple[int, str, int]] = []
    position = (content[0] - 1) * BLOCK + 4
    for _ in range(_MOST_RECORDS):
        if position + 4 > len(content) or content[position] == 0:
            break
        length, group = (abs(value) for value in struct.unpack_from("<2b", content, position))
        is_group = struct.unpack_from("<b", content, position + 1)[0] < 0
        name = content[position + 2 : position + 2 + length].decode("latin-1")
        next_at = position + 2 + length
        if next_at + 2 > len(content):
            break
        offset = struct.unpack_from(order + "h", content, next_at)[0]
        if is_group:
            groups[group] = name
        else:
            found.append((group, name, next_at + 2))
        if offset <= 0:
            break
        position = next_at + offset
    texts: dict[tuple[str, str], list[str]] = {}
    numbers: dict[tuple[str, str], float] = {}
    for group, name, at in found:
        value = _value(content, at, processor)
        if isinstance(value, list):
            texts[groups.get(group, ""), name] = value
        elif value is not None:
            numbers[groups.get(group, ""), name] = value
    return texts, numbers


def _value(content: bytes, at: int, processor: int) -> list[str] | float | None:
    """Texts, or a single number; nothing for other kinds of parameters and beyond the file's end."""
    if at + 2 > len(content):
        return None
    kind, rank = struct.unpack_from("<bB", content, at)
    extents = tuple(content[at + 2 : at + 2 + rank])
    raw = content[at + 2 + rank :][: abs(kind) * int(np.prod(extents, dtype=int))]
    if kind == -1:
        width = extents[0] if extents else 1
        rows = [raw[k : k + width] for k in range(0, len(raw), width)] if width else []
        return [row.decode("latin-1").strip() for row in rows]
    if kind == 4 and len(raw) == 4:
        return real(raw, processor)
    if kind == 2 and len(raw) == 2:
        return float(struct.unpack(byte_order(processor) + "h", raw)[0])
    return None
