"""The fastest backend: PARDISO of Intel's oneMKL, called through ctypes.

Documentation: Intel oneMKL Developer Reference, "oneMKL PARDISO - Parallel Direct Sparse Solver Interface"
and "Obtaining Numerically Reproducible Results". The library comes with the extra ``hilbrace[mkl]``. It has a
licence of its own (Intel Simplified Software License), so nothing here needs it.

Calls leave the interpreter free for other threads. On one kind of processor the same matrix gives the same
bits, wherever the arrays lie, through the reproducible mode that is switched on before the first call; and
whatever the number of threads, since more than two, which would split the sums in another way, are not used.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.metadata
import os
import re
import weakref
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import ConfigError, SolverError
from hilbrace.shell.symmetric import Sparsity, singular

Array = np.ndarray

_POSITIVE_DEFINITE = 2
_ANALYSE, _FACTORISE, _SOLVE, _RELEASE = 11, 22, 33, -1
_NOT_POSITIVE, _NO_MEMORY = -4, (-2, -8, -9, -10, -11)

# Positions among the control parameters, which the reference counts from 1.
_OWN_VALUES, _ORDERING, _REPRODUCIBLE_THREADS, _COUNT_FROM_ZERO = 0, 1, 33, 34
_NESTED_DISSECTION = 2

_MOST_THREADS = 2

_INDICES_OF_32_BITS = 0
_REPRODUCIBLE_ON_THIS_PROCESSOR = 2


@cache
def library_file() -> Path | None:
    """Where the installed library lies, None if there is none."""
    try:
        files = importlib.metadata.files("mkl") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    for file in files:
        if re.fullmatch(r"(lib)?mkl_rt[.\d]*\.(so|dll)[.\d]*", file.name):
            return Path(str(file.locate())).resolve()
    found = ctypes.util.find_library("mkl_rt")
    return Path(found) if found else None


@cache
def library() -> ctypes.CDLL:
    """The library, in 32-bit indices and reproducible mode.

    Raises:
        ConfigError: It is not installed, or cannot be loaded.
    """
    file = library_file()
    if file is None:
        raise ConfigError(
            "oneMKL is not installed",
            where="shell solver 'pardiso'",
            hint="pip install 'hilbrace[mkl]', or choose another solver",
        )
    try:
        mkl = ctypes.CDLL(str(file))
    except OSError as fault:
        raise ConfigError(
            f"oneMKL cannot be loaded: {fault}",
            where=str(file),
            hint="pip install --force-reinstall mkl, or choose another solver",
        ) from fault
    mkl.MKL_Set_Interface_Layer(_INDICES_OF_32_BITS)
    mkl.MKL_CBWR_Set(_REPRODUCIBLE_ON_THIS_PROCESSOR)
    mkl.pardiso.argtypes = [ctypes.c_void_p] * 16
    mkl.pardiso.restype = None
    return mkl


@dataclass(frozen=True)
class _Handle:
    """What the library reads and writes between calls; it must stay where it is in memory.

    Attributes:
        mkl: The library.
        threads: Threads of every call; a factor made for two crashes under one.
        row_start: Row pointers of the upper triangle.
        column: Columns of the upper triangle.
        values: Values of the upper triangle.
        memory: The library's own pointers.
        control: Control parameters.
    """

    mkl: ctypes.CDLL
    threads: int
    row_start: Int[Array, " free_plus_one"]
    column: Int[Array, " entry"]
    values: Float[Array, " entry"]
    memory: Int[Array, " 64"] = field(default_factory=lambda: np.zeros(64, dtype=np.int64))
    control: Int[Array, " 64"] = field(default_factory=lambda: np.zeros(64, dtype=np.int32))

    def call(
        self,
        phase: int,
        rhs: Float[Array, "free column"] | None = None,
        answer: Float[Array, "free column"] | None = None,
    ) -> int:
        """Run one phase and give back the library's error number."""
        unused, error = np.zeros(1), ctypes.c_int32(0)
        columns = 1 if rhs is None else rhs.shape[1]
        size = len(self.row_start) - 1
        one, kind, phase_, size_, columns_, silent = (
            ctypes.c_int32(n) for n in (1, _POSITIVE_DEFINITE, phase, size, columns, 0)
        )
        by_address = ctypes.byref
        before = self.mkl.MKL_Set_Num_Threads_Local(self.threads)
        try:
            self.mkl.pardiso(
                self.memory.ctypes.data,
                by_address(one),  # factors kept
                by_address(one),  # the one meant
                by_address(kind),
                by_address(phase_),
                by_address(size_),
                self.values.ctypes.data,
                self.row_start.ctypes.data,
                self.column.ctypes.data,
                unused.ctypes.data,  # permutation, not given
                by_address(columns_),
                self.control.ctypes.data,
                by_address(silent),
                (unused if rhs is None else rhs).ctypes.data,
                (unused if answer is None else answer).ctypes.data,
                by_address(error),
            )
        finally:
            self.mkl.MKL_Set_Num_Threads_Local(before)
        return error.value

    def release(self) -> None:
        """Give the library's memory back."""
        self.call(_RELEASE)


class Pardiso:
    """PARDISO for symmetric positive definite matrices of one sparsity."""

    name = "pardiso"

    def __init__(self, sparsity: Sparsity, threads: int | None = None) -> None:
        mkl = library()
        handle = _Handle(
            mkl=mkl,
            threads=min(threads or mkl.MKL_Get_Max_Threads(), _most_threads()),
            row_start=np.ascontiguousarray(sparsity.start, dtype=np.int32),
            column=np.ascontiguousarray(sparsity.row, dtype=np.int32),
            values=np.zeros(sparsity.entries),
        )
        handle.control[_OWN_VALUES] = 1
        handle.control[_ORDERING] = _NESTED_DISSECTION
        # One thread gives the same bits without the mode for several, which makes solves half as dear again.
        handle.control[_REPRODUCIBLE_THREADS] = handle.threads if handle.threads > 1 else 0
        handle.control[_COUNT_FROM_ZERO] = 1
        self._handle = handle
        self._release = weakref.finalize(self, handle.release)
        self._release.atexit = False
        _refuse(handle.call(_ANALYSE))

    def factor(self, values: Float[Array, " entry"]) -> None:
        """Factorise.

        Raises:
            SolverError: A pivot is not positive, or the memory is full.
        """
        self._handle.values[:] = values
        _refuse(self._handle.call(_FACTORISE))

    def solve(self, rhs: Float[Array, "free column"]) -> Float[Array, "free column"]:
        """Solve with the last factor.

        Raises:
            SolverError: The memory is full.
        """
        answer = np.zeros_like(rhs, order="F")
        if rhs.shape[1]:
            _refuse(self._handle.call(_SOLVE, rhs, answer))
        return answer

    def close(self) -> None:
        """Give the library's memory back."""
        self._release()


def _most_threads() -> int:
    """Two threads, or one where the environment keeps OpenMP from starting a second.

    PARDISO would wait forever for the thread that it asked for and did not get.
    """
    limited = any(name in os.environ for name in ("OMP_THREAD_LIMIT", "OMP_MAX_ACTIVE_LEVELS"))
    return 1 if limited else _MOST_THREADS


def _refuse(error: int) -> None:
    """Turn an error number of the library into an error of ours."""
    if error == 0:
        return
    if error == _NOT_POSITIVE:
        raise singular()
    what = "the memory is full" if error in _NO_MEMORY else f"PARDISO gives up with error {error}"
    raise SolverError(
        what,
        where="shell solver 'pardiso'",
        hint="close other programs, use fewer triangles, or choose another solver",
    )
