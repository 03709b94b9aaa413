"""The backend that is always there: SuperLU from scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

from hilbrace.shell.symmetric import Sparsity, both_triangles, singular

Array = np.ndarray


class SuperLU:
    """SuperLU with minimum degree on A^T + A and pivots on the diagonal.

    A threshold above zero lets rows be swapped, which costs a positive definite matrix ten times the work.
    SuperLU keeps no analysis: left alone it orders the matrix anew in each factorisation, which took 0.2 of
    0.5 s at 10k triangles. So the order is found once, in the first one, and later matrices come in it.
    """

    name = "scipy"

    def __init__(self, sparsity: Sparsity) -> None:
        start, row, self._source = both_triangles(sparsity)
        self._matrix = sp.csc_array((np.zeros(len(row)), row, start), shape=(sparsity.size, sparsity.size))
        self._order: Int[Array, " free"] | None = None
        self._lu: Any = None

    def factor(self, values: Float[Array, " entry"]) -> None:
        """Factorise.

        Raises:
            SolverError: A pivot is not positive.
        """
        self._lu = None
        self._matrix.data = values[self._source]
        if self._order is None:
            self._keep_order(np.argsort(_factored(self._matrix, "MMD_AT_PLUS_A").perm_c))
            self._matrix.data = values[self._source]
        self._lu = _factored(self._matrix, "NATURAL")
        if not (self._lu.U.diagonal() > 0).all():
            raise singular()

    def solve(self, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """Solve with the last factor."""
        found = np.empty_like(rhs)
        found[self._order] = self._lu.solve(rhs[self._order])
        return found

    def close(self) -> None:
        """Drop the factor."""
        self._lu = None

    def _keep_order(self, order: Int[Array, " free"]) -> None:
        """Let rows and columns come in an order from here on."""
        numbered = sp.csc_array(
            (np.arange(len(self._source)) + 1, self._matrix.indices, self._matrix.indptr),
            shape=self._matrix.shape,
        )
        turned: Any = sp.csc_array(numbered[order][:, order])
        turned.sort_indices()
        self._source = self._source[turned.data - 1]
        self._matrix = sp.csc_array(
            (np.zeros(len(self._source)), turned.indices, turned.indptr), shape=turned.shape
        )
        self._order = order


def _factored(matrix: sp.csc_array, order: str) -> Any:
    """SuperLU's factor of a symmetric positive definite matrix.

    Raises:
        SolverError: The matrix is singular.
    """
    try:
        return splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as fault:
        raise singular() from fault
