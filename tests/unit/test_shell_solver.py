"""The shell's solvers: right answers, refused matrices, the same bits twice, and the life of a factor."""

from __future__ import annotations

import gc
import hashlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import ConfigError, SolverError
from hilbrace.shell import build_shell, cholmod, pardiso
from hilbrace.shell.assembly import free_stiffness
from hilbrace.shell.solver import BACKENDS, available_backends, open_solver
from hilbrace.shell.symmetric import Sparsity, both_triangles, check_answer, product
from tests.unit.shell_cases import tube

SHELL = build_shell(*tube(10, 5, 30.0, 80.0, waviness=0.1), 4.0, 0.45)
SPARSITY = SHELL.numbering.sparsity
BRACE = build_shell(*tube(28, 24, 60.0, 300.0, waviness=0.1, window=True), 4.0, 0.45)

needs_pardiso = pytest.mark.skipif(
    "pardiso" not in available_backends(), reason="needs oneMKL: pip install 'hilbrace[mkl]'"
)


def some_values(seed=0):
    return SHELL.refill @ np.random.default_rng(seed).uniform(0.1, 1.0, len(SHELL.triangles))


def some_rhs(columns, seed=0):
    return np.random.default_rng(seed).standard_normal((SPARSITY.size, columns))


@pytest.fixture(params=available_backends())
def solver(request):
    with open_solver(SPARSITY, request.param) as opened:
        assert opened.name == request.param
        yield opened


# --- storage by one triangle


def test_sparsity_stores_each_pair_once():
    columns = np.repeat(np.arange(SPARSITY.size), np.diff(SPARSITY.start))
    assert (SPARSITY.row >= columns).all()
    assert SPARSITY.start.dtype == SPARSITY.row.dtype == np.int32
    modulus = np.ones(len(SHELL.triangles))
    full = free_stiffness(SHELL.numbering, SHELL.refill, modulus)
    assert full.nnz == 2 * SPARSITY.entries - SPARSITY.size


def test_both_triangles_are_symmetric_and_give_the_product():
    values = some_values()
    start, row, source = both_triangles(SPARSITY)
    dense = np.zeros((SPARSITY.size, SPARSITY.size))
    dense[row, np.repeat(np.arange(SPARSITY.size), np.diff(start))] = values[source]
    assert np.array_equal(dense, dense.T)
    vectors = some_rhs(3)
    np.testing.assert_allclose(product(SPARSITY, values, vectors), dense @ vectors, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("start", "row"),
    [([0, 1, 2], [1, 1]), ([0, 2, 2], [0, 1]), ([0, 3, 4], [0, 2, 1, 1]), ([0, 2, 4], [0, 1, 0, 1])],
    ids=["no diagonal", "empty column", "not ascending", "upper entry"],
)
def test_other_storage_is_refused(start, row):
    with pytest.raises(SolverError, match="lower triangle"):
        Sparsity(np.array(start, dtype=np.int32), np.array(row, dtype=np.int32))


# --- answers


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 9), st.sampled_from(available_backends()))
def test_solve_inverts_the_product(seed, columns, backend):
    values, expected = some_values(seed), some_rhs(columns, seed)
    with open_solver(SPARSITY, backend) as solver:
        answer = solver.factor(values).solve(product(SPARSITY, values, expected))
    np.testing.assert_allclose(answer, expected, rtol=1e-7, atol=1e-8)


def test_no_columns_give_no_columns(solver):
    assert solver.factor(some_values()).solve(some_rhs(0)).shape == (SPARSITY.size, 0)


def test_order_in_memory_and_zeros_do_not_matter(solver):
    factor = solver.factor(some_values())
    rhs = some_rhs(4)
    rhs[:, 2] = 0.0
    by_rows = factor.solve(np.ascontiguousarray(rhs))
    assert np.array_equal(by_rows, factor.solve(np.asfortranarray(rhs)))
    assert not by_rows[:, 2].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_backends_agree_on_a_brace(backend):
    if backend not in available_backends():
        pytest.skip(f"the library of '{backend}' is not installed")
    values, rhs = brace_problem()
    answers = []
    for name in (backend, "scipy"):
        with open_solver(BRACE.numbering.sparsity, name) as solver:
            answers.append(solver.factor(values).solve(rhs))
    scale = np.abs(answers[1]).max(axis=0)
    assert (np.abs(answers[0] - answers[1]).max(axis=0) <= 1e-8 * scale).all()
    residual = product(BRACE.numbering.sparsity, values, answers[0]) - rhs
    assert np.abs(residual).max() < 1e-9 * np.abs(rhs).max()


