"""The shell's solvers: right answers, refused matrices, and how long a factor is valid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import ConfigError, SolverError
from hilbrace.shell import build_shell
from hilbrace.shell.assembly import free_stiffness
from hilbrace.shell.solver import available_backends, open_solver
from hilbrace.shell.symmetric import Sparsity, both_triangles, check_answer, product
from tests.unit.shell_cases import tube

SHELL = build_shell(*tube(10, 5, 30.0, 80.0, waviness=0.1), 4.0, 0.45)
SPARSITY = SHELL.numbering.sparsity


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


def test_unknown_backend_is_named_with_the_known_ones():
    with pytest.raises(ConfigError, match="'mumps'") as caught:
        open_solver(SPARSITY, "mumps")
    assert "scipy" in caught.value.hint


def test_threads_are_at_least_one():
    with pytest.raises(ConfigError, match="0 threads"):
        open_solver(SPARSITY, threads=0)
