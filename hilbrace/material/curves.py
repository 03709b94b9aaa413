"""Modulus and volume of the microstructures as smooth functions of the design variable.

Firm and soft cell share one design variable ``d`` in [0, 1] per point. Each cell maps it to its own strut
half width, ``w(d) = w_low + d (w_high - w_low)`` in cell sides, so that ``d`` runs through nearly the same
volume fractions in both. Modulus, volume and width are blended by the firm fraction ``s`` alike (the paper
blends the modulus only, but one width means quite different volumes in the two cells). The blended width and
``s`` are all that the pattern needs: they lead back to ``d``, and so to the width of either cell. How the
struts of the two cells meet is told in `hilbrace.pattern.implicit`.

Everything is plain arithmetic and works on numpy arrays and on torch tensors alike.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from hilbrace.errors import InputError
from hilbrace.material.skeleton_file import read_skeleton, skeleton_path
from hilbrace.material.tables import COLUMNS, FOLDER

Array = np.ndarray
Cubic = tuple[float, float, float, float]

_BERNSTEIN = np.array([[1, -3, 3, -1], [0, 3, -6, 3], [0, 0, 3, -3], [0, 0, 0, 1]], dtype=float)
"""Power coefficients of the four cubic Bernstein polynomials, one a row."""


@dataclass(frozen=True)
class CellCurves:
    """One cell as the optimizer sees it.

    Attributes:
        name: Name of the cell.
        poisson: Poisson's ratio of the base material in the table [-].
        width_low: Strut half width at ``d = 0`` [cell sides].
        width_high: Strut half width at ``d = 1`` [cell sides].
        pinch_width: Half width at which holes begin to split or fill up [cell sides].
        modulus_coefficients: Cubic of the mean Young's modulus over the base material's, constant first.
        volume_coefficients: Cubic of the volume fraction, constant first.
        modulus_error: Mean squared error of the fitted modulus at the samples.
        volume_error: Mean squared error of the fitted volume fraction.
    """

    name: str
    poisson: float
    width_low: float
    width_high: float
    pinch_width: float
    modulus_coefficients: Cubic
    volume_coefficients: Cubic
    modulus_error: float
    volume_error: float

    def width(self, d: Any) -> Any:
        """Strut half width [cell sides] at design variable ``d``."""
        return self.width_low + d * (self.width_high - self.width_low)

    def modulus(self, d: Any) -> Any:
        """Mean Young's modulus relative to the base material at ``d``."""
        return _polynomial(self.modulus_coefficients, d)

    def volume(self, d: Any) -> Any:
        """Volume fraction at ``d``."""
        return _polynomial(self.volume_coefficients, d)

    def modulus_slope(self, d: Any) -> Any:
        """Derivative of `modulus`."""
        return _slope(self.modulus_coefficients, d)

    def volume_slope(self, d: Any) -> Any:
        """Derivative of `volume`."""
        return _slope(self.volume_coefficients, d)


@dataclass(frozen=True)
class Microstructures:
    """The soft and the firm cell, blended by a firm fraction in [0, 1].

    Attributes:
        soft: Curves of the soft cell (firm fraction 0).
        firm: Curves of the firm cell (firm fraction 1).
    """

    soft: CellCurves
    firm: CellCurves

    def width(self, d: Any, firm_fraction: Any) -> Any:
        """Blended strut half width ``w_blend`` [cell sides]."""
        return blend(firm_fraction, self.soft.width(d), self.firm.width(d))

    def modulus(self, d: Any, firm_fraction: Any) -> Any:
        """Blended modulus relative to the base material (paper, Sec. 4.3)."""
        return blend(firm_fraction, self.soft.modulus(d), self.firm.modulus(d))

    def volume(self, d: Any, firm_fraction: Any) -> Any:
        """Blended volume fraction."""
        return blend(firm_fraction, self.soft.volume(d), self.firm.volume(d))

    def pinch_width(self, firm_fraction: Any) -> Any:
        """Blended half width at which holes begin to split or fill up [cell sides]."""
        return blend(firm_fraction, self.soft.pinch_width, self.firm.pinch_width)

    def design_variable(self, width: Any, firm_fraction: Any) -> Any:
        """Design variable that gives a blended width; the inverse of `width`, not limited to [0, 1]."""
        low, high = self.width(0.0, firm_fraction), self.width(1.0, firm_fraction)
        return (width - low) / (high - low)


def blend(firm_fraction: Any, soft: Any, firm: Any) -> Any:
    """Weighted mean of a soft and a firm value (paper, Eq. 6)."""
    return (1.0 - firm_fraction) * soft + firm_fraction * firm


