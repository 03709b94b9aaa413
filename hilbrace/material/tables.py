"""The tables of the microstructures that ship with the package, and the program that makes them.

``python -m hilbrace.material.tables`` homogenizes every cell and writes one JSON file each, in the folder
of this package or in one given.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label

from hilbrace.material.cells import SKELETONS
from hilbrace.material.homogenize import coverage, homogenize, mean_modulus, subpixel_distance

Array = np.ndarray

FOLDER = Path(__file__).parent / "table"
SAMPLES = 25
"""Samples per cell, as in the paper."""
PIXELS = 128
POISSON = 0.45

VOLUME_RANGE: dict[str, tuple[float, float]] = {"voronoi_open": (0.10, 0.65), "sinusoidal": (0.10, 0.55)}
"""Volume fractions that the design variable spans in each cell [-].

The waves of the sinusoidal cell touch at a volume fraction of 0.62, where its modulus jumps threefold; its
range ends well below.
"""


def tabulate(
    name: str, pixels: int = PIXELS, poisson: float = POISSON, samples: int = SAMPLES
) -> dict[str, Any]:
    """Homogenize a cell at equal steps of strut width.

    Args:
        name: Name of the cell.
        pixels: Pixels per side of the cell.
        poisson: Poisson's ratio of the base material [-].
        samples: Widths between the ends of the cell's volume range.

    Returns:
        Columns: ``width`` [cell sides], ``volume`` [-], and relative to the base material's modulus
        ``E_mean``, ``C11``, ``C22``, ``C12``, ``C66``; besides them the figures they were made with.
    """
    distance = subpixel_distance(name, pixels)
    low, high = (_width_of_volume(distance, volume, pixels) for volume in VOLUME_RANGE[name])
    columns: dict[str, list[float]] = {
        k: [] for k in ("width", "volume", "E_mean", "C11", "C22", "C12", "C66")
    }
    for width in np.linspace(low, high, samples):
        density = coverage(distance, width, pixels)
        c = homogenize(density, poisson)
        row = (width, density.mean(), mean_modulus(c), c[0, 0], c[1, 1], c[0, 1], c[2, 2])
        for column, value in zip(columns.values(), row, strict=True):
            column.append(float(f"{value:.8g}"))
    pinch = float(f"{_pinch_width(distance, high):.4g}")
    return {"cell": name, "poisson": poisson, "pixels": pixels, "pinch_width": pinch, "columns": columns}


def write_tables(folder: Path) -> list[Path]:
    """Tabulate all cells into ``folder`` and return the files written."""
    written = []
    for name in SKELETONS:
        path = folder / f"{name}.json"
        path.write_text(json.dumps(tabulate(name), indent=1) + "\n", "utf-8")
        written.append(path)
    return written


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
    return float(steps[next(i for i, count in enumerate(counts) if count != counts[0])])


def _holes(void: Bool[Array, "row column"]) -> int:
    """Connected holes in one period, those cut by its border included."""
    return int(label(void, structure=np.ones((3, 3)))[1])  # pyright: ignore[reportIndexIssue]


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry of ``python -m hilbrace.material.tables``."""
    parser = argparse.ArgumentParser(
        prog="python -m hilbrace.material.tables", description=write_tables.__doc__
    )
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write (default: the package's)")
    for path in write_tables(parser.parse_args(arguments).out):
        sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
