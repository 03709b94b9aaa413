"""The tables of the microstructures, and the program that makes those that ship with the package.

``python -m hilbrace.material.tables`` homogenizes every built-in cell and writes one JSON file each, in the
folder of this package or in one given; ``hilbrace cells add FILE`` does so for a skeleton file of one's own.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import sqrtm
from scipy.ndimage import label

from hilbrace.config.material import CELLS
from hilbrace.errors import InputError
from hilbrace.material.homogenize import (
    coverage,
    homogenize,
    homogenize_shear,
    mean_modulus,
    subpixel_distance,
)
from hilbrace.material.skeleton_file import read_skeleton
from hilbrace.material.wall_cell import homogenize_wall
from hilbrace.run.progress import Report, silent
from hilbrace.run.records import write_atomic

Array = np.ndarray

FOLDER = Path(__file__).parent / "table"
SAMPLES = 25
"""Samples per cell, as in the paper."""
PIXELS = 128
POISSON = 0.45
COLUMNS = ("width", "volume", "E_mean", "C11", "C22", "C12", "C66", "K11", "K22")

WALL_LAYERS = 2
"""Elements through half of a wall."""
WALL_SAMPLES = 9
WALL_THICKNESS = (0.1, 0.2, 0.4, 0.8)
"""Thicknesses for which a wall is homogenized in three dimensions [cell sides]."""
STUDY_THICKNESS = 0.2

DEFAULT_RANGE = (0.10, 0.65)
_ROOM = 0.05
"""Volume fraction kept between the range of a cell without a stated one and the closing of its holes."""


def tabulate(
    name: str,
    pixels: int = PIXELS,
    poisson: float = POISSON,
    samples: int = SAMPLES,
    progress: Report = silent,
) -> dict[str, Any]:
    """Homogenize a cell at equal steps of strut width.

    Args:
        name: Name of the cell, or path of its skeleton file.
        pixels: Pixels per side of the cell; the walls take half of them.
        poisson: Poisson's ratio of the base material [-].
        samples: Widths between the ends of the cell's volume range.
        progress: Called with (done, total).

    Returns:
        Columns: ``width`` [cell sides], ``volume`` [-], and relative to the base material's modulus
        ``E_mean``, ``C11``, ``C22``, ``C12``, ``C66``, and the transverse shear ``K11``, ``K22`` relative to
        a solid wall; ``wall``: membrane and bending stiffness of walls of several thicknesses, each as the
        matrix R (11, 12, 22, 66) with ``sqrt(C) R sqrt(C)`` the stiffness; besides them the figures they were
        made with.
    """
    skeleton = read_skeleton(name)
    distance = subpixel_distance(name, pixels)
    low, high = (_width_of_volume(distance, v, pixels) for v in _volume_range(name, distance, pixels))
    widths = np.linspace(low, high, samples)
    wall_d = np.linspace(0.0, 1.0, min(WALL_SAMPLES, samples))
    total = len(widths) + len(wall_d)
    columns: dict[str, list[float]] = {key: [] for key in COLUMNS}
    for done, width in enumerate(widths):
        density = coverage(distance, width, pixels)
        c, k = homogenize(density, poisson), homogenize_shear(density)
        row = (width, density.mean(), mean_modulus(c), c[0, 0], c[1, 1], c[0, 1], c[2, 2], k[0, 0], k[1, 1])
        for column, value in zip(columns.values(), row, strict=True):
            column.append(_rounded(value, 8))
        progress(done + 1, total)
    wall_pixels = pixels // 2
    walls: dict[str, Any] = {key: [[] for _ in WALL_THICKNESS] for key in ("membrane", "bending")}
    for done, width in enumerate(low + wall_d * (high - low)):
        sheet = homogenize(coverage(distance, width, pixels), poisson)
        for place, thickness in enumerate(WALL_THICKNESS):
            membrane, bending = wall_ratios(name, width, thickness, wall_pixels, sheet, poisson)
            walls["membrane"][place].append(_entries(membrane, 6))
            walls["bending"][place].append(_entries(bending, 6))
        progress(len(widths) + done + 1, total)
    return {
        "cell": Path(name).stem,
        "skeleton": skeleton.digest,
        "poisson": poisson,
        "pixels": pixels,
        "pinch_width": _rounded(_pinch_width(distance, high), 4),
        "columns": columns,
        "wall": {
            "pixels": wall_pixels,
            "layers": WALL_LAYERS,
            "thickness": list(WALL_THICKNESS),
            "d": [_rounded(d, 8) for d in wall_d],
            **walls,
        },
    }


def wall_ratios(
    name: str,
    width: float,
    thickness: float,
    pixels: int,
    sheet: Float[Array, "3 3"],
    poisson: float,
) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    """Stiffness of a wall of finite thickness over that of a thin sheet: R with ``sqrt(C) R sqrt(C)``.

    A solid wall has R = 1. For stretching, both are from one grid of pixels, whose errors cancel; bending
    shares no mode of deformation with the sheet, so that ``sqrt(C) R sqrt(C)`` is just what the grid gives.

    Args:
        name: Name of the cell, or path of its skeleton file.
        width: Half width of the struts [cell sides].
        thickness: Thickness of the wall [cell sides].
        pixels: Pixels per side of the cell.
        sheet: Stiffness C of the thin sheet.
        poisson: Poisson's ratio of the base material [-].

    Returns:
        R of the membrane and of the bending stiffness.
    """
    density = coverage(subpixel_distance(name, pixels), width, pixels)
    wall = homogenize_wall(density, poisson, thickness, WALL_LAYERS)
    coarse, fine = (np.linalg.inv(np.real(sqrtm(c))) for c in (homogenize(density, poisson), sheet))
    return coarse @ wall.membrane @ coarse, fine @ wall.bending @ fine


def study(name: str, width: float, pixels: int = PIXELS, poisson: float = POISSON) -> dict[str, Any]:
    """How the figures of one width change with the resolution.

    Args:
        name: Name of the cell, or path of its skeleton file.
        width: Half width of the struts [cell sides].
        pixels: Pixels per side of the table; the study goes from a quarter of them to twice as many.
        poisson: Poisson's ratio of the base material [-].

    Returns:
        ``E_mean`` at ``pixels``, and the entries 11 and 66 of 12 D / (E t^3) at ``wall_pixels``.
    """
    grids = [pixels // 4, pixels // 2, pixels, 2 * pixels]
    wall_grids = [pixels // 4, 3 * pixels // 8, pixels // 2, 3 * pixels // 4]
    moduli = [
        mean_modulus(homogenize(coverage(subpixel_distance(name, n), width, n), poisson)) for n in grids
    ]
    walls = [
        homogenize_wall(
            coverage(subpixel_distance(name, n), width, n), poisson, STUDY_THICKNESS, WALL_LAYERS
        ).bending
        for n in wall_grids
    ]
    return {
        "width": _rounded(width, 8),
        "pixels": grids,
        "E_mean": [_rounded(value, 6) for value in moduli],
        "wall_thickness": STUDY_THICKNESS,
        "wall_pixels": wall_grids,
        "D11": [_rounded(bending[0, 0], 6) for bending in walls],
        "D66": [_rounded(bending[2, 2], 6) for bending in walls],
    }


def make_table(name: str, pixels: int = PIXELS, progress: Report = silent) -> dict[str, Any]:
    """The table of a cell as it ships: `tabulate`, and the `study` at the middle of its range.

    Args:
        name: Name of the cell, or path of its skeleton file.
        pixels: Pixels per side of the cell.
        progress: Called with (done, total).
    """
    table = tabulate(name, pixels, progress=progress)
    widths = table["columns"]["width"]
    return {**table, "study": study(name, widths[len(widths) // 2], pixels, table["poisson"])}


def write_table(table: dict[str, Any], path: Path) -> None:
    """Write a table, each list of numbers on one line."""
    text = json.dumps(table, indent=1)
    text = re.sub(r"\[[^\[\]{}]*\]", lambda numbers: f"[{' '.join(numbers[0][1:-1].split())}]", text)
    write_atomic(path, (text + "\n").encode())


def write_tables(folder: Path, names: Sequence[str] = CELLS) -> list[Path]:
    """Tabulate all built-in cells into ``folder`` and return the files written."""
    written = []
    for name in names:
        path = folder / f"{name}.json"
        write_table(make_table(name), path)
        written.append(path)
    return written


def _volume_range(name: str, distance: Float[Array, "row column"], pixels: int) -> tuple[float, float]:
    """The stated range, or one that ends before the first holes close.

    Raises:
        InputError: The holes close too early for a range of their own.
    """
    stated = read_skeleton(name).volume_range
    if stated is not None:
        return stated
    low, high = DEFAULT_RANGE
    pinch = _pinch_width(distance, _width_of_volume(distance, low, pixels))
    high = min(high, float(coverage(distance, pinch, pixels).mean()) - _ROOM)
    if high - low < 0.1:
        raise InputError(
            f"the first holes close at a volume fraction of {high + _ROOM:.2f}",
            where=f"{name}: volume_range",
            hint="draw a coarser skeleton, or state the range as volume_range = [low, high]",
        )
    return low, high


def _width_of_volume(distance: Float[Array, "row column"], volume: float, pixels: int) -> float:
    low, high = 0.0, float(distance.max())
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if coverage(distance, middle, pixels).mean() < volume else (low, middle)
    return (low + high) / 2


def _pinch_width(distance: Float[Array, "row column"], start: float) -> float:
    """Width above ``start`` at which the holes of the pattern first split or fill up [cell sides]."""
    cell = np.block([[distance, distance[:, ::-1]], [distance[::-1], distance[::-1, ::-1]]])
    steps = np.arange(start, distance.max(), 0.002)
    counts = [_holes(cell > width) for width in steps]
    closing = (float(w) for w, count in zip(steps, counts, strict=True) if count != counts[0])
    return next(closing, float(distance.max()))


def _holes(void: Bool[Array, "row column"]) -> int:
    """Connected holes in one period, those cut by its border included."""
    return int(label(void, structure=np.ones((3, 3)))[1])  # pyright: ignore[reportIndexIssue]


def _entries(matrix: Float[Array, "3 3"], digits: int) -> list[float]:
    """Entries 11, 12, 22, 66."""
    return [_rounded(matrix[i, j], digits) for i, j in ((0, 0), (0, 1), (1, 1), (2, 2))]


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry of ``python -m hilbrace.material.tables``."""
    parser = argparse.ArgumentParser(
        prog="python -m hilbrace.material.tables", description=write_tables.__doc__
    )
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write (default: the package's)")
    parser.add_argument("cells", nargs="*", default=CELLS, metavar="CELL", help="cells (default: all)")
    options = parser.parse_args(arguments)
    for path in write_tables(options.out, options.cells):
        sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
