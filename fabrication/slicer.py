"""PrusaSlicer, where it is installed: a second opinion on every piece, and its time and filament.

The program runs beside ours and is no part of it (AGPL-3). It does not mind pieces larger than the bed: that
is checked here before (`fabrication.checks`).
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from fabrication.printers import Printer
from hilbrace.errors import ConfigError, InputError

PROGRAMS = ("prusa-slicer", "PrusaSlicer", "prusa-slicer-console")

TIMEOUT_S = 900
"""A piece that takes longer to slice is given up [s]."""

PLA_G_PER_ML = 1.24
"""Density of PLA [g/ml]."""

INFILL, PERIMETERS = "15%", 3
"""How full the pieces are printed, and how many beads make their walls."""


@dataclass(frozen=True)
class Opinion:
    """What the slicer says of a file.

    Attributes:
        manifold: Every edge has two triangles.
        open_edges: Edges that do not.
        parts: Bodies that do not hang together.
        volume_mm3: Volume [mm^3].
        size: Width, depth and height [mm].
    """

    manifold: bool
    open_edges: int
    parts: int
    volume_mm3: float
    size: tuple[float, float, float]


@dataclass(frozen=True)
class Slicing:
    """What printing a piece takes.

    Attributes:
        minutes: Estimated time [min].
        filament_g: Filament [g].
    """

    minutes: float
    filament_g: float


def slicer_program() -> str | None:
    """Path of PrusaSlicer, ``None`` where it is not installed."""
    return next((found for name in PROGRAMS if (found := shutil.which(name))), None)


def required_slicer() -> str:
    """Path of PrusaSlicer.

    Raises:
        ConfigError: It is not installed.
    """
    found = slicer_program()
    if found is None:
        raise ConfigError(
            "PrusaSlicer is not installed",
            where="--slice",
            hint="install it (Debian: apt install prusa-slicer), or leave --slice out",
        )
    return found


def ask_slicer(path: Path) -> Opinion:
    """Let the slicer look at a mesh file.

    Args:
        path: STL file of one piece.

    Raises:
        ConfigError: PrusaSlicer is not installed.
        InputError: It cannot read the file.
    """
    text = _run(["--info", str(path)], path)
    values = dict(re.findall(r"^(\w+)\s*=\s*(\S+)\s*$", text, re.MULTILINE))
    if "number_of_facets" not in values:
        raise InputError("the slicer finds no mesh", where=str(path), hint="write the file again")
    width, depth, height = (float(values[f"size_{axis}"]) for axis in "xyz")
    return Opinion(
        manifold=values.get("manifold") == "yes",
        open_edges=int(values.get("open_edges", 0)),
        parts=int(values["number_of_parts"]),
        volume_mm3=float(values["volume"]),
        size=(width, depth, height),
    )


def slice_piece(path: Path, printer: Printer, gcode: Path | None = None) -> Slicing:
    """Slice one piece and read time and filament from the comments of its G-code.

    Args:
        path: STL file as it stands on the bed.
        printer: The printer, filament printers only.
        gcode: Where the G-code goes; nowhere if left out.

    Raises:
        ConfigError: PrusaSlicer is not installed.
        InputError: It cannot slice the file.
    """
    with tempfile.TemporaryDirectory() as folder:
        target = gcode or Path(folder) / "piece.gcode"
        _run([*_settings(printer), str(path), "--output", str(target)], path)
        try:
            comments = [line for line in target.read_text("utf-8").splitlines() if line.startswith(";")]
        except FileNotFoundError:
            raise InputError(
                "the slicer wrote no G-code", where=str(path), hint="open the file in PrusaSlicer"
            ) from None
    return read_comments("\n".join(comments))


def read_comments(text: str) -> Slicing:
    """Time and filament from G-code comments.

    Raises:
        InputError: The comments do not say them.
    """
    weight = re.search(r"^; filament used \[g\] = ([\d.]+)", text, re.MULTILINE)
    duration = re.search(r"^; estimated printing time \(normal mode\) = (.+)$", text, re.MULTILINE)
    if weight is None or duration is None:
        raise InputError(
            "the G-code does not say time and filament",
            where="G-code",
            hint="use PrusaSlicer 2.5 or later",
        )
    share = {"d": 1440.0, "h": 60.0, "m": 1.0, "s": 1 / 60}
    minutes = sum(float(count) * share[unit] for count, unit in re.findall(r"(\d+)([dhms])", duration[1]))
    return Slicing(minutes, float(weight[1]))


def _settings(printer: Printer) -> list[str]:
    width, depth, height = printer.width_mm, printer.depth_mm, printer.height_mm
    return [
        "--export-gcode",
        *("--layer-height", f"{printer.layer_mm:g}", "--first-layer-height", f"{printer.layer_mm:g}"),
        *("--fill-density", INFILL, "--perimeters", str(PERIMETERS)),
        *("--bed-shape", f"0x0,{width:g}x0,{width:g}x{depth:g},0x{depth:g}"),
        *("--max-print-height", f"{height:g}", "--center", f"{width / 2:g},{depth / 2:g}"),
        *("--filament-density", f"{PLA_G_PER_ML:g}"),
    ]


def _run(arguments: list[str], path: Path) -> str:
    command = [required_slicer(), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        raise InputError(
            f"the slicer took longer than {TIMEOUT_S} s", where=str(path), hint="slice it by hand"
        ) from None
    if done.returncode != 0:
        reason = (done.stderr or done.stdout).strip().splitlines()
        raise InputError(
            f"the slicer refuses the file: {reason[-1] if reason else done.returncode}",
            where=str(path),
            hint="open the file in PrusaSlicer to see why",
        )
    return done.stdout
