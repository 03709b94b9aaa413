"""Factorisation of the shell's stiffness and solves for many right-hand sides.

`factor` is the one door: whatever gives back a `Factor` can stand in its place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.sparse.linalg import splu

from hilbrace.errors import SolverError

Array = np.ndarray

_WORST_RESIDUAL = 1e-5


@runtime_checkable
class Factor(Protocol):
    """A factorised symmetric positive definite matrix."""

    def solve(self, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """Solve for all columns at once."""
        ...


@dataclass(frozen=True)
class SuperLUFactor:
    """Factor by SuperLU: minimum degree on A^T + A and pivots on the diagonal.

    A threshold above zero lets rows be swapped, which costs a positive definite matrix ten times the work.
    """

    matrix: sp.csc_array
    lu: Any

    def solve(self, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """Solve for all columns at once.

        Raises:
            SolverError: The answer does not satisfy the equations.
        """
        answer = self.lu.solve(np.asfortranarray(rhs))
        residual = np.abs(self.matrix @ answer - rhs).max(initial=0.0)
        if not residual <= _WORST_RESIDUAL * np.abs(rhs).max(initial=0.0):
            raise _singular()
        return answer


def factor(matrix: sp.csc_array) -> Factor:
    """Factorise a symmetric positive definite matrix given with both triangles.

    Raises:
        SolverError: The matrix is singular.
    """
    try:
        lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as fault:
        raise _singular() from fault
    return SuperLUFactor(matrix, lu)


def _singular() -> SolverError:
    return SolverError(
        "the stiffness of the shell is singular",
        where="shell",
        hint="every part of the surface must hang on one of the two loops by at least one edge,"
        " and the modulus must not span more than about ten orders of magnitude",
    )
