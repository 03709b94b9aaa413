"""The backend that is always there: SuperLU from scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.sparse.linalg import splu

from hilbrace.shell.symmetric import Sparsity, both_triangles, singular

Array = np.ndarray


class SuperLU:
    """SuperLU with minimum degree on A^T + A and pivots on the diagonal.

    A threshold above zero lets rows be swapped, which costs a positive definite matrix ten times the work.
    SuperLU keeps no analysis: each factorisation orders the matrix anew.
    """

    name = "scipy"

    def __init__(self, sparsity: Sparsity) -> None:
        start, row, self._source = both_triangles(sparsity)
        self._matrix = sp.csc_array((np.zeros(len(row)), row, start), shape=(sparsity.size, sparsity.size))
        self._lu: Any = None

    def factor(self, values: Float[Array, " entry"]) -> None:
        """Factorise.

        Raises:
            SolverError: A pivot is not positive.
        """
        self._lu = None
        self._matrix.data = values[self._source]
        try:
            self._lu = splu(
                self._matrix,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as fault:
            raise singular() from fault
        if not (self._lu.U.diagonal() > 0).all():
            raise singular()

    def solve(self, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """Solve with the last factor."""
        return self._lu.solve(rhs)

    def close(self) -> None:
        """Drop the factor."""
        self._lu = None
