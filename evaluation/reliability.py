"""How repeatable a measurement is: intraclass correlation, error of measurement, detectable change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from hilbrace.errors import InputError

Array = np.ndarray

CONFIDENCE = 0.95
_TWO_SIDED = 1.959963984540054


@dataclass(frozen=True)
class IntraclassCorrelation:
    """Intraclass correlations of single scores (Shrout & Fleiss 1979, Psychol Bull 86:420-428).

    Attributes:
        one_way: ICC(1,1): repeats of different targets have nothing in common.
        two_way: ICC(2,1): absolute agreement of repeats that are a sample.
        fixed: ICC(3,1): consistency of repeats that are all there are.
    """

    one_way: float
    two_way: float
    fixed: float


def intraclass_correlation(scores: Float[Array, "target repeat"]) -> IntraclassCorrelation:
    """Intraclass correlations of a full table of scores; NaN where nothing varies.

    Args:
        scores: One row per target (a condition), one column per repeat.

    Raises:
        InputError: There are fewer than two targets or repeats.
    """
    targets, repeats = scores.shape
    if targets < 2 or repeats < 2:
        raise InputError(
            f"{targets} conditions of {repeats} repeats have no intraclass correlation",
            where="reliability",
            hint="give two or more of both",
        )
    mean = scores.mean()
    between = repeats * ((scores.mean(axis=1) - mean) ** 2).sum() / (targets - 1)
    columns = targets * ((scores.mean(axis=0) - mean) ** 2).sum() / (repeats - 1)
    total = ((scores - mean) ** 2).sum()
    within = (total - between * (targets - 1)) / (targets * (repeats - 1))
    rest = (total - between * (targets - 1) - columns * (repeats - 1)) / ((targets - 1) * (repeats - 1))
    return IntraclassCorrelation(
        _ratio(between - within, between + (repeats - 1) * within),
        _ratio(between - rest, between + (repeats - 1) * rest + repeats * (columns - rest) / targets),
        _ratio(between - rest, between + (repeats - 1) * rest),
    )


def standard_error_of_measurement(groups: list[Float[Array, " _"]]) -> float:
    """Pooled standard deviation between repeats of the same condition.

    With as many repeats in every condition it equals ``SD sqrt(1 - ICC(1,1))`` for an SD that counts between
    and within conditions. NaN if no condition was repeated.

    Args:
        groups: Scores of every condition.
    """
    degrees = sum(len(group) - 1 for group in groups)
    if not degrees:
        return float("nan")
    squares = sum(float(((group - group.mean()) ** 2).sum()) for group in groups)
    return float(np.sqrt(squares / degrees))


def detectable_change(error_of_measurement: float, repeats: float) -> float:
    """Smallest difference between two means that is beyond the error of measurement at 95 %.

    Args:
        error_of_measurement: Standard error of measurement.
        repeats: Repeats behind each mean; 1 for single trials.
    """
    return _TWO_SIDED * float(np.sqrt(2.0 / repeats)) * error_of_measurement


def welch_quantile(errors: list[tuple[float, int]]) -> float:
    """Student's quantile for a sum of independent errors (Welch-Satterthwaite), two-sided 95 %.

    Args:
        errors: Standard error and number of repeats of each part.
    """
    total = sum(error**2 for error, _ in errors)
    if total == 0.0:
        return 0.0
    if any(count < 2 for _, count in errors):
        return float("nan")
    freedom = total**2 / sum(error**4 / (count - 1) for error, count in errors)
    return float(student.ppf(0.5 + CONFIDENCE / 2, freedom))


def _ratio(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else float("nan")
