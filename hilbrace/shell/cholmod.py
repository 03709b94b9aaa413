"""A backend without Intel's library: CHOLMOD as packed by cholespy.

cholespy is the solver of Nicolet, Jacobson & Jakob 2021, "Large steps in inverse rendering of geometry". It
keeps no analysis between factorisations, and its C library writes to the console when a matrix is not
positive definite.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
from jaxtyping import Float

from hilbrace.errors import ConfigError
from hilbrace.shell.symmetric import Sparsity, singular

Array = np.ndarray


def is_installed() -> bool:
    """Whether cholespy can be imported."""
    return importlib.util.find_spec("cholespy") is not None


class Cholmod:
    """Cholesky factors by cholespy."""

    name = "cholespy"

    def __init__(self, sparsity: Sparsity) -> None:
        try:
            import cholespy
        except ImportError as fault:
            raise ConfigError(
                "cholespy is not installed",
                where="shell solver 'cholespy'",
                hint="pip install 'hilbrace[cholespy]', or choose another solver",
            ) from fault
        self._library: Any = cholespy
        self._size = sparsity.size
        self._row = sparsity.row
        self._column = np.repeat(np.arange(sparsity.size, dtype=np.int32), np.diff(sparsity.start))
        self._cholesky: Any = None

    def factor(self, values: Float[Array, " entry"]) -> None:
        """Factorise.

        The triplets are copied by the library. Of one triangle in compressed columns it would take the arrays
        themselves, and reallocate them.

        Raises:
            SolverError: A pivot is not positive.
        """
        self._cholesky = None
        triplets = self._library.MatrixType.COO
        try:
            self._cholesky = self._library.CholeskySolverD(
                self._size, self._row, self._column, values, triplets
            )
        except ValueError as fault:
            raise singular() from fault

    def solve(self, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """Solve with the last factor."""
        answer = np.zeros(rhs.shape)
        if rhs.shape[1]:
            self._cholesky.solve(np.ascontiguousarray(rhs), answer)
        return answer

    def close(self) -> None:
        """Drop the factor."""
        self._cholesky = None