def load_microstructures(soft: str, firm: str) -> Microstructures:
    """Curves of a soft and a firm cell by name."""
    return Microstructures(soft=load_curves(soft), firm=load_curves(firm))


def load_curves(name: str) -> CellCurves:
    """Read a cell's table and fit its curves.

    Args:
        name: Name of a built-in cell, or path of a skeleton file whose table lies beside it.

    Raises:
        ConfigError: No cell has this name.
        InputError: The user's cell has no table, or one of another drawing.
    """
    return _fitted(name, json.dumps(load_table(name)))


@lru_cache(maxsize=32)
def _fitted(name: str, text: str) -> CellCurves:
    return fit_curves(name, json.loads(text))


def fit_curves(name: str, table: dict[str, Any]) -> CellCurves:
    """The curves of a table.

    Args:
        name: What to call the cell.
        table: As `hilbrace.material.tables.tabulate` returns it.
    """
    columns = {key: np.array(values) for key, values in table["columns"].items()}
    width = columns["width"]
    d = (width - width[0]) / (width[-1] - width[0])
    modulus, modulus_error = fit_monotone_cubic(d, columns["E_mean"])
    volume, volume_error = fit_monotone_cubic(d, columns["volume"])
    return CellCurves(
        name=name,
        poisson=table["poisson"],
        width_low=float(width[0]),
        width_high=float(width[-1]),
        pinch_width=table["pinch_width"],
        modulus_coefficients=modulus,
        volume_coefficients=volume,
        modulus_error=modulus_error,
        volume_error=volume_error,
    )


def table_path(name: str) -> Path:
    """Where the table of a cell lies: in the package, or beside the user's skeleton file.

    Raises:
        ConfigError: No cell has this name.
    """
    path = skeleton_path(name)
    return path.with_suffix(".table.json") if name.endswith(".toml") else FOLDER / f"{name}.json"


def load_table(name: str) -> dict[str, Any]:
    """The homogenized samples of a cell as `hilbrace.material.tables.make_table` returned them.

    Raises:
        ConfigError: No cell has this name.
        InputError: The user's cell has no table, a damaged one, or one of another drawing.
    """
    path = table_path(name)
    if not name.endswith(".toml"):
        return json.loads(path.read_text("utf-8"))
    drawn = read_skeleton(name).digest
    try:
        table = json.loads(path.read_text("utf-8"))
        if table["skeleton"] == drawn and set(COLUMNS) <= set(table["columns"]) and "wall" in table:
            return table
        what = "the table is of another drawing than the skeleton"
    except OSError:
        what = "the cell has not been homogenized yet"
    except (ValueError, KeyError, TypeError):
        what = "the table is damaged"
    raise InputError(what, where=str(path), hint=f"run `hilbrace cells add {name}`")


def cell_digest(name: str) -> str:
    """Digest of all that a run takes from a cell: its skeleton and its table.

    Raises:
        ConfigError: No cell has this name.
        InputError: The user's cell has no table, a damaged one, or one of another drawing.
    """
    text = json.dumps(load_table(name), sort_keys=True)
    return hashlib.sha256((read_skeleton(name).digest + text).encode()).hexdigest()


def fit_monotone_cubic(d: Float[Array, " sample"], value: Float[Array, " sample"]) -> tuple[Cubic, float]:
    """Least-squares cubic on [0, 1] that never falls.

    A cubic whose Bernstein coefficients do not decrease is monotone, so the fit runs over their increments,
    bounded below by zero.

    Args:
        d: Abscissas in [0, 1].
        value: Samples.

    Returns:
        Power coefficients, constant first, and the mean squared error at the samples.
    """
    basis = np.vander(d, 4, increasing=True) @ _BERNSTEIN.T
    increments = basis[:, ::-1].cumsum(axis=1)[:, ::-1]
    solution = lsq_linear(increments, value, bounds=([-np.inf, 0, 0, 0], np.inf), method="bvls").x
    c = np.cumsum(solution) @ _BERNSTEIN
    error = float(np.mean((np.vander(d, 4, increasing=True) @ c - value) ** 2))
    return (float(c[0]), float(c[1]), float(c[2]), float(c[3])), error


def _polynomial(c: Cubic, d: Any) -> Any:
    return c[0] + d * (c[1] + d * (c[2] + d * c[3]))


def _slope(c: Cubic, d: Any) -> Any:
    return c[1] + d * (2 * c[2] + d * 3 * c[3])
