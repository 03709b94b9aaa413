"""C3D files, written so that Vicon, Qualisys, Visual3D and Mokka read them.

Layout: The C3D File Format, Motion Lab Systems (c3d.org): Intel byte order, floating-point data, millimetres,
z up. Gaps have residual -1. Force plates are of type 2 (AMTI: three forces and three moments about the
plate's surface).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Num

from hilbrace.errors import InputError
from hilbrace.motion.c3d_header import BLOCK, INTEL, KEY
from hilbrace.motion.force_plates import PlateForces
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.motion.recording import Recording
from hilbrace.run.records import write_atomic
from hilbrace.units import MM_PER_M

Array = np.ndarray

MOST_FRAMES, MOST_LABELS = 65535, 255

_SCALE = -0.01
_PLATE_AXES = np.array([1.0, -1.0, -1.0])
"""Laboratory's z-up axes in a plate whose own z points down."""

_AROUND = ((1, -1), (-1, -1), (-1, 1), (1, 1))
"""Corners of a plate about its middle, in the order that gives these axes."""

Value = int | float | Sequence[str] | Num[Array, "..."]


@dataclass
class _Parameters:
    """The parameter section as it grows."""

    content: bytearray = field(default_factory=bytearray)
    groups: int = 0

    def group(self, name: str, values: Mapping[str, Value]) -> None:
        """Append a group and its parameters."""
        self.groups += 1
        label = name.encode("ascii")
        self.content += struct.pack("<bb", len(label), -self.groups) + label + struct.pack("<hB", 3, 0)
        for key, value in values.items():
            self._append(key, value)

    def padded(self) -> bytes:
        """The whole section, in blocks, with its own header."""
        blocks = -(-(len(self.content) + 5) // BLOCK)
        head = struct.pack("<4B", 1, KEY, blocks, INTEL)
        return (head + bytes(self.content)).ljust(blocks * BLOCK, b"\0")

    def _append(self, key: str, value: Value) -> None:
        kind, extents, raw = _encode(value)
        body = struct.pack(f"<bB{len(extents)}B", kind, len(extents), *extents) + raw + b"\0"
        label = key.encode("ascii")
        self.content += struct.pack("<bb", len(label), self.groups) + label
        self.content += struct.pack("<h", len(body) + 2) + body


def write_c3d(
    path: Path, recording: Recording, plate_size_m: tuple[float, float] = (0.6, 0.4), prefix: str = ""
) -> None:
    """Write markers, and plates if there are any.

    Args:
        path: File to write.
        recording: Markers and plates, y up, as `hilbrace.motion.recording.read_recording` gives them.
        plate_size_m: Size of each plate about the median of its points, forward and sideways [m]; it is not
            part of the recording. A plate that never had a point lies at the origin.
        prefix: Subject's name in front of every label, as ``Anna`` in ``Anna:LTH1``; none if empty.

    Raises:
        InputError: There are more than 65535 frames, labels are too long, or plates do not fit the frames.
    """
    table = recording.markers
    frames = len(table.time)
    _check(table, path)
    per_frame, channels, groups = 1, np.zeros((frames, 0)), {}
    if recording.plates is not None:
        per_frame, channels, groups = _plates(recording.plates, table, plate_size_m, path)
    labels = [f"{prefix}:{name}" if prefix else name for name in table.names]
    analog = _analog_group(channels.shape[1], table.rate_hz * per_frame)

    def section(start: int) -> bytes:
        parameters = _Parameters()
        parameters.group("POINT", _point_group(table, labels, start))
        parameters.group("ANALOG", analog)
        parameters.group("FORCE_PLATFORM", groups or {"USED": 0})
        return parameters.padded()

    start = 2 + len(section(0)) // BLOCK
    head = _header(table, channels.shape[1] * per_frame, start, per_frame) + section(start)
    data = np.concatenate([_points(table), channels.reshape(frames, -1)], axis=1).astype("<f4").tobytes()
    write_atomic(path, head + data + b"\0" * (-len(data) % BLOCK))


def z_up(vectors: Float[Array, "*rest 3"]) -> Float[Array, "*rest 3"]:
    """Vectors of the y-up frame in a z-up laboratory, the way back of `recording.from_z_up`."""
    return np.stack([vectors[..., 0], -vectors[..., 2], vectors[..., 1]], axis=-1)


def _check(table: MarkerTable, path: Path) -> None:
    if len(table.time) > MOST_FRAMES:
        raise InputError(
            f"{len(table.time)} frames do not fit a C3D file",
            where=str(path),
            hint=f"write parts of at most {MOST_FRAMES} frames",
        )
    bad = [name for name in table.names if not name.isascii() or not 0 < len(name) <= 60]
    if bad:
        raise InputError(f"'{bad[0]}' cannot be a label", where=str(path), hint="use up to 60 plain letters")


def _header(table: MarkerTable, analog_values: int, start: int, per_frame: int) -> bytes:
    head = struct.pack("<BB4H", 2, KEY, len(table.names), analog_values, 1, len(table.time))
    head += struct.pack("<HfHHf", 0, _SCALE, start, per_frame, table.rate_hz)
    return head.ljust(BLOCK, b"\0")


def _points(table: MarkerTable) -> Float[Array, "frame value"]:
    seen = np.asarray(np.isfinite(table.positions).all(axis=2))
    places = np.where(seen[:, :, None], MM_PER_M * z_up(table.positions), 0.0)
    residual = np.where(seen, 0.0, -1.0)[:, :, None]
    return np.concatenate([places, residual], axis=2).reshape(len(table.time), -1)


def _point_group(table: MarkerTable, labels: list[str], start: int) -> dict[str, Value]:
    group: dict[str, Value] = {
        "USED": len(labels),
        "FRAMES": len(table.time),
        "SCALE": _SCALE,
        "RATE": float(table.rate_hz),
        "DATA_START": start,
        "UNITS": ["mm"],
    }
    for part in range(0, len(labels), MOST_LABELS):
        number = part // MOST_LABELS + 1
        group["LABELS" if number == 1 else f"LABELS{number}"] = labels[part : part + MOST_LABELS]
    return group


def _analog_group(count: int, rate_hz: float) -> dict[str, Value]:
    names = [f"{kind}{axis}{k // 6 + 1}" for k in range(0, count, 6) for kind in "FM" for axis in "xyz"]
    units = ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * (count // 6)
    group: dict[str, Value] = {"USED": count, "GEN_SCALE": 1.0, "RATE": float(rate_hz if count else 0.0)}
    if count:
        group |= {"SCALE": np.ones(count), "OFFSET": np.zeros(count, int), "LABELS": names, "UNITS": units}
    return group


def _plates(
    plates: PlateForces, table: MarkerTable, size_m: tuple[float, float], path: Path
) -> tuple[int, Float[Array, "sample channel"], dict[str, Value]]:
    """Samples per frame, the channels of all plates, and the group that describes them."""
    per_frame = round(plates.rate_hz / table.rate_hz)
    if len(plates.time) != per_frame * len(table.time) or abs(plates.time[0] - table.time[0]) > 1e-6:
        raise InputError(
            f"{len(plates.time)} force samples do not fit {len(table.time)} frames",
            where=str(path),
            hint="a C3D file needs a whole number of force samples in every frame: resample the forces",
        )
    channels, corners = [], []
    for k in range(len(plates.names)):
        force = z_up(np.nan_to_num(plates.force[:, k]))
        point = z_up(plates.point[:, k])
        known = point[np.isfinite(point).all(axis=1)]
        middle = np.median(known, axis=0) if len(known) else np.zeros(3)
        moment = z_up(np.nan_to_num(plates.torque[:, k])) + np.cross(np.nan_to_num(point - middle), force)
        channels += [force * _PLATE_AXES, MM_PER_M * moment * _PLATE_AXES]
        corners.append(
            [MM_PER_M * (middle + 0.5 * np.array([a * size_m[0], b * size_m[1], 0.0])) for a, b in _AROUND]
        )
    count = len(plates.names)
    group: dict[str, Value] = {
        "USED": count,
        "TYPE": np.full(count, 2),
        "ZERO": np.array([1, 0]),
        "CORNERS": np.array(corners),
        "ORIGIN": np.zeros((count, 3)),
        "CHANNEL": np.arange(1, 6 * count + 1).reshape(count, 6),
    }
    return per_frame, np.concatenate(channels, axis=1), group


def _encode(value: Value) -> tuple[int, tuple[int, ...], bytes]:
    """Type, extents (the fastest first) and bytes of a parameter."""
    if isinstance(value, np.ndarray):
        kind, code = (4, "<f4") if value.dtype.kind == "f" else (2, "<i2")
        return kind, value.shape[::-1], value.astype(code).tobytes()
    if isinstance(value, float):
        return 4, (), struct.pack("<f", value)
    if isinstance(value, int):
        return 2, (), struct.pack("<H", value)
    width = max(len(text) for text in value)
    return -1, (width, len(value)), b"".join(text.encode("ascii").ljust(width) for text in value)
