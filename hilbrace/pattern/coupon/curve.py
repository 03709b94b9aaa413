"""Reader of a laboratory's tensile tests: a table of force and lengthening with units in its header."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError

Array = np.ndarray

LEAST_ROWS = 8
"""Fewest samples that make a curve."""
FORCE_N = {"mn": 1e-3, "n": 1.0, "kn": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216}
LENGTH_MM = {"um": 1e-3, "µm": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3, "in": 25.4}
STRAIN = {"-": 1.0, "1": 1.0, "%": 0.01, "mm/mm": 1.0}

_FORCE = re.compile(r"\b(force|load|kraft|last)", re.IGNORECASE)
_LENGTH = re.compile(r"\b(extension|displacement|elongation|lengthening|travel|weg)", re.IGNORECASE)
_STRAIN = re.compile(r"\b(strain|dehnung)", re.IGNORECASE)
_UNIT = re.compile(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$|_(\w+|%)$")


@dataclass(frozen=True)
class TensileCurve:
    """A measured curve.

    Attributes:
        name: File that it came from.
        row: Row of each sample in the file, counted from 1.
        lengthening_mm: Lengthening between the grips [mm].
        force_n: Force [N].
    """

    name: str
    row: tuple[int, ...]
    lengthening_mm: Float[Array, " sample"]
    force_n: Float[Array, " sample"]


def read_curve(path: Path, gauge_mm: float) -> TensileCurve:
    """Read a table of force and lengthening.

    Columns are told apart by their names (force or load; extension, displacement or strain) and carry their
    units in the header, as ``force [N]``, ``Load (kN)`` or ``extension_mm``, or in a second row of their own.
    Commas, semicolons and tabs part the columns; with semicolons or tabs a comma may be the decimal sign.

    Args:
        path: The file.
        gauge_mm: Distance of the grips, for a column of strains [mm].

    Raises:
        InputError: The file cannot be read, lacks a column or a unit, or a row holds no number; file and row
            are named.
    """
    table = _rows(path)
    header, first = _header(table, path)
    force_at, to_n = _column(header, _FORCE, FORCE_N, "force", path)
    if any(_LENGTH.search(name) for name, _ in header):
        length_at, to_mm = _column(header, _LENGTH, LENGTH_MM, "extension", path)
    else:
        length_at, to_mm = _column(header, _STRAIN, STRAIN, "extension", path)
        to_mm *= gauge_mm
    rows, values = [], []
    for number, cells in table[first:]:
        pair = [_number(cells, column, header[column][0], number, path) for column in (length_at, force_at)]
        rows.append(number)
        values.append(pair)
    if len(values) < LEAST_ROWS:
        raise InputError(
            f"{len(values)} rows of numbers are no curve",
            where=str(path),
            hint=f"give {LEAST_ROWS} or more samples of the pull",
        )
    lengthening, force = np.array(values).T
    return TensileCurve(path.name, tuple(rows), lengthening * to_mm, force * to_n)


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Rows that hold anything, with their numbers in the file."""
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(
            f"cannot be read: {fault.__class__.__name__}",
            where=str(path),
            hint="give the measured curve as a text file (CSV, UTF-8)",
        ) from None
    filled = [line for line in text.splitlines() if line.strip()]
    head = filled[0] if filled else ""
    delimiter = next((mark for mark in (";", "\t", ",") if mark in head), ",")
    numbered = enumerate(csv.reader(text.splitlines(), delimiter=delimiter), start=1)
    decimal = delimiter != ","
    return [
        (number, [cell.strip().replace(",", ".") if decimal else cell.strip() for cell in cells])
        for number, cells in numbered
        if any(cell.strip() for cell in cells)
    ]


def _header(table: list[tuple[int, list[str]]], path: Path) -> tuple[list[tuple[str, str | None]], int]:
    """Name and unit of each column, and the place of the first row of numbers."""
    if not table:
        raise InputError("the file is empty", where=str(path), hint="give a header and rows of numbers")
    names = table[0][1]
    if any(_is_number(cell) for cell in names):
        raise InputError(
            "the first row holds numbers, no names",
            where=f"{path}, row {table[0][0]}",
            hint="begin the file with a header such as: extension [mm], force [N]",
        )
    columns = [(name, _unit(name)) for name in names]
    if all(unit is None for _, unit in columns) and len(table) > 1:
        units = table[1][1]
        if len(units) == len(names) and not any(_is_number(cell) for cell in units):
            return [(name, unit.strip("()[] ").lower()) for name, unit in zip(names, units, strict=True)], 2
    return columns, 1


def _unit(name: str) -> str | None:
    found = _UNIT.search(name)
    return (found.group(1) or found.group(2)).strip().lower() if found else None


def _column(
    header: list[tuple[str, str | None]],
    wanted: re.Pattern[str],
    units: dict[str, float],
    what: str,
    path: Path,
) -> tuple[int, float]:
    """Place of a column and what one of its units is."""
    places = [k for k, (name, _) in enumerate(header) if wanted.search(name)]
    names = ", ".join(repr(name) for name, _ in header)
    if len(places) != 1:
        raise InputError(
            f"{len(places) or 'no'} columns of the {what} among {names}",
            where=f"{path}, header",
            hint="name one column 'force [N]' and one 'extension [mm]' (or 'strain [%]')",
        )
    name, unit = header[places[0]]
    if unit not in units:
        raise InputError(
            f"column '{name}' has no unit"
            if unit is None
            else f"column '{name}' has the unknown unit '{unit}'",
            where=f"{path}, header",
            hint=f"write the unit behind the name, one of {', '.join(units)}: '{what} [{next(iter(units))}]'",
        )
    return places[0], units[unit]


def _number(cells: list[str], column: int, name: str, row: int, path: Path) -> float:
    text = cells[column] if column < len(cells) else ""
    if not _is_number(text):
        raise InputError(
            f"'{text}' in column '{name}' is no number",
            where=f"{path}, row {row}",
            hint="mend the row, or cut the file off before it",
        )
    return float(text)


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