def brace_problem():
    """Modulus over a decade, forces of single vertices in 15 columns."""
    rng = np.random.default_rng(7)
    values = BRACE.refill @ 10.0 ** rng.uniform(-1.0, 0.0, len(BRACE.triangles))
    rhs = np.zeros((BRACE.numbering.sparsity.size, 15))
    rhs[5 * rng.integers(0, len(rhs) // 5, 15), np.arange(15)] = 1.0
    return values, rhs


# --- the same bits twice


def fingerprint(threads, backend="pardiso", shift=0, threads_of_python=1):
    """Digest of three factors and answers, with all arrays a few doubles off the alignment of the cache."""
    values, rhs = brace_problem()

    def once(_):
        with open_solver(BRACE.numbering.sparsity, backend, threads) as solver:
            answers = [
                solver.factor(off_alignment(factor * values, shift)).solve(off_alignment(rhs, shift))
                for factor in (1.0, 0.3, 1.0)
            ]
        assert np.array_equal(answers[0], answers[2])
        return hashlib.sha256(b"".join(answer.tobytes("F") for answer in answers)).hexdigest()

    with ThreadPoolExecutor(threads_of_python) as executor:
        digests = set(executor.map(once, range(2 * threads_of_python)))
    assert len(digests) == 1
    return digests.pop()


def off_alignment(array, doubles):
    room = np.empty(array.nbytes + 128, dtype=np.uint8)
    first = -room.ctypes.data % 64 + 8 * doubles
    out = room[first : first + array.nbytes].view(np.float64).reshape(array.shape, order="F")
    out[...] = array
    return out


@pytest.mark.parametrize("backend", available_backends())
def test_same_matrix_gives_the_same_bits(backend):
    assert fingerprint(None, backend) == fingerprint(None, backend, shift=3)


@needs_pardiso
def test_number_of_threads_does_not_change_a_bit():
    assert fingerprint(1) == fingerprint(2, shift=5) == fingerprint(3, shift=1)


@needs_pardiso
def test_solvers_in_several_threads_of_python_do_not_change_a_bit():
    assert fingerprint(1) == fingerprint(1, threads_of_python=2) == fingerprint(2, threads_of_python=2)


@needs_pardiso
@pytest.mark.parametrize("environment", [{"OMP_NUM_THREADS": "2"}, {"OMP_THREAD_LIMIT": "1"}])
def test_another_process_gives_the_same_bits(environment):
    code = "from tests.unit.test_shell_solver import fingerprint as f; print(f(1), f(2, shift=2))"
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=root,
        env=os.environ | environment,
        timeout=120,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == [fingerprint(1), fingerprint(2)]


# --- what is refused


def zero_equation():
    values = some_values()
    columns = np.repeat(np.arange(SPARSITY.size), np.diff(SPARSITY.start))
    values[(columns == 7) | (SPARSITY.row == 7)] = 0.0
    return values


def one_negative_pivot():
    values = some_values()
    values[SPARSITY.start[7]] *= -1.0
    return values


@pytest.mark.parametrize(
    "values", [zero_equation(), one_negative_pivot(), np.zeros(SPARSITY.entries), -some_values()]
)
def test_matrix_that_is_not_positive_definite_is_refused(solver, values):
    with pytest.raises(SolverError, match="singular"):
        solver.factor(values).solve(some_rhs(1))


def test_solver_recovers_from_a_refused_matrix(solver):
    with pytest.raises(SolverError, match="singular"):
        solver.factor(zero_equation())
    values, expected = some_values(), some_rhs(2)
    answer = solver.factor(values).solve(product(SPARSITY, values, expected))
    np.testing.assert_allclose(answer, expected, rtol=1e-7, atol=1e-8)


def test_wrong_answers_are_noticed_in_any_column():
    values, rhs = some_values(), some_rhs(5)
    with open_solver(SPARSITY) as solver:
        answer = solver.factor(values).solve(rhs * 10.0 ** np.arange(-8, 2, 2))
    check_answer(SPARSITY, values, rhs * 10.0 ** np.arange(-8, 2, 2), answer)
    for column in range(5):
        wrong = answer.copy()
        wrong[:, column] *= 1.001
        with pytest.raises(SolverError, match="singular"):
            check_answer(SPARSITY, values, rhs * 10.0 ** np.arange(-8, 2, 2), wrong)
        wrong[3, column] = np.nan
        with pytest.raises(SolverError, match="singular"):
            check_answer(SPARSITY, values, rhs * 10.0 ** np.arange(-8, 2, 2), wrong)


def test_values_that_do_not_fit_are_refused(solver):
    with pytest.raises(SolverError, match="entries of the stiffness"):
        solver.factor(some_values()[:-1])
    broken = some_values()
    broken[5] = np.nan
    with pytest.raises(SolverError, match="not finite"):
        solver.factor(broken)


@pytest.mark.malformed
def test_right_hand_sides_that_do_not_fit_are_refused(solver):
    factor = solver.factor(some_values())
    with pytest.raises(SolverError, match="equations"):
        factor.solve(some_rhs(2)[:-1])
    with pytest.raises(SolverError, match="equations"):
        factor.solve(some_rhs(1)[:, 0])
    broken = some_rhs(3)
    broken[4, 1] = np.inf
    with pytest.raises(SolverError, match="load 1"):
        factor.solve(broken)


# --- life of solvers and factors


def test_factor_is_void_after_the_next_one(solver):
    first = solver.factor(some_values(0))
    second = solver.factor(some_values(1))
    with pytest.raises(SolverError, match="out of date"):
        first.solve(some_rhs(1))
    assert np.isfinite(second.solve(some_rhs(1))).all()


def test_closed_solver_is_void(solver):
    factor = solver.factor(some_values())
    solver.close()
    solver.close()
    with pytest.raises(SolverError, match="closed"):
        factor.solve(some_rhs(1))
    with pytest.raises(SolverError, match="closed"):
        solver.factor(some_values())


@needs_pardiso
@pytest.mark.parametrize("leave", ["close", "forget"])
def test_memory_of_closed_and_forgotten_solvers_is_given_back(leave):
    values, _ = brace_problem()

    def use():
        solver = open_solver(BRACE.numbering.sparsity, "pardiso", threads=1)
        solver.factor(values)
        if leave == "close":
            solver.close()

    def fill(times):
        for _ in range(times):
            use()
        gc.collect()
        return psutil.Process().memory_info().rss

    before = fill(3)
    least_size_of_a_factor = 8 * BRACE.numbering.sparsity.entries
    assert fill(12) - before < 4 * least_size_of_a_factor


def test_a_solver_shared_by_threads_serves_them_one_after_the_other(solver):
    values, rhs = some_values(), some_rhs(3)
    factor = solver.factor(values)
    expected = factor.solve(rhs)
    with ThreadPoolExecutor(4) as executor:
        answers = list(executor.map(factor.solve, [rhs] * 12))
    assert all(np.array_equal(answer, expected) for answer in answers)


# --- choice of the backend


def test_automatic_choice_is_the_first_that_is_installed():
    with open_solver(SPARSITY) as solver:
        assert solver.name == available_backends()[0]
    assert [name for name in BACKENDS if name in available_backends()] == list(available_backends())
    assert "scipy" in available_backends()


def test_backends_that_are_not_installed_name_the_extra_to_install(monkeypatch):
    monkeypatch.setattr(pardiso, "library_file", lambda: None)
    monkeypatch.setitem(sys.modules, "cholespy", None)
    monkeypatch.setattr(cholmod, "is_installed", lambda: False)
    pardiso.library.cache_clear()
    assert available_backends() == ("scipy",)
    with open_solver(SPARSITY) as solver:
        assert solver.name == "scipy"
    for backend, extra in (("pardiso", "hilbrace[mkl]"), ("cholespy", "hilbrace[cholespy]")):
        with pytest.raises(ConfigError, match="not installed") as caught:
            open_solver(SPARSITY, backend)
        assert extra in caught.value.hint


def test_library_that_cannot_be_loaded_is_named(monkeypatch, tmp_path):
    broken = tmp_path / "libmkl_rt.so"
    broken.write_text("no library")
    monkeypatch.setattr(pardiso, "library_file", lambda: broken)
    pardiso.library.cache_clear()
    with pytest.raises(ConfigError, match="cannot be loaded"):
        open_solver(SPARSITY, "pardiso")


def test_unknown_backend_is_named_with_the_known_ones():
    with pytest.raises(ConfigError, match="'mumps'") as caught:
        open_solver(SPARSITY, "mumps")
    assert "scipy" in caught.value.hint


def test_threads_are_at_least_one():
    with pytest.raises(ConfigError, match="0 threads"):
        open_solver(SPARSITY, threads=0)
