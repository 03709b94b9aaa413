"""The figures of the microstructures side by side: at one volume fraction, and their order at all of them."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from hilbrace.material.bounds import bound_margin, hashin_shtrikman, isotropic_modulus, voigt
from hilbrace.material.curves import CellCurves, fit_curves, load_table
from hilbrace.material.homogenize import directional_modulus, poisson_ratio
from hilbrace.material.skeleton_file import read_skeleton
from hilbrace.material.walls import cell_walls

Array = np.ndarray

PAPERS_STIFFEST, PAPERS_SOFTEST = ("voronoi_open", "voronoi_tri"), "sinusoidal"
"""The order that the paper reports at equal volume (Sec. 4.2); it does not print the shape of its cells."""

PAPERS_FIVE = ("voronoi_tri", "honeycomb", "star", "reentrant", "sinusoidal")
"""Five cells like those that the paper compares."""


SAMPLE_COLUMNS = (
    *(
        "cell",
        "d",
        "half_width_cell_sides",
        "volume_fraction",
        "E_mean",
        "E_1",
        "E_2",
        "E_45",
        "nu_mean",
        "nu_12",
    ),
    *("C11", "C12", "C22", "C66", "E_fit", "V_fit", "voigt", "hashin_shtrikman"),
)
"""Columns of `samples_csv`; all moduli over that of the solid."""


@dataclass(frozen=True)
class CellSamples:
    """One cell's table as arrays.

    Attributes:
        name: Name of the cell, or path of its skeleton file.
        title: How pictures call it.
        poisson: Poisson's ratio of the material [-].
        width: Half widths of the struts [cell sides].
        volume: Volume fractions [-].
        modulus: Mean Young's moduli over the material's [-].
        stiffness: Plane-stress stiffness over the material's modulus [-].
        curves: The fitted curves.
        study: How the figures change with the resolution.
    """

    name: str
    title: str
    poisson: float
    width: Float[Array, " sample"]
    volume: Float[Array, " sample"]
    modulus: Float[Array, " sample"]
    stiffness: Float[Array, "sample 3 3"]
    curves: CellCurves
    study: dict[str, Any]

    def stiffness_at(self, volume: float) -> Float[Array, "3 3"]:
        """Stiffness at a volume fraction, linear between the samples."""
        flat = self.stiffness.reshape(-1, 9)
        return np.array([np.interp(volume, self.volume, entry) for entry in flat.T]).reshape(3, 3)


def cell_samples(name: str) -> CellSamples:
    """Read a cell's table.

    Args:
        name: Name of a built-in cell, or path of a skeleton file whose table lies beside it.

    Raises:
        ConfigError: No cell has this name.
        InputError: The user's cell has no table.
    """
    table = load_table(name)
    columns = {key: np.array(values) for key, values in table["columns"].items()}
    stiffness = np.zeros((len(columns["width"]), 3, 3))
    for (i, j), key in {(0, 0): "C11", (0, 1): "C12", (1, 1): "C22", (2, 2): "C66"}.items():
        stiffness[:, i, j] = stiffness[:, j, i] = columns[key]
    return CellSamples(
        name=name,
        title=read_skeleton(name).title,
        poisson=table["poisson"],
        width=columns["width"],
        volume=columns["volume"],
        modulus=columns["E_mean"],
        stiffness=stiffness,
        curves=fit_curves(name, table),
        study=table["study"],
    )


def figures_at(cell: CellSamples, volume: float, thickness: float = 0.25) -> dict[str, Any]:
    """What a cell does at one volume fraction; moduli over the material's.

    Args:
        cell: The cell.
        volume: Volume fraction [-].
        thickness: Thickness of the wall for the bending figures [cell sides].

    Returns:
        Figures by name; ``None`` for all that the cell's range does not reach.
    """
    wall_keys = ("bending_1_over_stretch", "bending_2_over_stretch", "twist_over_shear")
    keys = ("width", "E_mean", "E_1", "E_2", "E_45", "nu", "nu_12", "G", *wall_keys)
    if not cell.volume[0] - 1e-6 <= volume <= cell.volume[-1] + 1e-6:
        return dict.fromkeys(keys)
    c = cell.stiffness_at(volume)
    first, second, diagonal = directional_modulus(c, np.array([0.0, np.pi / 2, np.pi / 4]))
    width = np.interp(volume, cell.volume, cell.width)
    d = np.array([(width - cell.width[0]) / (cell.width[-1] - cell.width[0])])
    wall = cell_walls(cell.name, np.clip(d, 0.0, 1.0), np.array([thickness]), cell.poisson)
    excess = np.diag(wall.bending[0]) / np.diag(wall.membrane[0])
    modulus = np.interp(volume, cell.volume, cell.modulus)
    values = (width, modulus, first, second, diagonal, poisson_ratio(c), c[0, 1] / c[1, 1], c[2, 2], *excess)
    return {key: float(f"{value:.5g}") for key, value in zip(keys, values, strict=True)}


def figures_of(cell: CellSamples, volume: float) -> dict[str, Any]:
    """All that ``hilbrace cells`` tells of a cell.

    Args:
        cell: The cell.
        volume: Volume fraction of the figures that need one [-].
    """
    margins = [bound_margin(c, v, cell.poisson) for c, v in zip(cell.stiffness, cell.volume, strict=True)]
    isotropic = [
        1.0 - isotropic_modulus(c) / hashin_shtrikman(v)
        for c, v in zip(cell.stiffness, cell.volume, strict=True)
    ]
    curves = cell.curves
    rises = all(
        (slope(np.linspace(0, 1, 201)) >= -1e-9).all()
        for slope in (curves.modulus_slope, curves.volume_slope)
    )
    moduli = cell.study["E_mean"]
    fitted = curves.modulus((cell.width - cell.width[0]) / (cell.width[-1] - cell.width[0]))
    off = np.abs(fitted / cell.modulus - 1.0)
    return {
        "name": cell.name,
        "title": cell.title,
        "volume_low": float(cell.volume[0]),
        "volume_high": float(cell.volume[-1]),
        "width_low": float(cell.width[0]),
        "width_high": float(cell.width[-1]),
        "samples": len(cell.volume),
        "f_E": list(curves.modulus_coefficients),
        "f_V": list(curves.volume_coefficients),
        "f_E_mean_squared_error": float(f"{curves.modulus_error:.3g}"),
        "f_V_mean_squared_error": float(f"{curves.volume_error:.3g}"),
        "f_E_largest_error": float(f"{np.abs(fitted - cell.modulus).max():.3g}"),
        "f_E_largest_relative_error": float(f"{off.max():.3g}"),
        "f_E_largest_relative_error_upper_half": float(f"{off[len(off) // 2 :].max():.3g}"),
        "monotone": bool(rises),
        "least_margin_to_voigt": float(f"{min(margins):.3g}"),
        "least_margin_to_hashin_shtrikman": float(f"{min(isotropic):.3g}"),
        "modulus_change_of_finest_grid": float(f"{moduli[-1] / moduli[-2] - 1:.3g}"),
        "study": cell.study,
        "at_volume": {"volume": volume, **figures_at(cell, volume)},
    }


def bounds_at(volume: float) -> dict[str, float]:
    """The bounds at a volume fraction, as ``--json`` tells them."""
    return {
        "volume": volume,
        "voigt": float(f"{voigt(volume):.5g}"),
        "hashin_shtrikman": float(f"{hashin_shtrikman(volume):.5g}"),
    }


def order(cells: Sequence[CellSamples], measure: str = "E_mean") -> list[dict[str, Any]]:
    """Stiffest and softest cell at equal volume, wherever at least two cells reach.

    Args:
        cells: The cells to compare.
        measure: ``E_mean``, the mean over directions, or ``E_1``, along u.

    Returns:
        Ranges of the volume fraction, rising, with the names of the stiffest and the softest cell and of
        those that were compared.
    """
    ranges: list[dict[str, Any]] = []
    for volume in np.round(np.arange(0.10, 0.701, 0.01), 2):
        there = [c for c in cells if c.volume[0] - 1e-6 <= volume <= c.volume[-1] + 1e-6]
        if len(there) < 2:
            continue
        ranked = sorted(there, key=lambda cell: _measured(cell, float(volume), measure))
        found = {"stiffest": ranked[-1].name, "softest": ranked[0].name, "compared": [c.name for c in there]}
        if ranges and all(ranges[-1][key] == value for key, value in found.items()):
            ranges[-1]["volume_high"] = float(volume)
        else:
            ranges.append({"volume_low": float(volume), "volume_high": float(volume), **found})
    return ranges


def papers_order(cells: Sequence[CellSamples]) -> list[str]:
    """Sentences that say where the paper's order holds: Voronoi stiffest, sinusoidal grid softest.

    Volumes that no Voronoi cell or not the sinusoidal grid reaches say nothing and are left out.
    """
    by_name = {cell.name: cell for cell in cells}
    sets = (("five cells like the paper's", PAPERS_FIVE), ("all cells listed", tuple(by_name)))
    sentences = []
    for title, names in sets:
        if not set(names) <= set(by_name) or PAPERS_SOFTEST not in names:
            continue
        if not set(PAPERS_STIFFEST) & set(names):
            continue
        for measure, called in (("E_mean", "mean modulus"), ("E_1", "modulus along u")):
            found = [
                part
                for part in order([by_name[name] for name in names], measure)
                if PAPERS_SOFTEST in part["compared"] and set(PAPERS_STIFFEST) & set(part["compared"])
            ]
            if not found:
                continue
            stiff = [part for part in found if part["stiffest"] not in PAPERS_STIFFEST]
            soft = [part for part in found if part["softest"] != PAPERS_SOFTEST]
            whole = f"V {found[0]['volume_low']:.2f} to {found[-1]['volume_high']:.2f}"
            sentences.append(
                f"{title}, {called}, {whole}: Voronoi stiffest {_holds(stiff, 'stiffest')};"
                f" sinusoidal grid softest {_holds(soft, 'softest')}"
            )
    return sentences


def samples_csv(cells: Sequence[CellSamples]) -> str:
    """All samples as a table: one row a cell and width."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(SAMPLE_COLUMNS)
    for cell in cells:
        span = cell.width[-1] - cell.width[0]
        for width, volume, modulus, c in zip(
            cell.width, cell.volume, cell.modulus, cell.stiffness, strict=True
        ):
            d = (width - cell.width[0]) / span
            along = directional_modulus(c, np.array([0.0, np.pi / 2, np.pi / 4]))
            entries = (c[0, 0], c[0, 1], c[1, 1], c[2, 2], cell.curves.modulus(d), cell.curves.volume(d))
            row = (d, width, volume, modulus, *along, poisson_ratio(c), c[0, 1] / c[1, 1], *entries)
            bounds = voigt(volume), hashin_shtrikman(volume)
            writer.writerow([cell.name, *(f"{value:.7g}" for value in (*row, *bounds))])
    return text.getvalue()


def _measured(cell: CellSamples, volume: float, measure: str) -> float:
    if measure == "E_mean":
        return float(np.interp(volume, cell.volume, cell.modulus))
    return float(directional_modulus(cell.stiffness_at(volume), np.zeros(1))[0])


def _holds(exceptions: list[dict[str, Any]], key: str) -> str:
    if not exceptions:
        return "everywhere"
    merged: list[dict[str, Any]] = []
    for part in exceptions:
        if merged and merged[-1][key] == part[key] and part["volume_low"] - merged[-1]["volume_high"] < 0.015:
            merged[-1] = {**merged[-1], "volume_high": part["volume_high"]}
        else:
            merged.append(part)
    where = ", ".join(f"V {p['volume_low']:.2f} to {p['volume_high']:.2f} ({p[key]})" for p in merged)
    return f"but for {where}"
