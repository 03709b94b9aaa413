"""Zero-lag low-pass filtering of recorded signals, gap by gap."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, sosfiltfilt

from hilbrace.errors import InputError

Array = np.ndarray

PASSES = 2
"""Forward and backward."""


def lowpass(
    values: Float[Array, "sample ..."], rate_hz: float, cutoff_hz: float
) -> Float[Array, "sample ..."]:
    """Filter along the first axis with a fourth-order Butterworth filter without lag.

    A second-order filter runs forward and backward. Each pass attenuates, so its own cut-off is raised to
    ``cutoff / (2^(1/2) - 1)^(1/4)`` (in the pre-warped frequency); the gain of both passes together is then
    1/sqrt(2) at ``cutoff_hz`` (Winter 2009, Biomechanics and Motor Control of Human Movement, sec. 3.4.4.2).

    Gaps are never bridged: a NaN ends a run, every run between gaps is filtered by itself and mirrored
    oddly at its ends. A run of at most 3 samples, or of a third of a cut-off period, is shorter than the
    filter's transient and passes unfiltered.

    Args:
        values: Samples, NaN in gaps.
        rate_hz: Samples per second [Hz].
        cutoff_hz: Frequency at which the amplitude falls to 0.707 [Hz]; at or above 0.4 of the rate the
            signal passes unfiltered, since the double-pass correction would exceed what the rate can show.

    Raises:
        InputError: Rate or cut-off is not positive.
    """
    if not (rate_hz > 0 and cutoff_hz > 0):
        raise InputError(
            f"cannot filter at {cutoff_hz:g} Hz a signal of {rate_hz:g} Hz",
            where="low-pass filter",
            hint="give a positive rate and cut-off",
        )
    if cutoff_hz >= 0.4 * rate_hz:
        return np.array(values, float)
    sections = _sections(rate_hz, cutoff_hz)
    flat = np.array(values, float).reshape(len(values), -1)
    shortest = max(3, round(rate_hz / (3 * cutoff_hz)))
    padding = round(3 * rate_hz / cutoff_hz)
    whole = np.asarray(np.isfinite(flat).all(axis=0))
    runs = [(slice(0, len(flat)), np.flatnonzero(whole))]
    runs += [(run, np.array([k])) for k in np.flatnonzero(~whole) for run in gap_free_runs(flat[:, k])]
    for run, columns in runs:
        if run.stop - run.start > shortest and len(columns):
            flat[run, columns] = _both_ways(flat[run, columns], sections, padding)
    return flat.reshape(np.shape(values))


def _both_ways(
    values: Float[Array, "sample column"], sections: Float[Array, "section 6"], padding: int
) -> Float[Array, "sample column"]:
    """Filter forward and backward what lies above the straight line between the run's ends.

    The rest starts and ends at zero, so that the filter starts at rest; a straight line passes unchanged.
    """
    line = np.linspace(values[0], values[-1], len(values))
    return line + sosfiltfilt(sections, values - line, axis=0, padlen=min(padding, len(values) - 1))


def gap_free_runs(values: Float[Array, " sample"]) -> list[slice]:
    """The stretches between NaNs, in order."""
    known = np.concatenate(([False], np.isfinite(values), [False])).astype(np.int8)
    edges = np.flatnonzero(np.diff(known))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _sections(rate_hz: float, cutoff_hz: float) -> Float[Array, "section 6"]:
    """The single pass whose repetition has the wanted cut-off (bilinear transform, pre-warped)."""
    correction = (2 ** (1 / PASSES) - 1) ** 0.25
    warped = np.tan(np.pi * cutoff_hz / rate_hz) / correction
    return np.asarray(butter(2, 2 / np.pi * np.arctan(warped), output="sos"))
