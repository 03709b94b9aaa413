"""Repeats of one movement on a common clock.

Three ways to one value per event: read it off the mean of curves that are shifted so that their bending
peaks coincide (the paper's way, which smears the landing peak where the repeats differ in pace), off the mean
of curves whose two peaks both coincide, or off every repeat by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.conventions import SAGITTAL
from hilbrace.errors import InputError

Array = np.ndarray

PAPER_WINDOW_S = 0.15
"""How far from the mean landing time the landing peak of a mean curve may lie."""


NEAR_PEAK_S = 0.05
"""A gap this close to a peak leaves its angle unknown."""


@dataclass(frozen=True)
class Repeat:
    """One trial, as far as the table needs it.

    Attributes:
        name: The trial's name.
        time: Instants [s].
        angles_deg: Knee angles [deg]; NaN in gaps.
        bending_s: Time of the bending peak [s].
        landing_s: Time of the landing peak [s].
    """

    name: str
    time: Float[Array, " frame"]
    angles_deg: Float[Array, "frame 3"]
    bending_s: float
    landing_s: float


@dataclass(frozen=True)
class Ensemble:
    """Repeats of one condition on a common clock.

    Attributes:
        time: Time from the bending peak [s].
        curves: Every repeat [deg]; NaN where a repeat has no angles.
        landing_s: Mean time of the landing peak, from the bending peak [s].
    """

    time: Float[Array, " frame"]
    curves: Float[Array, "repeat frame 3"]
    landing_s: float

    @property
    def mean(self) -> Float[Array, "frame 3"]:
        """Mean curve; NaN where a repeat is missing, since a mean of fewer would jump."""
        return self.curves.mean(axis=0)

    @property
    def spread(self) -> Float[Array, "frame 3"]:
        """Standard deviation between repeats."""
        if len(self.curves) < 2:
            return np.full(self.curves.shape[1:], np.nan)
        return self.curves.std(axis=0, ddof=1)


def shift_to_bending(repeats: list[Repeat], rate_hz: float) -> Ensemble:
    """Shift every repeat so that its bending peak is at time zero; keep what all repeats cover.

    Args:
        repeats: Repeats of one condition.
        rate_hz: Frames per second of the common clock [Hz].

    Raises:
        InputError: The repeats do not overlap.
    """
    landing = float(np.mean([r.landing_s - r.bending_s for r in repeats]))
    first = max(r.time[0] - r.bending_s for r in repeats)
    last = min(r.time[-1] - r.bending_s for r in repeats)
    clock = _clock(first, last, rate_hz, repeats)
    curves = np.stack([_sample(r, clock + r.bending_s) for r in repeats])
    return Ensemble(clock, curves, landing)


def register_both_peaks(repeats: list[Repeat], rate_hz: float) -> Ensemble:
    """Shift and stretch every repeat so that both of its peaks fall on the mean times of all.

    The time between the peaks is stretched evenly; before and after it runs as recorded.

    Args:
        repeats: Repeats of one condition.
        rate_hz: Frames per second of the common clock [Hz].

    Raises:
        InputError: The repeats do not overlap, or a landing peak comes before its bending peak.
    """
    landing = float(np.mean([r.landing_s - r.bending_s for r in repeats]))
    first = max(r.time[0] - r.bending_s for r in repeats)
    last = min(r.time[-1] - r.landing_s for r in repeats) + landing
    clock = _clock(first, last, rate_hz, repeats)
    return Ensemble(clock, np.stack([_sample(r, _own_time(r, clock, landing)) for r in repeats]), landing)


def has_gap_at_peak(repeat: Repeat) -> bool:
    """Whether angles are missing within 0.05 s of one of the repeat's peaks."""
    near = np.minimum(np.abs(repeat.time - repeat.bending_s), np.abs(repeat.time - repeat.landing_s))
    return bool(np.isnan(repeat.angles_deg[near <= NEAR_PEAK_S]).any())


def peaks_of_mean(ensemble: Ensemble, weights: Float[Array, "sample repeat"]) -> Float[Array, "sample 2 3"]:
    """Angles at the bending and the landing peak of weighted mean curves [deg].

    Both planes are read at the instant of the sagittal peak.

    Args:
        ensemble: Repeats on a common clock.
        weights: Share of each repeat in each mean curve; rows sum to one.

    Returns:
        For each row of weights: bending, landing; in each the angles.

    Raises:
        InputError: An event lies outside what all repeats cover.
    """
    found = []
    for centre in (0.0, ensemble.landing_s):
        window = np.flatnonzero(np.abs(ensemble.time - centre) <= PAPER_WINDOW_S)
        window = window[np.isfinite(ensemble.curves[:, window]).all(axis=(0, 2))]
        if not len(window):
            raise InputError(
                f"no instant within {PAPER_WINDOW_S:g} s of the peak at {centre:.2f} s is in all repeats",
                where="mean curve",
                hint="leave out the repeats that are cut short or have gaps there",
            )
        means = np.einsum("sr,rfk->sfk", weights, ensemble.curves[:, window])
        deepest = means[:, :, SAGITTAL].argmin(axis=1)
        found.append(means[np.arange(len(weights)), deepest])
    return np.stack(found, axis=1)


def peaks_of_repeats(repeats: list[Repeat]) -> Float[Array, "repeat 2 3"]:
    """Angles of every repeat at its own bending and landing peak [deg]."""
    return np.stack(
        [np.concatenate([_sample(r, np.array([at])) for at in (r.bending_s, r.landing_s)]) for r in repeats]
    )


def _clock(first: float, last: float, rate_hz: float, repeats: list[Repeat]) -> Float[Array, " frame"]:
    """Instants in whole frames from the bending peak, so that a peak is on one of them."""
    start, stop = int(np.ceil(first * rate_hz - 1e-6)), int(np.floor(last * rate_hz + 1e-6))
    if start > 0 or stop <= start or stop < 1:
        raise InputError(
            "the repeats have no common time around their peaks",
            where=", ".join(r.name for r in repeats),
            hint="check the events of these trials, or leave out the one that is cut short",
        )
    return np.arange(start, stop + 1) / rate_hz


def _own_time(repeat: Repeat, clock: Float[Array, " frame"], landing_s: float) -> Float[Array, " frame"]:
    """Where each instant of the common clock lies in the repeat."""
    own = repeat.landing_s - repeat.bending_s
    if own <= 0:
        raise InputError(
            "the landing peak comes before the bending peak",
            where=repeat.name,
            hint="correct bending_s and landing_s of this trial",
        )
    between = clock * own / landing_s
    after = clock - landing_s + own
    return repeat.bending_s + np.where(clock < 0, clock, np.where(clock <= landing_s, between, after))


def _sample(repeat: Repeat, at: Float[Array, " frame"]) -> Float[Array, "frame 3"]:
    """Angles between frames; NaN wherever a neighbouring frame is a gap."""
    columns = [np.interp(at, repeat.time, column) for column in repeat.angles_deg.T]
    return np.column_stack(columns)
