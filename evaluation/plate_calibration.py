"""What one count of each channel of a force plate means, from the file that came with the plate.

Three forms are read:

* TOML, which says everything (see `load_calibration`), also for plates with four vertical cells;
* a text file of six rows, separated by blanks, tabs or commas;
* ``.acl`` files, whose rows read ``COEFFROW1: a, b, ...``.

The last two hold numbers only, so that the units must be told. AMTI's matrices give the load that the person
puts on the plate, in axes whose z points down, about a point some centimetres below the surface.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from evaluation.sources.stream import PlateInfo
from hilbrace.errors import InputError
from hilbrace.motion.recording import from_z_up
from hilbrace.units import MM_PER_M

Array = np.ndarray

NEWTON_PER_POUND = 4.4482216152605
"""Pound-force [N] (0.45359237 kg at standard gravity)."""

METRES_PER_INCH = 0.0254

UNITS = {
    "N, N*m": (1.0, 1.0),
    "N, N*mm": (1.0, 1.0 / MM_PER_M),
    "lb, in*lb": (NEWTON_PER_POUND, NEWTON_PER_POUND * METRES_PER_INCH),
}
"""Units of force and moment that calibration files use, in N and N*m."""

KEYS = {
    "name", "units", "load", "z_axis", "sensor_depth_mm", "noise_n", "matrix",
    "corners_mm", "newtons_per_count", "empty_counts", "surface_mm",
}  # fmt: skip

_ROW = re.compile(r"\s*COEFF_?ROW\w*\s*[:=](.*)", re.IGNORECASE)


@dataclass(frozen=True)
class PlateCalibration:
    """A plate's calibration, as a load of the ground on the subject.

    Attributes:
        name: Name of the plate or file.
        matrix: What one count of each channel adds to force [N] and moment [N*m] on the subject, in the
            plate's axes and about its origin.
        z_axis: Where the plate's z axis points.
        surface_z: The surface on the plate's z axis [m].
        surface_size: Extent along the plate's x and y axes [m]; NaN where unknown.
        noise_n: Standard deviation of the vertical force of the plate at rest [N].
        empty: Counts of the empty plate when it was calibrated; NaN where unknown.
    """

    name: str
    matrix: Float[Array, "6 channel"]
    z_axis: Literal["up", "down"]
    surface_z: float
    surface_size: tuple[float, float]
    noise_n: float
    empty: Float[Array, " channel"]


@dataclass(frozen=True)
class Placement:
    """Where a plate lies in the laboratory.

    Attributes:
        centre: Middle of its surface, in the laboratory's axes [m].
        heading_deg: Turn of the plate's x axis about the upward vertical, from the laboratory's x axis [deg].
        up: The laboratory's vertical axis.
    """

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_deg: float = 0.0
    up: Literal["y", "z"] = "z"


def load_calibration(
    path: Path, units: str | None = None, sensor_depth_mm: float | None = None
) -> PlateCalibration:
    """Read a calibration file.

    A TOML file holds ``units`` (one of `UNITS`), either ``matrix`` (six rows) or, for plates of vertical
    cells, ``corners_mm`` with ``newtons_per_count``, and where they differ from AMTI's: ``load``
    (``"on_plate"``, ``"on_subject"``), ``z_axis`` (``"down"``, ``"up"``), ``sensor_depth_mm`` (origin below
    the surface; 0), ``surface_mm``, ``noise_n`` (1), ``empty_counts``, ``name``.

    Args:
        path: The file: TOML, or rows of numbers.
        units: Units of files that hold numbers only.
        sensor_depth_mm: Origin below the surface [mm], for files that hold numbers only.

    Raises:
        InputError: The file is missing, has no six rows, or does not say its units.
    """
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(
            "the calibration file cannot be read", where=f"{path}: {fault}", hint="check the path"
        ) from fault
    if path.suffix.lower() == ".toml":
        return _from_table(_table(text, path), path)
    rows = _acl_rows(text) or [line for line in text.splitlines() if line.strip() and line.strip()[0] != "#"]
    matrix = _matrix([_numbers(row, path) for row in rows], path)
    return _calibration(
        path.stem, matrix, _factors(units, path), {"sensor_depth_mm": sensor_depth_mm or 0.0}, path
    )


def plate_info(
    name: str,
    rate_hz: float,
    channels: tuple[str, ...],
    calibration: PlateCalibration,
    placement: Placement,
) -> PlateInfo:
    """A plate of raw counts in its place in the laboratory.

    Args:
        name: The plate's name.
        rate_hz: Samples per second [Hz].
        channels: Names of the channels that the device sends.
        calibration: What they mean.
        placement: Where the plate lies.

    Raises:
        InputError: The device sends another number of channels than the calibration has columns.
    """
    columns = calibration.matrix.shape[1]
    if len(channels) != columns:
        raise InputError(
            f"the plate sends {len(channels)} channels, its calibration has {columns}",
            where=f"plate '{name}', calibration '{calibration.name}'",
            hint="give the calibration file of this very plate",
        )
    axes = _axes(calibration, placement)
    surface = np.array([0.0, 0.0, calibration.surface_z])
    origin = np.array(placement.centre) - axes @ surface
    half = np.array(calibration.surface_size) / 2
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    flat = np.column_stack([signs * half, np.full(4, calibration.surface_z)])
    return PlateInfo(
        name=name,
        rate_hz=rate_hz,
        channels=channels,
        units=("count",) * columns,
        calibration=calibration.matrix,
        rotation=axes,
        origin=origin,
        corners=origin + flat @ axes.T,
        zeroed=False,
        noise_n=calibration.noise_n,
        empty=tuple(calibration.empty.tolist()) if np.isfinite(calibration.empty).all() else (),
    )


def _axes(calibration: PlateCalibration, placement: Placement) -> Float[Array, "3 3"]:
    """Axes of the plate as columns, in the laboratory's axes."""
    heading = np.radians(placement.heading_deg)
    turn = np.array(
        [[np.cos(heading), -np.sin(heading), 0.0], [np.sin(heading), np.cos(heading), 0.0], [0.0, 0.0, 1.0]]
    )
    columns = turn @ np.diag([1.0, -1.0, -1.0]) if calibration.z_axis == "down" else turn
    return columns if placement.up == "z" else from_z_up(columns.T).T


