"""What ``hilbrace cells`` does: compare microstructures, draw them, and take in a new one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hilbrace.config.material import CELLS
from hilbrace.errors import ConfigError, InputError
from hilbrace.material.cell_figures import bounds_at, cell_samples, figures_of, papers_order, samples_csv
from hilbrace.material.cell_pictures import write_pictures
from hilbrace.material.curves import table_path
from hilbrace.material.skeleton_file import read_skeleton
from hilbrace.material.tables import PIXELS, make_table, write_table
from hilbrace.run.progress import Report, silent
from hilbrace.run.records import write_atomic

ADD = "add"
FEWEST_PIXELS, MOST_PIXELS = 16, 256
"""Pixels per side of a cell; 256 take some ten minutes."""


def chosen_cells(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Cells to take in and cells to show, from the words of the command.

    Args:
        words: ``["add", "my_cell.toml"]``, or names and paths of cells; nothing for all built-in ones.

    Raises:
        ConfigError: ``add`` without a file, or with something that is no skeleton file.
    """
    if not words or words[0] != ADD:
        return [], list(dict.fromkeys(words)) or list(CELLS)
    added = list(dict.fromkeys(words[1:]))
    wrong = [word for word in added if not word.endswith(".toml")]
    if wrong or not added:
        raise ConfigError(
            f"'{wrong[0]}' is no skeleton file" if wrong else "no skeleton file is named",
            where="hilbrace cells add",
            hint="name one or more files that end in .toml: hilbrace cells add my_cell.toml",
        )
    return added, [*CELLS, *added]


def add_cell(path: str, pixels: int = PIXELS, progress: Report = silent) -> Path:
    """Homogenize a cell of one's own and write its table beside its skeleton file.

    Args:
        path: The skeleton file.
        pixels: Pixels per side of the cell.
        progress: Called with (done, total).

    Returns:
        The table, ``my_cell.table.json`` beside ``my_cell.toml``.

    Raises:
        ConfigError: Too few or too many pixels.
        InputError: The skeleton is broken, or the folder cannot be written.
    """
    if not FEWEST_PIXELS <= pixels <= MOST_PIXELS:
        raise ConfigError(
            f"{pixels} pixels a side", where="--pixels", hint=f"from {FEWEST_PIXELS} to {MOST_PIXELS}"
        )
    read_skeleton(path)
    target = table_path(path)
    if not os.access(target.parent, os.W_OK):
        raise InputError(
            "the folder cannot be written",
            where=str(target.parent),
            hint="copy the skeleton file to a folder of your own: its table is written beside it",
        )
    write_table(make_table(path, pixels, progress), target)
    return target


def atlas(names: Sequence[str], volume: float, folder: Path) -> dict[str, Any]:
    """Figures of the cells, and their pictures and samples in a folder.

    Args:
        names: Names of built-in cells, paths of skeleton files.
        volume: Volume fraction of the figures that need one [-].
        folder: Where to write; made if absent.

    Raises:
        ConfigError: A name is unknown, or the volume fraction is none.
        InputError: A cell of one's own is broken or not homogenized.
    """
    if not 0.02 <= volume <= 0.95:
        raise ConfigError(
            f"{volume:g} is no volume fraction of a microstructure",
            where="--volume",
            hint="give a number from 0.02 to 0.95",
        )
    cells = [cell_samples(name) for name in names]
    files = write_pictures(cells, volume, folder)
    table = folder / "cells.csv"
    write_atomic(table, samples_csv(cells).encode())
    return {
        "cells": [figures_of(cell, volume) for cell in cells],
        "bounds": bounds_at(volume),
        "order": papers_order(cells),
        "files": [str(path) for path in (*files, table)],
    }


def atlas_text(figures: dict[str, Any]) -> str:
    """The table that people read.

    Args:
        figures: As `atlas` returns them.
    """
    volume = figures["bounds"]["volume"]
    head = (
        "cell",
        "V range",
        "E mean",
        "E u",
        "E v",
        "E 45",
        "nu",
        "nu u",
        "bend u",
        "bend v",
        "twist",
        "fit E",
    )
    head = (*head, "fit V", "thin end", "rest", "grid")
    rows = [head, *(_row(cell) for cell in figures["cells"])]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            word.ljust(size) if place == 0 else word.rjust(size)
            for place, (word, size) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    bounds = figures["bounds"]
    voigt, isotropic = bounds["voigt"], bounds["hashin_shtrikman"]
    notes = [
        f"E, nu: at volume fraction {volume:g}, over the solid's modulus; means over all directions,",
        "  and along u, v and between; '-' out of range.",
        f"  Bounds: {voigt:.4g} in any direction (Voigt), {isotropic:.4g} if isotropic (Hashin-Shtrikman).",
        "bend, twist: bending over stretching, twist over shear; 1 is a solid sheet. Wall: 0.25 cell sides.",
        "fit: mean squared error of the cubics through the samples.",
        "thin end, rest: largest relative error of the cubic of E in the thinner and the thicker half.",
        "grid: change of E mean at the middle of the range when the pixels are halved once more.",
        "Order at equal volume; the paper has Voronoi stiffest and the sinusoidal grid softest:",
        *(f"  {sentence}." for sentence in figures["order"]),
    ]
    if not figures["order"]:
        notes[-1] = "Order at equal volume: compare the sinusoidal grid with others to see it."
    return "\n".join([*lines, "", *notes, "", "written:", *(f"  {path}" for path in figures["files"]), ""])


def _row(cell: dict[str, Any]) -> tuple[str, ...]:
    at = cell["at_volume"]
    moduli = ["-" if at[key] is None else f"{at[key]:.4f}" for key in ("E_mean", "E_1", "E_2", "E_45")]
    ratios = ["-" if at[key] is None else f"{at[key]:.2f}" for key in ("nu", "nu_12")]
    keys = ("bending_1_over_stretch", "bending_2_over_stretch", "twist_over_shear")
    bending = ["-" if at[key] is None else f"{at[key]:.1f}" for key in keys]
    return (
        cell["name"],
        f"{cell['volume_low']:.2f}-{cell['volume_high']:.2f}",
        *moduli,
        *ratios,
        *bending,
        f"{cell['f_E_mean_squared_error']:.0e}",
        f"{cell['f_V_mean_squared_error']:.0e}",
        f"{100 * cell['f_E_largest_relative_error']:.0f} %",
        f"{100 * cell['f_E_largest_relative_error_upper_half']:.1f} %",
        f"{100 * cell['modulus_change_of_finest_grid']:+.1f} %",
    )
