"""Solvers for the shells of one brace: the sparsity is analysed once, and shapes are solved side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from queue import LifoQueue
from typing import TypeVar

import torch

from hilbrace.errors import ConfigError, SolverError
from hilbrace.shell.solver import Solver, open_solver
from hilbrace.shell.symmetric import Sparsity

Answer = TypeVar("Answer")


def side_by_side(jobs: Sequence[Callable[[], Answer]], threads: int) -> list[Answer]:
    """Do jobs on threads; their answers in the same order, whichever is done first."""
    if threads == 1 or len(jobs) <= 1:
        return [job() for job in jobs]
    with ThreadPoolExecutor(min(threads, len(jobs))) as executor:
        return list(executor.map(lambda job: job(), jobs))


class SolverPool:
    """Solvers of one sparsity, for one shell or for many shapes of it.

    One shape at a time is solved by one solver with all threads. Several are spread over threads, each with
    a solver of its own that uses one thread, so that the answers do not depend on how many there are.

    Whoever opens a pool closes it; it is a context manager. Its memory is one factor per thread.

        with open_pool(shell.numbering.sparsity) as pool:
            for modulus in designs:
                shell_response(modulus, shell, load, solvers=pool)
    """

    def __init__(self, sparsity: Sparsity, backend: str, threads: int) -> None:
        self.sparsity = sparsity
        self.threads = threads
        self._backend = backend
        self._one: LifoQueue[Solver] = LifoQueue()
        self._many: LifoQueue[Solver] = LifoQueue()
        self._opened: list[Solver] = []
        self._closed = False
        self._one.put(self._open(threads))

    @property
    def name(self) -> str:
        """Name of the solvers' backend."""
        return self._opened[0].name

    def run(self, jobs: Sequence[Callable[[Solver], Answer]]) -> list[Answer]:
        """Do jobs that need a solver; their answers in the same order.

        Raises:
            SolverError: The pool is closed.
        """
        if self._closed:
            raise SolverError(
                "the pool of solvers is closed",
                where="shell solver",
                hint="keep the pool open until the last gradient is taken",
            )
        idle = self._one
        if len(jobs) > 1 and self.threads > 1:
            idle = self._many
            while len(self._opened) <= min(self.threads, len(jobs)):
                idle.put(self._open(1))
        return side_by_side([partial(self._with, idle, job) for job in jobs], self.threads)

    def close(self) -> None:
        """Give the memory of all solvers back; they are void from here on."""
        self._closed = True
        for solver in self._opened:
            solver.close()

    def __enter__(self) -> SolverPool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, threads: int) -> Solver:
        solver = open_solver(self.sparsity, self._backend, threads)
        self._opened.append(solver)
        return solver

    @staticmethod
    def _with(idle: LifoQueue[Solver], job: Callable[[Solver], Answer]) -> Answer:
        solver = idle.get()
        try:
            return job(solver)
        finally:
            idle.put(solver)


def open_pool(sparsity: Sparsity, backend: str = "auto", threads: int | None = None) -> SolverPool:
    """Analyse a sparsity and get solvers ready.

    Args:
        sparsity: Where the stiffness of the shells has entries; ``shell.numbering.sparsity``.
        backend: Name of a solver's backend, or ``auto`` for the fastest that is installed.
        threads: Threads to use; as many as torch uses if left out.

    Raises:
        ConfigError: There is no such backend, it is not installed, or the number of threads is below one.
    """
    count = torch.get_num_threads() if threads is None else threads
    if count < 1:
        raise ConfigError(f"{count} threads", where="shell solver", hint="give one thread or more")
    return SolverPool(sparsity, backend, count)
