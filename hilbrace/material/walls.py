"""Walls of blended microstructures: their orthotropic stiffness against stretching, bending and shear.

The curves of `hilbrace.material.curves` know one modulus per place. Most cells are several times stiffer in
one direction than in another, and all soft ones are far stiffer in bending and twist than a solid sheet of
their modulus (`hilbrace.material.wall_cell`). Here the tables' matrices are kept whole.

Between samples, matrices are interpolated linearly in the design variable and in the logarithm of the wall's
thickness over the side of a cell: a mean of positive definite matrices is positive definite. That costs up to
three percent of the bending stiffness in the middle between two samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from hilbrace.errors import GeometryError
from hilbrace.material.curves import blend, load_table
from hilbrace.material.homogenize import with_poisson

Array = np.ndarray


@dataclass(frozen=True)
class Walls:
    """Stiffness of the wall at many places, relative to a solid of unit modulus and the wall's thickness t.

    Axis 1 runs along u of the flat map, axis 2 along v.

    Attributes:
        membrane: A / (E t), with ``(n11, n22, n12) = A (e11, e22, 2 e12)`` [-].
        bending: 12 D / (E t^3), with ``(m11, m22, m12) = D (k11, k22, 2 k12)`` [-].
        shear: Against transverse shear (q1, q2), over E t [-].
    """

    membrane: Float[Array, "place 3 3"]
    bending: Float[Array, "place 3 3"]
    shear: Float[Array, "place 2 2"]


def solid_walls(count: int, poisson: float) -> Walls:
    """Walls without holes.

    Args:
        count: Number of places.
        poisson: Poisson's ratio [-].
    """
    plane = np.array([[1.0, poisson, 0.0], [poisson, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - poisson)]])
    plane = np.tile(plane / (1.0 - poisson**2), (count, 1, 1))
    return Walls(plane, plane.copy(), np.tile(0.5 / (1.0 + poisson) * np.eye(2), (count, 1, 1)))


def cell_walls(
    name: str, d: Float[Array, " place"], thickness: Float[Array, " place"], poisson: float
) -> Walls:
    """Walls of one microstructure.

    Args:
        name: Name of the cell, or path of its skeleton file.
        d: Design variable, in [0, 1] [-].
        thickness: Thickness of the wall [cell sides]; outside of the tabulated ones the nearest counts.
        poisson: Poisson's ratio of the material [-]. For a thin sheet the change from the table's ratio is
            exact; bending keeps its ratio to stretching.

    Raises:
        GeometryError: A design variable is not in [0, 1], or a thickness is not above zero.
        InputError: The user's cell has no table.
    """
    _check(d, "design variable", np.isfinite(d) & (d >= -1e-9) & (d <= 1 + 1e-9), "between 0 and 1")
    _check(thickness, "thickness", np.isfinite(thickness) & (thickness > 0), "above zero")
    table = load_table(name)
    columns, wall = table["columns"], table["wall"]
    entries = np.stack([columns[key] for key in ("C11", "C12", "C22", "C66")], axis=1)
    width = np.array(columns["width"])
    samples = (width - width[0]) / (width[-1] - width[0])
    sheet = with_poisson(_matrices(_along(samples, entries, d)), table["poisson"], poisson)
    root = _root(sheet)
    membrane, bending = (
        root @ _matrices(_across(wall, key, d, np.log(thickness))) @ root for key in ("membrane", "bending")
    )
    shear = np.zeros((len(d), 2, 2))
    for k, key in enumerate(("K11", "K22")):
        shear[:, k, k] = 0.5 / (1 + poisson) * np.interp(d, samples, columns[key])
    return Walls(_symmetric(membrane), _symmetric(bending), shear)


def blended_walls(
    soft: str,
    firm: str,
    d: Float[Array, " place"],
    firm_fraction: Float[Array, " place"],
    thickness: Float[Array, " place"],
    poisson: float,
    solid: Bool[Array, " place"] | None = None,
) -> Walls:
    """Walls of two microstructures, blended as their moduli are (paper, Sec. 4.3).

    Args:
        soft: Name of the soft cell, or path of its skeleton file.
        firm: The firm one.
        d: Design variable, in [0, 1] [-].
        firm_fraction: 0 soft to 1 firm [-].
        thickness: Thickness of the wall [cell sides].
        poisson: Poisson's ratio of the material [-].
        solid: Places without holes, such as the rims.

    Raises:
        GeometryError: A value is out of its range.
        InputError: A user's cell has no table.
    """
    inside = np.isfinite(firm_fraction) & (firm_fraction >= -1e-9) & (firm_fraction <= 1 + 1e-9)
    _check(firm_fraction, "firm fraction", inside, "between 0 and 1")
    parts = [cell_walls(name, d, thickness, poisson) for name in (soft, firm)]
    share = firm_fraction[:, None, None]
    whole = solid_walls(len(d), poisson)
    full = np.zeros(len(d), dtype=bool) if solid is None else solid

    def chosen(part: str) -> Array:
        mixed = blend(share, *(getattr(walls, part) for walls in parts))
        return np.where(full[:, None, None], getattr(whole, part), mixed)

    return Walls(chosen("membrane"), chosen("bending"), chosen("shear"))


def _check(values: Float[Array, " place"], name: str, good: Bool[Array, " place"], hint: str) -> None:
    wrong = np.flatnonzero(~good)
    if wrong.size:
        raise GeometryError(
            f"{name} {values[wrong[0]]:g}, and so or alike at {wrong.size} of {len(values)} places",
            where=f"wall at place {wrong[0]}",
            hint=f"it must be {hint}",
        )


def _along(samples: Array, entries: Float[Array, "sample entry"], d: Float[Array, " place"]) -> Array:
    return np.stack([np.interp(d, samples, entry) for entry in entries.T], axis=1)


def _across(wall: dict, key: str, d: Float[Array, " place"], log_thickness: Float[Array, " place"]) -> Array:
    """Entries of a ratio at the places, linear in ``d`` and in the logarithm of the thickness."""
    samples, levels = np.array(wall["d"]), np.log(wall["thickness"])
    ratios = np.stack([_along(samples, np.array(part), d) for part in wall[key]])
    place = np.clip(np.interp(log_thickness, levels, np.arange(len(levels))), 0, len(levels) - 1)
    low = np.minimum(place.astype(np.intp), len(levels) - 2)
    upper = (place - low)[:, None]
    each = np.arange(len(d))
    return (1 - upper) * ratios[low, each] + upper * ratios[low + 1, each]


def _matrices(entries: Float[Array, "place 4"]) -> Float[Array, "place 3 3"]:
    """Matrices of the entries 11, 12, 22, 66."""
    matrices = np.zeros((len(entries), 3, 3))
    matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 2, 2] = entries[:, 0], entries[:, 2], entries[:, 3]
    matrices[:, 0, 1] = matrices[:, 1, 0] = entries[:, 1]
    return matrices


def _root(matrices: Float[Array, "place 3 3"]) -> Float[Array, "place 3 3"]:
    values, axes = np.linalg.eigh(matrices)
    return (axes * np.sqrt(values)[:, None]) @ axes.transpose(0, 2, 1)


def _symmetric(matrices: Float[Array, "place 3 3"]) -> Float[Array, "place 3 3"]:
    return 0.5 * (matrices + matrices.transpose(0, 2, 1))
