"""Factorisation of the shell's stiffness and solves for many right-hand sides, by whichever library is there.

`open_solver` is the one door. The analysis of the sparsity is done once and kept; `Solver.factor` takes new
values as often as the optimizer has them.

    with open_solver(numbering.sparsity) as solver:
        factor = solver.factor(refill @ modulus)
        displacements = factor.solve(loads)
"""

from __future__ import annotations

from threading import Lock
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from hilbrace.errors import ConfigError, SolverError
from hilbrace.shell import cholmod, pardiso
from hilbrace.shell.superlu import SuperLU
from hilbrace.shell.symmetric import Sparsity, check_answer, check_rhs, check_values

Array = np.ndarray

BACKENDS = ("pardiso", "scipy", "cholespy")
"""All backends, the preferred first.

On 10 000 triangles a new matrix with 15 (57) right-hand sides takes one core 95 (145) ms by pardiso, 350
(500) ms by scipy and 450 (580) ms by cholespy; two cores take 55 (90) ms by pardiso.
"""


@runtime_checkable
class Backend(Protocol):
    """What a library must do to serve a `Solver`: one matrix at a time, one thread at a time."""

    @property
    def name(self) -> str:
        """Name by which users choose it."""
        ...

    def factor(self, values: Float[Array, " entry"]) -> None:
        """Factorise the matrix with these values, or raise a `SolverError` if it is not positive definite."""
        ...

    def solve(self, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """Solve with the last factor."""
        ...

    def close(self) -> None:
        """Give all memory back; may be called twice."""
        ...


class Solver:
    """Solves with matrices of one sparsity; a context manager that gives its memory back at the end.

    A solver holds one factor at a time. Threads that share a solver wait for each other; give each thread its
    own to let them run side by side.
    """

    def __init__(self, sparsity: Sparsity, backend: Backend) -> None:
        self.sparsity = sparsity
        self._backend = backend
        self._lock = Lock()
        self._made = 0
        self._closed = False

    @property
    def name(self) -> str:
        """Name of the backend."""
        return self._backend.name

    def factor(self, values: Float[Array, " entry"]) -> Factor:
        """Factorise the matrix with these values; the factor given out before becomes void.

        Args:
            values: Entries of the stored triangle.

        Raises:
            SolverError: The matrix is not positive definite, its values do not fit, or the solver is closed.
        """
        values = check_values(self.sparsity, values)
        with self._lock:
            if self._closed:
                raise _void("the solver is closed")
            self._made += 1
            self._backend.factor(values)
            return Factor(self, self._made, values)

    def solve(self, number: int, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """What `Factor.solve` calls: solve with a factor by its number if it is the last one."""
        rhs = check_rhs(self.sparsity, rhs)
        with self._lock:
            if self._closed or number != self._made:
                raise _void("the solver is closed" if self._closed else "the factor is out of date")
            return self._backend.solve(rhs)

    def close(self) -> None:
        """Give the memory back; the solver and its factor are void from here on."""
        with self._lock:
            self._closed = True
            self._backend.close()

    def __enter__(self) -> Solver:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Factor:
    """A factorised symmetric positive definite matrix; valid until its solver factors again or is closed."""

    def __init__(self, solver: Solver, number: int, values: Float[Array, " entry"]) -> None:
        self._solver, self._number, self._values = solver, number, values

    def solve(self, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """Solve for all columns at once; columns that lie one after the other in memory save a copy.

        Raises:
            SolverError: The factor is void, the right-hand sides do not fit, or the answer misses them.
        """
        answer = self._solver.solve(self._number, rhs)
        check_answer(self._solver.sparsity, self._values, rhs, answer)
        return answer


def available_backends() -> tuple[str, ...]:
    """Names of the backends that are installed, the preferred first."""
    installed = {
        "pardiso": pardiso.library_file() is not None,
        "scipy": True,
        "cholespy": cholmod.is_installed(),
    }
    return tuple(name for name in BACKENDS if installed[name])


def open_solver(sparsity: Sparsity, backend: str = "auto", threads: int | None = None) -> Solver:
    """Analyse a sparsity and get ready to factorise.

    Args:
        sparsity: Where the matrices have entries.
        backend: Name of a backend, or ``auto`` for the first of `available_backends`.
        threads: Most threads inside the solver; as many as the environment allows if left out. Only
            ``pardiso`` uses more than one, and no more than two; their number does not change a bit.

    Raises:
        ConfigError: There is no such backend, it is not installed, or the number of threads is below one.
    """
    if threads is not None and threads < 1:
        raise ConfigError(f"{threads} threads", where="shell solver", hint="give one thread or more")
    match available_backends()[0] if backend == "auto" else backend:
        case "pardiso":
            return Solver(sparsity, pardiso.Pardiso(sparsity, threads))
        case "scipy":
            return Solver(sparsity, SuperLU(sparsity))
        case "cholespy":
            return Solver(sparsity, cholmod.Cholmod(sparsity))
        case unknown:
            raise ConfigError(
                f"no shell solver is named '{unknown}'",
                where="shell solver",
                hint=f"choose one of auto, {', '.join(BACKENDS)}",
            )


def _void(what: str) -> SolverError:
    return SolverError(
        what,
        where="shell solver",
        hint="use the factor before its solver factors again, and the solver before it is closed",
    )
