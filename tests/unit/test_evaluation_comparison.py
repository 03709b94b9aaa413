"""The table: published examples of reliability, textbook intervals, and the paper's own numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from evaluation.comparison import METHODS, Estimate, compare, disagreements, estimate
from evaluation.published import published_rows
from evaluation.reliability import (
    detectable_change,
    intraclass_correlation,
    standard_error_of_measurement,
    welch_quantile,
)
from evaluation.synchronize import Repeat
from hilbrace.errors import InputError
from tests.unit.test_evaluation_synchronize import RATE, repeat

SHROUT_FLEISS = np.array(
    [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], float
)
"""Table 2 of Shrout & Fleiss 1979: six targets, four judges."""


def test_intraclass_correlations_of_shrout_and_fleiss():
    found = intraclass_correlation(SHROUT_FLEISS)
    assert (round(found.one_way, 2), round(found.two_way, 2), round(found.fixed, 2)) == (0.17, 0.29, 0.71)


def test_the_error_of_measurement_is_what_the_correlation_leaves():
    scores = np.random.default_rng(2).normal(0, 3, (6, 5)) + np.arange(6)[:, None]
    error = standard_error_of_measurement(list(scores))
    within = error**2
    between = 5 * scores.mean(axis=1).var(ddof=1)
    total = np.sqrt((between - within) / 5 + within)
    assert error == pytest.approx(total * np.sqrt(1 - intraclass_correlation(scores).one_way))
    assert detectable_change(2.0, 1) == pytest.approx(1.96 * np.sqrt(2) * 2, abs=1e-3)
    assert detectable_change(2.0, 5) == pytest.approx(1.96 * 2 * np.sqrt(2 / 5), abs=1e-3)


def test_one_condition_has_no_correlation_and_one_repeat_no_error():
    with pytest.raises(InputError, match="1 conditions of 5 repeats"):
        intraclass_correlation(np.zeros((1, 5)))
    assert np.isnan(standard_error_of_measurement([np.zeros(1), np.ones(1)]))
    assert np.isnan(intraclass_correlation(np.zeros((3, 3))).one_way)


def test_the_quantile_is_welchs():
    rng = np.random.default_rng(0)
    one, other = rng.normal(0, 2, 5), rng.normal(1, 4, 7)
    errors = [(x.std(ddof=1) / np.sqrt(len(x)), len(x)) for x in (one, other)]
    interval = stats.ttest_ind(one, other, equal_var=False).confidence_interval(0.95)
    half = welch_quantile(errors) * np.hypot(errors[0][0], errors[1][0])
    assert half == pytest.approx((interval.high - interval.low) / 2)
    assert np.isnan(welch_quantile([(1.0, 1), (1.0, 5)]))
    assert welch_quantile([(0.0, 5)]) == 0.0


def scattered(depths, frontals):
    return [repeat(depth=(d, d - 10), frontal=(f / 4, f)) for d, f in zip(depths, frontals, strict=True)]


UNBRACED = scattered([68.0, 70.0, 71.0, 69.0, 72.0], [-4.0, -5.0, -3.0, -4.5, -3.5])
BRACED = scattered([60.0, 66.0, 62.0, 64.0, 58.0], [-1.0, -1.5, -0.5, -1.2, -0.8])


@pytest.mark.parametrize("method", METHODS)
def test_the_bootstrap_error_of_a_mean_is_the_textbooks(method):
    """Of single peaks, SD/sqrt(n); mean curves of one pace have the same peaks."""
    found = estimate([UNBRACED, BRACED], method, RATE)
    depths = np.array([60.0, 66.0, 62.0, 64.0, 58.0])
    assert found.angle_deg[1, 0, 0] == pytest.approx(-62, abs=0.05)
    assert found.error_deg[1, 0, 0] == pytest.approx(depths.std(ddof=1) / np.sqrt(5), rel=0.05)
    assert found.angle_deg[0, 1, 1] == pytest.approx(-4, abs=0.05)


def test_the_same_seed_gives_the_same_table():
    one, other, third = (estimate([UNBRACED, BRACED], "paper", RATE, seed) for seed in (1, 1, 2))
    assert np.array_equal(one.error_deg, other.error_deg)
    assert not np.array_equal(one.error_deg, third.error_deg)


def test_intervals_are_those_of_welchs_test():
    table = compare(estimate([UNBRACED, BRACED], "per_trial", RATE), 0, "per_trial")
    one, other = np.array([68.0, 70, 71, 69, 72]), np.array([60.0, 66, 62, 64, 58])
    interval = stats.ttest_ind(-other, -one, equal_var=False).confidence_interval(0.95)
    assert table.signed_deg[1, 0, 0] == pytest.approx(8.0, abs=0.05)
    assert table.low_deg[1, 0, 0] == pytest.approx(interval.low, abs=0.25)
    assert table.high_deg[1, 0, 0] == pytest.approx(interval.high, abs=0.25)
    noise = one.var(ddof=1) / 5 + other.var(ddof=1) / 5
    assert table.unbiased[1, 0, 0] == pytest.approx(64 - noise, abs=1.0)


def given(angles, error=1.0, repeats=5):
    angles = np.asarray(angles, float)
    return Estimate(angles, np.full(angles.shape, error), np.full(len(angles), repeats))


def test_squares_and_their_intervals():
    """Sagittal against the baseline, frontal against zero; an interval around zero starts there."""
    angles = [[[-70, -1], [-60, -4]], [[-69, 1], [-50, -0.5]]]
    table = compare(given(angles), 0, "paper")
    assert table.signed_deg.tolist() == [[[0, -1], [0, -4]], [[1, 1], [10, -0.5]]]
    assert table.squared.tolist() == [[[0, 1], [0, 16]], [[1, 1], [100, 0.25]]]
    assert table.squared_low[0].tolist() == [[0, 0], [0, pytest.approx((4 - 2.776) ** 2, abs=0.01)]]
    assert table.squared_high[0, 0, 0] == 0.0
    half = stats.t.ppf(0.975, 8) * np.sqrt(2)
    assert table.squared_low[1, 1, 0] == pytest.approx((10 - half) ** 2)
    assert table.squared_high[1, 1, 0] == pytest.approx((10 + half) ** 2)
    assert table.unbiased[1].tolist() == [[-1, 0], [98, -0.75]]


def test_the_best_condition_is_never_the_baseline():
    angles = [[[-70, 0], [-60, 0]], [[-69, 1], [-50, -0.5]], [[-60, 2], [-59, -0.4]]]
    assert compare(given(angles), 0, "paper").best.tolist() == [[1, 1], [2, 2]]


def test_the_papers_bold_values_are_its_column_minima():
    rows = list(published_rows().values())
    signs = np.stack([np.sqrt(row.squared) for row in rows])
    table = compare(given(signs - [[[70, 0], [60, 0]]]), 0, "paper")
    assert table.squared == pytest.approx(np.stack([row.squared for row in rows]), abs=1e-9)
    best = [[rows[k].key for k in event] for event in table.best]
    assert best == [["optimized", "commercial"], ["optimized", "commercial"]]


def test_published_values_are_those_of_the_papers_source(shared_data):
    source = next((shared_data.parent / "paper").glob("*.tex"), None)
    if source is None:
        pytest.skip("the paper's source is not beside the recorded data")
    text = source.read_text("utf-8").split("Joint angle comparison")[1].split("\\end{tabular}")[0]
    rows = [line.replace("\\textbf{", "").replace("}", "").replace("\\\\", "") for line in text.splitlines()]
    printed = []
    for line in rows:
        cells = line.split("&")
        if len(cells) == 5 and cells[1].strip().replace(".", "").isdigit():
            printed.append([float(cell) for cell in cells[1:]])
    assert printed == [row.squared.ravel().tolist() for row in published_rows().values()]


def test_methods_that_differ_by_more_than_a_degree_are_named():
    one = compare(given([[[-70, -1], [-60, -4]], [[-69, 1], [-50, -0.5]]]), 0, "paper")
    other = compare(given([[[-70, -1], [-60, -4]], [[-69, 1], [-48, -0.5]]]), 0, "per_trial")
    sentences = disagreements({"paper": one, "per_trial": other}, ("Unbraced", "Ours"))
    assert sentences == [
        "Ours, landing, sagittal: the methods differ by 2.0 deg (paper +10.0, per_trial +12.0)."
    ]
    assert disagreements({"paper": one, "per_trial": one}, ("Unbraced", "Ours")) == []


def test_a_single_repeat_has_a_value_but_no_interval():
    table = compare(estimate([UNBRACED, BRACED[:1]], "paper", RATE), 0, "paper")
    assert table.squared[1, 0, 0] == pytest.approx(100, abs=1)
    assert np.isnan(table.low_deg[1]).all()
    assert np.isfinite(table.low_deg[0]).all()


def test_five_repeats_cover_the_truth_as_often_as_they_say():
    """95 % intervals of the difference of two conditions, 400 studies of single peaks, both planes."""
    rng = np.random.default_rng(8)
    time = np.arange(3) / RATE
    inside = []
    for _ in range(400):
        groups = []
        for truth in (-70.0, -67.0):
            values = truth + rng.normal(0, 2.0, 5)
            groups.append([Repeat("r", time, np.full((3, 3), v), 0.0, 0.01) for v in values])
        table = compare(estimate(groups, "per_trial", RATE), 0, "per_trial")
        inside.append(table.low_deg[1, 0, 0] <= 3.0 <= table.high_deg[1, 0, 0])
    assert 0.925 < np.mean(inside) < 0.985
