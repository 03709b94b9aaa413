"""The zero of a force plate: the counts of the empty plate, accepted only if it was empty and still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.sources.stream import PlateInfo
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
    plate: PlateInfo,
    values: Float[Array, "sample channel"],
    host_time_ns: int,
    previous: PlateZero | None = None,
) -> PlateZero:
    """The zero of an empty plate.

    A person who stands still cannot be told from an offset by the mean alone. A zero is refused if the force
    varies as under a person, if it drifts, or if it lies away from the zero before it (for the first one,
    from the calibration's own) by more than `LARGEST_CHANGE_N`.

    Args:
        plate: The plate.
        values: Consecutive samples, as the device sent them.
        host_time_ns: Instant of the last sample [ns].
        previous: The zero that was valid until now.

    Raises:
        InputError: The stretch is too short, or the plate was not empty and still.
    """
    if len(values) < SHORTEST_S * plate.rate_hz:
        raise InputError(
            f"{len(values) / plate.rate_hz:.2f} s of samples are too short for a zero",
            where=f"plate '{plate.name}'",
            hint=f"leave the plate empty for at least {SHORTEST_S:g} s",
        )
    mean = values.mean(axis=0)
    force = (values - mean) @ plate.calibration[FORCE_Z]
    noise = float(force.std())
    half = len(force) // 2
    drift = abs(float(force[:half].mean() - force[half:].mean()))
    if max(noise, drift) > NOISE_FACTOR * plate.noise_n:
        raise _loaded(
            plate.name,
            f"its vertical force varies by {noise:.1f} N and drifts by {drift:.1f} N, "
            f"{NOISE_FACTOR * plate.noise_n:.1f} N are allowed",
        )
    before = np.array(plate.empty) if previous is None else previous.counts
    change = float((mean - before) @ plate.calibration[FORCE_Z]) if len(before) else 0.0
    if abs(change) > LARGEST_CHANGE_N:
        since = "its calibration" if previous is None else "the zero before"
        raise _loaded(plate.name, f"its vertical force differs by {change:+.0f} N from {since}")
    return PlateZero(plate.name, mean, noise, len(values), host_time_ns)


def _loaded(plate: str, why: str) -> InputError:
    return InputError(
        f"the plate is not empty and still: {why}",
        where=f"plate '{plate}'",
        hint="step off, take everything off the plate, wait two seconds and zero again",
    )
