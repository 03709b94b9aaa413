"""The paper's comparison of brace conditions, with the uncertainty that the paper does not print.

The published table holds squared degrees: the sagittal angle is compared with the unbraced condition's, the
frontal one with zero, at the bending and at the landing peak; each difference of means is squared. So an
entry is never negative, the unbraced sagittal entries are exactly zero, and noise alone makes entries grow:
a squared difference of two means of five repeats with 2 degrees between repeats averages 1.6 without any
effect. The signed difference and its interval are therefore reported beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Int

from evaluation.conventions import FRONTAL, SAGITTAL
from evaluation.reliability import welch_quantile
from evaluation.synchronize import (
    Repeat,
    peaks_of_mean,
    peaks_of_repeats,
    register_both_peaks,
    shift_to_bending,
)

Array = np.ndarray

Method = Literal["paper", "per_trial", "two_landmark"]
METHODS: tuple[Method, ...] = get_args(Method)
EVENTS = ("bending", "landing")
TABLE_PLANES = ("sagittal", "frontal")

RESAMPLES = 2000
"""Bootstrap samples of the repeats of a condition."""

METHODS_DIFFER_DEG = 1.0


@dataclass(frozen=True)
class Estimate:
    """Angles of every condition by one method.

    Attributes:
        angle_deg: Mean angle at the event [deg].
        error_deg: Bootstrap standard error of that mean [deg]; NaN without repeats.
        repeats: Repeats of each condition.
    """

    angle_deg: Float[Array, "condition event plane"]
    error_deg: Float[Array, "condition event plane"]
    repeats: Int[Array, " condition"]


@dataclass(frozen=True)
class Comparison:
    """The table by one method; axes are condition, event (bending, landing), plane (sagittal, frontal).

    Attributes:
        method: ``paper``, ``per_trial`` or ``two_landmark``.
        angle_deg: Mean angle at the event [deg].
        signed_deg: Sagittal: difference from the baseline; frontal: the angle itself [deg].
        low_deg: Lower end of its 95 % interval [deg].
        high_deg: Upper end [deg].
        squared: Squared difference, as the paper prints it [deg^2].
        squared_low: Lower end of its interval [deg^2].
        squared_high: Upper end [deg^2].
        unbiased: Squared difference less what noise adds on average [deg^2]; negative by chance.
        repeats: Repeats of each condition.
        baseline: Index of the baseline condition.
    """

    method: Method
    angle_deg: Float[Array, "condition event plane"]
    signed_deg: Float[Array, "condition event plane"]
    low_deg: Float[Array, "condition event plane"]
    high_deg: Float[Array, "condition event plane"]
    squared: Float[Array, "condition event plane"]
    squared_low: Float[Array, "condition event plane"]
    squared_high: Float[Array, "condition event plane"]
    unbiased: Float[Array, "condition event plane"]
    repeats: Int[Array, " condition"]
    baseline: int

    @property
    def best(self) -> Int[Array, "event plane"]:
        """Condition with the smallest squared difference, the baseline left out."""
        shown = self.squared.copy()
        if len(shown) > 1:
            shown[self.baseline] = np.inf
        return shown.argmin(axis=0)


def estimate(conditions: list[list[Repeat]], method: Method, rate_hz: float, seed: int = 0) -> Estimate:
    """Angles of every condition at both events, with standard errors from resampled repeats.

    The repeats of a condition are drawn with replacement, and the whole reading (mean curve, its peaks) is
    done again; the spread is multiplied by sqrt(n/(n-1)), without which a bootstrap of five repeats is too
    narrow (Hesterberg 2015, Am Stat 69:371).

    Args:
        conditions: Repeats of every condition.
        method: How repeats become one value.
        rate_hz: Frames per second of mean curves [Hz].
        seed: Seed of the resampling.
    """
    shape = (len(conditions), len(EVENTS), len(TABLE_PLANES))
    angle, error = np.zeros(shape), np.full(shape, np.nan)
    for k, repeats in enumerate(conditions):
        count = len(repeats)
        rng = np.random.default_rng([seed, k])
        drawn = rng.multinomial(count, np.full(count, 1 / count), RESAMPLES) / count
        weights = np.concatenate([np.full((1, count), 1 / count), drawn])
        values = _read(repeats, method, rate_hz, weights)[:, :, [SAGITTAL, FRONTAL]]
        angle[k] = values[0]
        if count > 1:
            error[k] = values[1:].std(axis=0) * np.sqrt(count / (count - 1))
    return Estimate(angle, error, np.array([len(repeats) for repeats in conditions]))


def compare(found: Estimate, baseline: int, method: Method) -> Comparison:
    """Compare every condition with the baseline (sagittal) and with zero (frontal).

    Intervals are Student's, with the degrees of freedom of Welch and Satterthwaite. The interval of a square
    holds the squares of all values in the interval of the signed difference.

    Args:
        found: Angles and errors.
        baseline: Index of the unbraced condition.
        method: Where the angles come from.
    """
    signed, half, noise = (np.zeros_like(found.angle_deg) for _ in range(3))
    for condition, event, plane in np.ndindex(*signed.shape):
        parts = [(float(found.error_deg[condition, event, plane]), int(found.repeats[condition]))]
        reference = 0.0
        if plane == SAGITTAL:
            reference = float(found.angle_deg[baseline, event, plane])
            parts.append((float(found.error_deg[baseline, event, plane]), int(found.repeats[baseline])))
            if condition == baseline:
                parts = [(0.0, 2)]
        signed[condition, event, plane] = found.angle_deg[condition, event, plane] - reference
        noise[condition, event, plane] = sum(error**2 for error, _ in parts)
        half[condition, event, plane] = welch_quantile(parts) * np.sqrt(noise[condition, event, plane])
    low, high = signed - half, signed + half
    ends = np.sort(np.stack([low**2, high**2]), axis=0)
    around_zero = (low <= 0) & (high >= 0)
    return Comparison(
        method=method,
        angle_deg=found.angle_deg,
        signed_deg=signed,
        low_deg=low,
        high_deg=high,
        squared=signed**2,
        squared_low=np.where(around_zero, 0.0, ends[0]),
        squared_high=ends[1],
        unbiased=signed**2 - noise,
        repeats=found.repeats,
        baseline=baseline,
    )


def disagreements(tables: dict[str, Comparison], conditions: tuple[str, ...]) -> list[str]:
    """Sentences about cells whose value depends on the method by more than a degree.

    Args:
        tables: Comparison by method.
        conditions: Names of the conditions.
    """
    found = []
    stack = np.stack([table.signed_deg for table in tables.values()])
    spread = np.asarray(stack.max(axis=0) - stack.min(axis=0))
    for condition, event, plane in np.argwhere(spread > METHODS_DIFFER_DEG):
        values = ", ".join(
            f"{name} {value:+.1f}"
            for name, value in zip(tables, stack[:, condition, event, plane], strict=True)
        )
        found.append(
            f"{conditions[condition]}, {EVENTS[event]}, {TABLE_PLANES[plane]}: "
            f"the methods differ by {spread[condition, event, plane]:.1f} deg ({values})."
        )
    return found


def _read(
    repeats: list[Repeat], method: Method, rate_hz: float, weights: Float[Array, "sample repeat"]
) -> Float[Array, "sample 2 3"]:
    if method == "per_trial":
        return np.einsum("sr,rek->sek", weights, peaks_of_repeats(repeats))
    together = shift_to_bending if method == "paper" else register_both_peaks
    return peaks_of_mean(together(repeats, rate_hz), weights)
