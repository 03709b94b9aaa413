"""Pictures of the microstructures: what they look like, and how stiff they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from hilbrace.material.bounds import hashin_shtrikman, voigt
from hilbrace.material.cell_figures import CellSamples
from hilbrace.material.cells import cell_distance, fold, skeleton
from hilbrace.material.homogenize import directional_modulus
from hilbrace.material.walls import cell_walls

INK = "#22313f"
SOLID = "#7fa8c9"
SKELETON = "#e07b2a"
SERIES = (
    "#2a6f97", "#61a5c2", "#588157", "#c8553d", "#8a6fae", "#e07b2a", "#22313f", "#b08900", "#b5838d",
)  # fmt: skip
STROKES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)))
DESIGN_VARIABLES = (0.0, 0.25, 0.5, 0.75, 1.0)
_DOTS = 240


def draw_cells(cells: Sequence[CellSamples], values: Sequence[float] = DESIGN_VARIABLES) -> Figure:
    """One period of every cell (two by two mirrored unit cells) at several design variables.

    Args:
        cells: The cells, one row each.
        values: Design variables d, one column each.
    """
    figure = Figure(figsize=(1.75 * len(values) + 1.3, 1.95 * len(cells)), layout="constrained")
    grid = figure.subplots(len(cells), len(values), squeeze=False)
    ticks = (np.arange(_DOTS) + 0.5) / _DOTS
    u, v = (axis.ravel() for axis in np.meshgrid(ticks, ticks, indexing="xy"))
    for row, cell in zip(grid, cells, strict=True):
        distance = cell_distance(cell.name, fold(u, 1.0), fold(v, 1.0)).reshape(_DOTS, _DOTS)
        for axes, d in zip(row, values, strict=True):
            width = float(cell.curves.width(d))
            axes.contourf(ticks, ticks, distance, levels=[-1.0, width], colors=[SOLID])
            _draw_skeleton(axes, cell.name)
            axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[], yticks=[], aspect="equal")
            volume = np.interp(width, cell.width, cell.volume)
            axes.set_title(f"d = {d:g}   V = {volume:.2f}", fontsize=7.5, color=INK, pad=2)
        row[0].set_ylabel(cell.title, fontsize=9, color=INK)
    return figure


def draw_moduli(cells: Sequence[CellSamples]) -> Figure:
    """Mean modulus over volume fraction: samples, cubic fits and bounds (paper, Sec. 4.2)."""
    figure = Figure(figsize=(10.4, 4.8), layout="constrained")
    plain, logarithmic = figure.subplots(1, 2)
    volume, d = np.linspace(0.05, 0.75, 100), np.linspace(0, 1, 101)
    for axes in (plain, logarithmic):
        axes.plot(volume, voigt(volume), color="#999999", linestyle="--", linewidth=1.1, label="Voigt bound")
        axes.plot(
            volume, hashin_shtrikman(volume), color="#999999", linewidth=1.1, label="Hashin-Shtrikman bound"
        )
        for place, cell in enumerate(cells):
            colour, stroke = _style(place)
            fitted = cell.curves.volume(d), cell.curves.modulus(d)
            axes.plot(*fitted, color=colour, linestyle=stroke, linewidth=1.6, label=cell.title)
            axes.plot(cell.volume, cell.modulus, ".", color=colour, markersize=3.5)
        axes.set(xlabel="volume fraction", ylabel="mean Young's modulus / that of the solid")
        _quiet(axes)
    plain.set(xlim=(0.05, 0.75), ylim=(0, 0.5))
    logarithmic.set(xlim=(0.05, 0.75), ylim=(1e-4, 1), yscale="log")
    plain.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def draw_directions(cells: Sequence[CellSamples], volume: float) -> Figure:
    """Young's modulus by direction at one volume fraction.

    Args:
        cells: The cells; those whose range does not reach the volume are left out.
        volume: Volume fraction [-].
    """
    shown = [cell for cell in cells if cell.volume[0] <= volume <= cell.volume[-1]]
    columns = min(5, max(1, len(shown)))
    rows = max(1, -(-len(shown) // columns))
    figure = Figure(figsize=(2.3 * columns, 2.5 * rows + 0.3), layout="constrained")
    figure.suptitle(
        f"Young's modulus by direction / that of the solid, V = {volume:g}", fontsize=10, color=INK
    )
    grid = figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": "polar"}).ravel()
    angle = np.linspace(0, 2 * np.pi, 361)
    for place, axes in enumerate(grid):
        if place >= len(shown):
            axes.set_visible(False)
            continue
        along = directional_modulus(shown[place].stiffness_at(volume), angle)
        axes.fill(angle, along, color=SERIES[place % len(SERIES)], alpha=0.35)
        axes.plot(angle, along, color=SERIES[place % len(SERIES)], linewidth=1.2)
        axes.set_title(f"{shown[place].title}\n{along.min():.3g} to {along.max():.3g}", fontsize=8, color=INK)
        axes.set(
            xticks=np.arange(4) * np.pi / 2, xticklabels=["u", "v", "", ""], yticks=[], ylim=(0, along.max())
        )
        axes.tick_params(labelsize=7, pad=-3)
        axes.spines["polar"].set(color="#bbbbbb", linewidth=0.8)
    return figure


def draw_bending(cells: Sequence[CellSamples], volume: float) -> Figure:
    """How much stiffer a wall is in bending and twist than a solid sheet of its membrane stiffness.

    Args:
        cells: The cells; those whose range does not reach the volume are left out.
        volume: Volume fraction [-].
    """
    figure = Figure(figsize=(11.4, 4.0), layout="constrained")
    panels = figure.subplots(1, 3)
    thickness = np.geomspace(0.1, 0.8, 25)
    for place, cell in enumerate(cells):
        if not cell.volume[0] <= volume <= cell.volume[-1]:
            continue
        width = np.interp(volume, cell.volume, cell.width)
        d = np.full(25, (width - cell.width[0]) / (cell.width[-1] - cell.width[0]))
        walls = cell_walls(cell.name, d, thickness, cell.poisson)
        colour, stroke = _style(place)
        for k, axes in enumerate(panels):
            excess = walls.bending[:, k, k] / walls.membrane[:, k, k]
            axes.plot(thickness, excess, color=colour, linestyle=stroke, linewidth=1.5, label=cell.title)
    for axes, title in zip(panels, ("bending along u", "bending along v", "twist"), strict=True):
        axes.axhline(1.0, color="#999999", linewidth=0.9, linestyle="--")
        axes.set(xscale="log", yscale="log", xlabel="wall thickness / cell side", ylim=(0.9, None))
        ticks = [tick for tick in (1, 1.2, 1.5, 2, 3, 5, 10, 20, 50, 100) if tick < axes.get_ylim()[1]]
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
        axes.set_yticks([], minor=True)
        axes.set_title(title, fontsize=10, color=INK)
        axes.set_xticks([0.1, 0.2, 0.4, 0.8], ["0.1", "0.2", "0.4", "0.8"], minor=False)
        axes.set_xticks([], minor=True)
        _quiet(axes)
    panels[0].set_ylabel(f"(12 D / t³) / (A / t) at V = {volume:g}", color=INK)
    figure.legend(
        *panels[0].get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside right center"
    )
    return figure


def write_pictures(cells: Sequence[CellSamples], volume: float, folder: Path) -> list[Path]:
    """Draw all pictures as PNG and SVG.

    Args:
        cells: The cells.
        volume: Volume fraction of the pictures that need one [-].
        folder: Where to write; made if absent.

    Returns:
        The files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {
        "cells": draw_cells(cells),
        "moduli": draw_moduli(cells),
        "directions": draw_directions(cells, volume),
        "bending": draw_bending(cells, volume),
    }
    written = []
    for name, figure in drawn.items():
        png, svg = folder / f"{name}.png", folder / f"{name}.svg"
        FigureCanvasAgg(figure)
        figure.savefig(png, dpi=160, facecolor="white")
        FigureCanvasSVG(figure)
        with matplotlib.rc_context({"svg.hashsalt": "hilbrace"}):
            figure.savefig(svg, format="svg", facecolor="white", metadata={"Date": None})
        written += [png, svg]
    return written


def _draw_skeleton(axes: Axes, name: str) -> None:
    quarter = skeleton(name) / 2
    flips = [(u, v) for u in (0, 1) for v in (0, 1)]
    images = [np.abs(np.array(flip) - quarter) for flip in flips]
    axes.add_collection(LineCollection(list(np.concatenate(images)), colors=SKELETON, linewidths=0.7))


def _style(place: int) -> tuple[str, object]:
    return SERIES[place % len(SERIES)], STROKES[(place // 3) % len(STROKES)]


def _quiet(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=INK, labelsize=8)
    axes.xaxis.label.set(color=INK, fontsize=9)
    axes.yaxis.label.set(color=INK, fontsize=9)