def _table(text: str, path: Path) -> dict[str, Any]:
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise _unusable(f"this is no TOML: {fault}", path) from fault
    if unknown := sorted(set(table) - KEYS):
        raise _unusable(f"unknown key '{unknown[0]}'; known are {', '.join(sorted(KEYS))}", path)
    return table


def _from_table(table: dict[str, Any], path: Path) -> PlateCalibration:
    factors = _factors(table.get("units"), path)
    if ("matrix" in table) == ("corners_mm" in table):
        raise _unusable("give either 'matrix' or 'corners_mm' with 'newtons_per_count'", path)
    if "matrix" in table:
        matrix = _matrix(table["matrix"], path)
    else:
        matrix = corner_matrix(
            _array(table["corners_mm"], "corners_mm", path) / MM_PER_M,
            _array(table.get("newtons_per_count", []), "newtons_per_count", path),
        )
        factors = UNITS["N, N*m"]
    return _calibration(str(table.get("name", path.stem)), matrix, factors, table, path)


def corner_matrix(
    corners: Float[Array, "cell 2"], newtons_per_count: Float[Array, " cell"]
) -> Float[Array, "6 cell"]:
    """Calibration of a plate that stands on cells which measure vertical force only.

    The centre of pressure then is sum(f_i r_i) / sum(f_i); shear stays unknown and is given as zero.

    Args:
        corners: Places of the cells on the plate's x and y axes [m].
        newtons_per_count: Force of each cell per count, along the plate's z axis [N].

    Raises:
        InputError: The numbers of places and factors differ.
    """
    if corners.shape != (len(newtons_per_count), 2) or len(corners) < 3:
        raise InputError(
            f"{len(corners)} cells and {len(newtons_per_count)} factors",
            where="corners_mm, newtons_per_count",
            hint="give x and y of at least three cells, and one factor for each",
        )
    matrix = np.zeros((6, len(corners)))
    matrix[2] = newtons_per_count
    matrix[3] = corners[:, 1] * newtons_per_count
    matrix[4] = -corners[:, 0] * newtons_per_count
    return matrix


def _calibration(
    name: str,
    matrix: Float[Array, "6 channel"],
    factors: tuple[float, float],
    table: dict[str, Any],
    path: Path,
) -> PlateCalibration:
    z_axis, load = table.get("z_axis", "down"), table.get("load", "on_plate")
    if z_axis not in ("up", "down") or load not in ("on_plate", "on_subject"):
        raise _unusable("z_axis is 'up' or 'down', load is 'on_plate' or 'on_subject'", path)
    depth = float(table.get("sensor_depth_mm", 0.0)) / MM_PER_M
    size = _array(table.get("surface_mm", [np.nan, np.nan]), "surface_mm", path) / MM_PER_M
    empty = _array(table.get("empty_counts", [np.nan] * matrix.shape[1]), "empty_counts", path)
    if size.shape != (2,) or empty.shape != (matrix.shape[1],):
        raise _unusable("surface_mm has two numbers, empty_counts one for each channel", path)
    sign = 1.0 if load == "on_subject" else -1.0
    scale = sign * np.repeat(factors, 3)[:, None]
    return PlateCalibration(
        name=name,
        matrix=scale * matrix,
        z_axis=z_axis,
        surface_z=-depth if z_axis == "down" else depth,
        surface_size=(float(size[0]), float(size[1])),
        noise_n=float(table.get("noise_n", 1.0)),
        empty=empty,
    )


def _matrix(rows: Any, path: Path) -> Float[Array, "6 channel"]:
    widths = [len(row) if isinstance(row, list) else 0 for row in rows] if isinstance(rows, list) else []
    if len(widths) != 6 or len(set(widths)) != 1 or widths[0] < 1:
        raise _unusable(
            f"a calibration matrix has 6 rows of equal length, this one has rows of {widths or 'nothing'}",
            path,
        )
    return _array(rows, "matrix", path)


def _array(values: Any, key: str, path: Path) -> Float[Array, "..."]:
    try:
        array = np.array(values, float)
    except (TypeError, ValueError) as fault:
        raise _unusable(f"{key} holds something that is no number", path) from fault
    if np.isinf(array).any() or (key == "matrix" and np.isnan(array).any()):
        raise _unusable(f"{key} holds something that is no finite number", path)
    return array


def _acl_rows(text: str) -> list[str]:
    return [found[1] for line in text.splitlines() if (found := _ROW.match(line))]


def _numbers(row: str, path: Path) -> list[float]:
    try:
        return [float(word) for word in re.split(r"[,;\s]+", row.strip(" ,;\t")) if word]
    except ValueError as fault:
        raise _unusable(f"this row holds something that is no number: {row.strip()[:60]}", path) from fault


def _factors(units: Any, path: Path) -> tuple[float, float]:
    if units not in UNITS:
        raise InputError(
            f"units {units!r} are unknown" if units else "the file does not say its units",
            where=str(path),
            hint="give the units of force and moment as one of: " + "; ".join(f'"{u}"' for u in UNITS),
        )
    return UNITS[units]


def _unusable(what: str, path: Path) -> InputError:
    return InputError(
        what, where=str(path), hint="compare the file with the plate's sheet (docs/serial_plate.md)"
    )
