"""Sparse symmetric matrices that are stored by one triangle, as the solvers want them.

The lower triangle in compressed columns is, read by rows, the upper triangle in compressed rows: the same
three arrays serve solvers of both habits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from hilbrace.errors import SolverError
from hilbrace.shell.blocks import times

Array = np.ndarray

WORST_RESIDUAL = 1e-5
"""An answer that misses its right-hand side by more than this share of it is no answer [-]."""


@dataclass(frozen=True)
class Sparsity:
    """Where a symmetric matrix has entries.

    Attributes:
        start: Pointers to the first entry of each column, 32 bits.
        row: Row of each entry, ascending in a column; the diagonal comes first in every column, 32 bits.
    """

    start: Int[Array, " free_plus_one"]
    row: Int[Array, " entry"]

    def __post_init__(self) -> None:
        columns = np.repeat(np.arange(self.size), np.diff(self.start))
        ordered = (np.diff(self.row.astype(np.int64) + self.size * columns.astype(np.int64)) > 0).all()
        full = (np.diff(self.start) > 0).all()
        if not (ordered and full and np.array_equal(self.row[self.start[:-1]], np.arange(self.size))):
            raise SolverError(
                "the sparsity is no lower triangle with its diagonal",
                where="shell",
                hint="give the rows of each column in ascending order, the diagonal first",
            )

    @property
    def size(self) -> int:
        """Number of equations."""
        return len(self.start) - 1

    @property
    def entries(self) -> int:
        """Number of stored entries."""
        return len(self.row)


def product(
    sparsity: Sparsity, values: Float[Array, " entry"], vectors: Float[Array, "free column"]
) -> Float[Array, "free column"]:
    """The symmetric matrix times vectors."""
    shape = (sparsity.size, sparsity.size)
    lower = sp.csc_array((values, sparsity.row, sparsity.start), shape=shape)
    diagonal = values[sparsity.start[:-1]]
    return lower @ vectors + lower.T @ vectors - diagonal[:, None] * vectors


def both_triangles(
    sparsity: Sparsity,
) -> tuple[Int[Array, " free_plus_one"], Int[Array, " both"], Int[Array, " both"]]:
    """Compressed columns of both triangles.

    Returns:
        Column pointers, rows, and for each entry its position among the values of the stored triangle.
    """
    shape = (sparsity.size, sparsity.size)
    count = np.arange(1, sparsity.entries + 1)
    lower = sp.csc_array((count, sparsity.row, sparsity.start), shape=shape)
    both = (lower + sp.triu(lower.T, k=1)).tocsc()
    both.sort_indices()
    return both.indptr.astype(np.int32), both.indices.astype(np.int32), both.data - 1


def check_values(sparsity: Sparsity, values: Float[Array, " entry"]) -> Float[Array, " entry"]:
    """The values of a matrix, fit for a solver.

    Raises:
        SolverError: Their number does not fit the sparsity, or one is not finite.
    """
    if values.shape != (sparsity.entries,):
        raise SolverError(
            f"values of shape {values.shape} for {sparsity.entries} entries of the stiffness",
            where="shell",
            hint="refill the stiffness by the map of the same numbering",
        )
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise SolverError(
            f"{bad.size} entries of the stiffness are not finite",
            where=f"entry {bad[0]} of the shell's stiffness",
            hint="check the modulus and the thickness of the triangles",
        )
    return np.ascontiguousarray(values, dtype=np.float64)


def check_rhs(sparsity: Sparsity, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
    """Right-hand sides, fit for a solver: 64 bits, one column after the other.

    Raises:
        SolverError: Their shape does not fit the matrix, or one is not finite.
    """
    if rhs.ndim != 2 or rhs.shape[0] != sparsity.size:
        raise SolverError(
            f"right-hand sides of shape {rhs.shape} for {sparsity.size} equations",
            where="shell",
            hint="give one row per free degree of freedom and one column per load",
        )
    bad = np.flatnonzero(~np.isfinite(rhs).all(axis=0))
    if bad.size:
        raise SolverError(
            f"{bad.size} right-hand sides are not finite",
            where=f"load {bad[0]} of the shell",
            hint="check the forces of the frames",
        )
    return np.asfortranarray(rhs, dtype=np.float64)


def check_answer(
    sparsity: Sparsity,
    values: Float[Array, " entry"],
    rhs: Float[Array, "free column"],
    answer: Float[Array, "free column"],
) -> None:
    """Refuse an answer that does not solve its equations.

    All columns are checked at once through one fixed sum of them with generic weights (Freivalds 1977,
    "Probabilistic machines can use less running time", IFIP Congress): errors of several columns cancel in it
    by a coincidence of measure zero only, and what is not finite stays so.

    Raises:
        SolverError: The residual is too large or not finite.
    """
    largest = np.abs(rhs).max(axis=0, initial=0.0)
    weight = np.random.default_rng(rhs.shape[1]).uniform(0.5, 1.0, rhs.shape[1])
    weight /= np.where(largest > 0, largest, 1.0)
    column = weight[:, None]
    residual = product(sparsity, values, times(answer, column)) - times(rhs, column)
    if not np.abs(residual).max(initial=0.0) <= WORST_RESIDUAL:
        raise singular()


def singular() -> SolverError:
    """The error for a matrix that has no factor or gives no answer."""
    return SolverError(
        "the stiffness of the shell is singular",
        where="shell",
        hint="every part of the surface must hang on one of the two loops by at least one edge,"
        " and the modulus must not span more than about ten orders of magnitude",
    )
