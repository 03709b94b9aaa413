"""The zero of a force plate: the counts of the empty plate, accepted only if it was empty and still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.plate_calibration import PlateCalibration
from hilbrace.errors import InputError

Array = np.ndarray

SHORTEST_S = 1.0
"""Least time without load [s]."""

NOISE_FACTOR = 3.0
"""A vertical force that varies more than this many times the plate's noise is no empty plate's."""

LARGEST_CHANGE_N = 20.0
"""Largest vertical force by which a zero may differ from the one before [N]."""

FORCE_Z = 2


@dataclass(frozen=True)
class PlateZero:
    """The counts of an empty plate. It stays valid when the line breaks and comes back.

    Attributes:
        plate: The plate's name.
        counts: Mean of every channel [count].
        noise_n: Standard deviation of the vertical force meanwhile [N].
        samples: Number of samples.
        host_time_ns: When it was taken [ns].
    """

    plate: str
    counts: Float[Array, " channel"]
    noise_n: float
    samples: int
    host_time_ns: int


def measure_zero(
    plate: str,
    values: Float[Array, "sample channel"],
    rate_hz: float,
    calibration: PlateCalibration,
    host_time_ns: int,
    previous: PlateZero | None = None,
) -> PlateZero:
    """The zero of an empty plate.

    A person who stands still cannot be told from an offset by the mean alone. A zero is refused if the force
    varies as under a person, if it drifts, or if it lies away from the zero before it (for the first one,
    from the calibration's own) by more than `LARGEST_CHANGE_N`.

    Args:
        plate: The plate's name.
        values: Consecutive samples [count].
        rate_hz: Samples per second [Hz].
        calibration: The plate's calibration.
        host_time_ns: Instant of the last sample [ns].
        previous: The zero that was valid until now.

    Raises:
        InputError: The stretch is too short, or the plate was not empty and still.
    """
    if len(values) < SHORTEST_S * rate_hz:
        raise InputError(
            f"{len(values) / rate_hz:.2f} s of samples are too short for a zero",
            where=f"plate '{plate}'",
            hint=f"leave the plate empty for at least {SHORTEST_S:g} s",
        )
    mean = values.mean(axis=0)
    force = (values - mean) @ calibration.matrix[FORCE_Z]
    noise = float(force.std())
    half = len(force) // 2
    drift = abs(float(force[:half].mean() - force[half:].mean()))
    if max(noise, drift) > NOISE_FACTOR * calibration.noise_n:
        raise _loaded(
            plate,
            f"its vertical force varies by {noise:.1f} N and drifts by {drift:.1f} N, "
            f"{NOISE_FACTOR * calibration.noise_n:.1f} N are allowed",
        )
    before = calibration.empty if previous is None else previous.counts
    change = float((mean - before) @ calibration.matrix[FORCE_Z])
    if np.isfinite(change) and abs(change) > LARGEST_CHANGE_N:
        since = "its calibration" if previous is None else "the zero before"
        raise _loaded(plate, f"its vertical force differs by {change:+.0f} N from {since}")
    return PlateZero(plate, mean, noise, len(values), host_time_ns)


def _loaded(plate: str, why: str) -> InputError:
    return InputError(
        f"the plate is not empty and still: {why}",
        where=f"plate '{plate}'",
        hint="step off, take everything off the plate, wait two seconds and zero again",
    )
