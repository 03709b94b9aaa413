"""Text files of OpenSim: marker tables (TRC) and storages (MOT, STO).

Nothing is lost in silence. An empty cell, NaN or the exact point (0, 0, 0), which motion-capture programs
write for a hidden marker, is a gap and reads as NaN. A row that is shorter than its header promises, or
fewer rows than promised, or a last line without an end, means that the file was cut short: it is refused.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.run.records import write_atomic
from hilbrace.units import DEG, LENGTH_TO_M

Array = np.ndarray

_TRC_FIELDS = "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames"
_TRC_DECIMALS = {"m": 7, "cm": 5, "mm": 4}
_FORBIDDEN_IN_NAMES = re.compile(r"[\t\r\n]|^\s|\s$|^$")


@dataclass(frozen=True)
class MarkerTable:
    """Markers over time, in the axes of their file.

    Attributes:
        names: Marker names.
        time: Instants, evenly spaced [s].
        rate_hz: Frames per second [Hz].
        positions: Marker positions [m]; NaN in gaps.
    """

    names: tuple[str, ...]
    time: Float[Array, " frame"]
    rate_hz: float
    positions: Float[Array, "frame marker 3"]


@dataclass(frozen=True)
class Storage:
    """Named columns over time, as a MOT or STO file holds them.

    Attributes:
        time: Instants [s].
        columns: Values by column name, in the units of the file.
        degrees: Whether the file says that its rotations are in degrees.
    """

    time: Float[Array, " row"]
    columns: dict[str, Float[Array, " row"]]
    degrees: bool


def write_trc(
    path: Path,
    time: Float[Array, " frame"],
    rate_hz: float,
    names: tuple[str, ...],
    markers_m: Float[Array, "frame marker 3"],
    units: str = "m",
) -> None:
    """Write markers as a TRC file; gaps become empty cells.

    Args:
        path: File to write.
        time: Instants [s].
        rate_hz: Marker rate [Hz].
        names: Marker names.
        markers_m: Positions [m].
        units: Unit inside the file, ``"m"``, ``"cm"`` or ``"mm"``; resolution is 0.1 micrometre.

    Raises:
        InputError: Names or shapes do not fit a TRC file.
    """
    _check_names(names, path)
    if units not in _TRC_DECIMALS or markers_m.shape != (len(time), len(names), 3):
        raise InputError(
            f"array {markers_m.shape} in '{units}' does not fit {len(time)} frames, {len(names)} names",
            where=str(path),
            hint=f"give an array (frame, marker, 3) and one of the units {', '.join(_TRC_DECIMALS)}",
        )
    frames, count = len(time), len(names)
    header = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "\t".join(_TRC_FIELDS.split()),
        f"{rate_hz:.10g}\t{rate_hz:.10g}\t{frames}\t{count}\t{units}\t{rate_hz:.10g}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, count + 1)),
        "",
    ]
    cell = f"%.{_TRC_DECIMALS[units]}f"
    scaled = (markers_m / LENGTH_TO_M[units]).reshape(frames, -1)
    rows = [
        f"{k}\t{instant:.8f}\t" + "\t".join("" if value != value else cell % value for value in row)
        for k, (instant, row) in enumerate(zip(time.tolist(), scaled.tolist(), strict=True), 1)
    ]
    write_atomic(path, ("\n".join(header + rows) + "\n").encode())


def write_storage(
    path: Path,
    time: Float[Array, " row"],
    columns: dict[str, Float[Array, " row"]],
    degrees: bool,
    name: str = "storage",
) -> None:
    """Write named columns as a MOT or STO file.

    Args:
        path: File to write.
        time: Instants [s].
        columns: Values by column name; ``time`` is added in front.
        degrees: Whether rotations are in degrees. OpenSim never converts the dependent coordinates
            ``*_beta``: they are radians in either case.
        name: Title in the first line.

    Raises:
        InputError: Names or lengths do not fit a storage.
    """
    _check_names((*columns, name), path)
    wrong = [label for label, values in columns.items() if values.shape != time.shape]
    if wrong or "time" in columns:
        raise InputError(
            f"column '{wrong[0] if wrong else 'time'}' does not fit {len(time)} instants",
            where=str(path),
            hint="give one value per instant in every column, and time apart",
        )
    header = [
        name,
        "version=1",
        f"nRows={len(time)}",
        f"nColumns={len(columns) + 1}",
        f"inDegrees={'yes' if degrees else 'no'}",
        "endheader",
        "\t".join(("time", *columns)),
    ]
    table = np.column_stack([time, *columns.values()]).tolist()
    rows = ["\t".join([f"{value:.10g}" for value in row]) for row in table]
    write_atomic(path, ("\n".join(header + rows) + "\n").encode())


def read_trc(path: Path) -> MarkerTable:
    """Read a TRC file.

    Raises:
        InputError: The file is missing, cut short, names no units, or holds a cell that is no number.
    """
    lines = _lines(path)
    rate_hz, frames, count, scale = _trc_header(lines, path)
    names = _trc_names(lines[3], count, path)
    table = _numbers(
        lines, 5, 2 + 3 * count, ["Frame#", "Time", *(f"{n}.{a}" for n in names for a in "xyz")], path
    )
    if len(table) != frames:
        raise _wrong_rows("NumFrames", frames, len(table), path)
    positions = scale * table[:, 2:].reshape(frames, count, 3)
    positions[np.all(positions == 0, axis=2) | np.isnan(positions).any(axis=2)] = np.nan
    return MarkerTable(names, even_time(table[:, 1], rate_hz, path), rate_hz, positions)


def read_storage(path: Path) -> Storage:
    """Read a MOT or STO file.

    Files without ``inDegrees`` hold radians (OpenSim's own rule). ``nColumns`` is not believed (OpenSim's own
    examples have wrong ones): every row must fit the line of names instead.

    Raises:
        InputError: The file is missing, cut short, or holds a cell that is no number.
    """
    lines = _lines(path)
    header, first = _storage_header(lines, path)
    labels = lines[first].split("\t") if "\t" in lines[first] else lines[first].split()
    labels = [label.strip() for label in labels if label.strip()]
    if not labels or labels[0].lower() != "time" or len(set(labels)) != len(labels):
        raise InputError(
            "the column names do not start with 'time', or repeat",
            where=f"{path}, line {first + 1}",
            hint="name every column once, 'time' first",
        )
    table = _numbers(lines, first + 1, len(labels), labels, path)
    rows = header.get("nrows", header.get("datarows", len(table)))
    if rows != len(table):
        raise _wrong_rows("nRows", rows, len(table), path)
    _check_increasing(table[:, 0], path)
    columns = {label: table[:, k].copy() for k, label in enumerate(labels) if k}
    return Storage(table[:, 0].copy(), columns, bool(header.get("indegrees", 0)))


def coordinates_rad(storage: Storage) -> dict[str, Float[Array, " row"]]:
    """The generalised coordinates of a storage in rad and m.

    Translations (``pelvis_tx``, ...) and OpenSim's dependent coordinates (``*_beta``, radians even in files
    of degrees) pass unchanged.
    """
    kept = re.compile(r"_(t[xyz]|beta)$")
    factor = DEG if storage.degrees else 1.0
    return {name: v if kept.search(name) else factor * v for name, v in storage.columns.items()}


def even_time(time: Float[Array, " frame"], rate_hz: float, source: Path | str) -> Float[Array, " frame"]:
    """Evenly spaced instants for a column of rounded ones.

    Raises:
        InputError: Instants are missing, or do not agree with the rate.
    """
    if len(time) < 2 or not np.isfinite(time).all():
        raise InputError("no two frames with a time", where=str(source), hint="export the whole recording")
    even = time[0] + np.arange(len(time)) / rate_hz
    step = (time[-1] - time[0]) / (len(time) - 1)
    if abs(step * rate_hz - 1) > 0.02:
        raise InputError(
            f"frames are {step:.6g} s apart, the header says {rate_hz:g} Hz",
            where=str(source),
            hint="export the file again, or correct DataRate",
        )
    if np.abs(time - even).max() > 0.6 / rate_hz:
        even = np.linspace(time[0], time[-1], len(time))
    late = np.flatnonzero(np.abs(time - even) > 0.6 / rate_hz)
    if late.size:
        raise InputError(
            f"time is not evenly spaced: {time[late[0]]:.6g} s where {even[late[0]]:.6g} s was due",
            where=f"{source}, row {late[0] + 1}",
            hint="leave gaps empty, but keep every row",
        )
    return even


def _lines(path: Path) -> list[str]:
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", where=str(path), hint="check the path") from None
    except OSError as fault:
        raise InputError(
            f"cannot be read: {fault.strerror}", where=str(path), hint="check the path"
        ) from None
    text = content.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    return text.split("\n")


def _trc_header(lines: list[str], path: Path) -> tuple[float, int, int, float]:
    """Rate [Hz], frames, markers and metres per unit, from the second and third line."""
    keys, values = (lines[1].split(), lines[2].split()) if len(lines) > 4 else ([], [])
    if "Units" not in keys or "DataRate" not in keys or not lines[0].lstrip().startswith("PathFileType"):
        raise InputError(
            "not a TRC file, or its header names no units",
            where=f"{path}, line 2",
            hint=f"the second line of a TRC file reads {_TRC_FIELDS}",
        )
    header = dict(zip(keys, values, strict=False))
    units = header.get("Units", "").lower()
    if units not in LENGTH_TO_M:
        raise InputError(
            f"units '{units}' are not {', '.join(LENGTH_TO_M)}",
            where=f"{path}, line 3",
            hint="write the unit of the positions under 'Units'",
        )
    try:
        rate, frames, count = float(header["DataRate"]), int(header["NumFrames"]), int(header["NumMarkers"])
        if not (0 < rate < 1e6 and frames > 0 and count > 0):
            raise ValueError
    except (KeyError, ValueError):
        raise InputError(
            "DataRate, NumFrames or NumMarkers is no positive number",
            where=f"{path}, line 3",
            hint="export the file again, or correct the header",
        ) from None
    return rate, frames, count, LENGTH_TO_M[units]


def _trc_names(line: str, count: int, path: Path) -> tuple[str, ...]:
    """Marker names; an unnamed trajectory is called ``*k``, as in C3D files."""
    cells = [cell.strip() for cell in line.split("\t")]
    names = [cell for cell in cells[2:] if cell]
    if len(names) < count and len(cells) >= 3 * count:
        names = [cell or f"*{k}" for k, cell in enumerate((cells[2::3] + [""] * count)[:count], 1)]
    if len(names) != count or len(set(names)) != count or all(name.startswith("*") for name in names):
        raise InputError(
            f"header promises {count} markers, line 4 names {len(set(cells[2:]) - {''})} different ones",
            where=f"{path}, line 4",
            hint="name every marker once, or correct NumMarkers",
        )
    return tuple(names)


def _storage_header(lines: list[str], path: Path) -> tuple[dict[str, int], int]:
    """Counts and flags in lower case, and the index of the line of column names."""
    ends = [k for k, line in enumerate(lines) if line.strip().lower() == "endheader"][:1]
    if not ends or ends[0] + 1 >= len(lines):
        raise InputError(
            "no line 'endheader': not a MOT or STO file", where=str(path), hint="export it from OpenSim again"
        )
    pattern = re.compile(r"\s*(nRows|datarows|inDegrees)\s*[= ]\s*(\w+)\s*$", re.IGNORECASE)
    found = [match.groups() for line in lines[: ends[0]] if (match := pattern.match(line))]
    words = {"yes": 1, "no": 0, "true": 1, "false": 0}
    try:
        header = {key.lower(): words[v.lower()] if v.lower() in words else int(v) for key, v in found}
    except ValueError as fault:
        raise InputError(str(fault), where=f"{path}, header", hint="correct the header") from None
    first = next((k for k in range(ends[0] + 1, len(lines)) if lines[k].strip()), ends[0] + 1)
    return header, first


def _numbers(
    lines: list[str], first: int, width: int, labels: list[str], path: Path
) -> Float[Array, "row column"]:
    """The table below the header; empty cells are NaN."""
    if lines[-1].strip():
        raise InputError(
            "the last line does not end: the file may be cut short",
            where=f"{path}, line {len(lines)}",
            hint="copy or export it again; if it is whole, end it with a line break",
        )
    rows: list[list[float]] = []
    for number, line in enumerate(lines[first:], first + 1):
        if not line.strip():
            continue
        cells = line.split("\t")
        if len(cells) != width:
            cells = _refit(line, cells, width, f"{path}, line {number}")
        try:
            rows.append([float(cell) if cell else np.nan for cell in cells])
        except ValueError:
            rows.append([_number(cell, f"{path}, line {number}, column {k + 1} '{labels[k]}'")
                         for k, cell in enumerate(cells)])  # fmt: skip
    table = np.array(rows, float).reshape(len(rows), width)
    if np.isinf(table).any():
        row, column = np.argwhere(np.isinf(table))[0]
        raise InputError(
            "a value is infinite",
            where=f"{path}, data row {row + 1}, column '{labels[column]}'",
            hint="export the file again, with gaps empty",
        )
    return table


def _refit(line: str, cells: list[str], width: int, where: str) -> list[str]:
    """Cells of a row with trailing tabs, or with blanks between its numbers."""
    if len(cells) > width and not any(cell.strip() for cell in cells[width:]):
        return cells[:width]
    words = line.split()
    if len(words) == width:
        return words
    raise InputError(
        f"the row has {len(cells)} cells where the header names {width}",
        where=where,
        hint="the file is cut short or damaged: copy or export it again",
    )


def _number(cell: str, where: str) -> float:
    if not cell.strip():
        return np.nan
    try:
        return float(cell)
    except ValueError:
        comma = re.fullmatch(r"\s*[-+]?\d*,\d+\s*", cell)
        hint = "write decimals with a point" if comma else "leave a gap empty, or write a number"
        raise InputError(f"'{cell.strip()[:40]}' is no number", where=where, hint=hint) from None


def _wrong_rows(key: str, promised: int, found: int, path: Path) -> InputError:
    return InputError(
        f"header promises {promised} rows ({key}), the file holds {found}",
        where=str(path),
        hint="the file is cut short or was edited: copy or export it again, or correct the header",
    )


def _check_increasing(time: Float[Array, " row"], path: Path) -> None:
    back = np.flatnonzero(~(np.diff(time) > 0))
    if len(time) < 2 or back.size or not np.isfinite(time).all():
        row = int(back[0]) + 2 if back.size else 1
        raise InputError(
            "time does not increase",
            where=f"{path}, data row {row}",
            hint="sort the rows, drop repeated ones",
        )


def _check_names(names: tuple[str, ...], path: Path) -> None:
    bad = [name for name in names if _FORBIDDEN_IN_NAMES.search(name)]
    if bad or len(set(names)) != len(names):
        raise InputError(
            f"names must differ and hold no tabs or line breaks: {bad[:3] or 'repeated names'}",
            where=str(path),
            hint="rename them",
        )
