"""When the knee bends deepest before the jump, when the foot touches down, and when it bends after landing.

Positive flexion is used here; a peak must stand out from its surroundings by its prominence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.signal import find_peaks

from evaluation.conventions import SAGITTAL
from evaluation.tracking import LimbMotion
from hilbrace.errors import InputError
from hilbrace.motion.filters import gap_free_runs, lowpass
from hilbrace.motion.force_plates import PlateForces, total_vertical
from hilbrace.units import GRAVITY

Array = np.ndarray

PROMINENCE_DEG = 15.0
"""How far a flexion peak stands out."""

APART_SECONDS = 0.25
"""Shortest time between two flexion peaks."""

UNLOADED_N = 20.0
"""Vertical force below which nobody stands on the plates."""

SHORTEST_FLIGHT_S, LONGEST_FLIGHT_S = 0.08, 1.2

BALLISTIC = 0.6
"""Share of gravity with which the hip falls while nothing carries it."""

_HIP_CUTOFF_HZ = 10.0


@dataclass(frozen=True)
class Events:
    """Three instants of a trial.

    Attributes:
        bending_s: Deepest flexion before the jump [s].
        touchdown_s: First contact after the flight [s]; NaN where no flight was seen.
        landing_s: Deepest flexion after landing [s].
        found_by: ``plates``, ``markers``, ``order`` (first two peaks) or ``hand``.
    """

    bending_s: float
    touchdown_s: float
    landing_s: float
    found_by: str


def find_events(motion: LimbMotion, plates: PlateForces | None, where: str) -> Events:
    """Find the events of a trial.

    The flight is the longest stretch in which the plates carry nothing, between two in which they do;
    without it, the stretch in which the hip falls freely. The bending peak is the deepest before take-off,
    the landing peak the first after touch-down. Without a flight they are the first two peaks.

    Args:
        motion: The tracked trial.
        plates: Loads on the force plates, y up.
        where: The file, for messages.

    Raises:
        InputError: There are no two flexion peaks, or none before or after the flight.
    """
    flexion = -motion.knee_deg[:, SAGITTAL]
    peaks = flexion_peaks(flexion, motion.rate_hz)
    times = motion.time[peaks]
    flight, found_by = _flight(motion, plates)
    if flight is None:
        if len(peaks) < 2:
            raise _no_events(f"{len(peaks)} flexion peaks of {PROMINENCE_DEG:g} deg, two are needed", where)
        return Events(float(times[0]), float("nan"), float(times[1]), "order")
    before, after = peaks[times <= flight[0]], peaks[times > flight[1]]
    if not len(before) or not len(after):
        side = "before take-off" if not len(before) else "after touch-down"
        raise _no_events(f"no flexion peak {side} ({flight[0]:.2f} to {flight[1]:.2f} s)", where)
    bending = before[np.argmax(flexion[before])]
    return Events(float(motion.time[bending]), flight[1], float(motion.time[after[0]]), found_by)


def flexion_peaks(flexion_deg: Float[Array, " frame"], rate_hz: float) -> Int[Array, " peak"]:
    """Frames of the flexion peaks that stand out, in order.

    Gaps are bridged by straight lines, so a peak that a gap cuts off is found at the gap's edge; whoever
    reads an angle there has to look for the gap (`evaluation.synchronize.has_gap_at_peak`).

    Args:
        flexion_deg: Knee flexion, positive [deg].
        rate_hz: Frames per second [Hz].
    """
    known = np.isfinite(flexion_deg)
    if not known.any():
        return np.zeros(0, int)
    filled = np.interp(np.arange(len(flexion_deg)), np.flatnonzero(known), flexion_deg[known])
    apart = max(1, round(APART_SECONDS * rate_hz))
    peaks, _ = find_peaks(filled, prominence=PROMINENCE_DEG, distance=apart)
    return peaks


def flight_from_plates(plates: PlateForces) -> tuple[float, float] | None:
    """Take-off and touch-down [s] by the plates: the longest unloaded stretch between two loaded ones."""
    loaded = total_vertical(plates) >= UNLOADED_N
    return _longest(~loaded, plates.time)


def flight_from_hip(height_m: Float[Array, " frame"], rate_hz: float) -> tuple[float, float] | None:
    """Take-off and touch-down [s] by the hip, which falls freely in between.

    Args:
        height_m: Height of the hip joint centre [m].
        rate_hz: Frames per second [Hz].
    """
    smooth = lowpass(height_m, rate_hz, _HIP_CUTOFF_HZ)
    fall = -np.gradient(np.gradient(smooth, 1 / rate_hz), 1 / rate_hz)
    return _longest(fall > BALLISTIC * GRAVITY, np.arange(len(height_m)) / rate_hz)


def _flight(motion: LimbMotion, plates: PlateForces | None) -> tuple[tuple[float, float] | None, str]:
    if plates is not None:
        flight = flight_from_plates(plates)
        if flight is not None:
            return flight, "plates"
    flight = flight_from_hip(motion.hip[:, 1], motion.rate_hz)
    if flight is not None:
        start = float(motion.time[0])
        return (flight[0] + start, flight[1] + start), "markers"
    return None, "order"


def _longest(free: Bool[Array, " sample"], time: Float[Array, " sample"]) -> tuple[float, float] | None:
    """Ends of the longest run that is not cut by the recording and has a flight's length."""
    runs = [
        run
        for run in gap_free_runs(np.where(free, 1.0, np.nan))
        if run.start > 0
        and run.stop < len(time)
        and SHORTEST_FLIGHT_S <= time[run.stop] - time[run.start] <= LONGEST_FLIGHT_S
    ]
    if not runs:
        return None
    best = max(runs, key=lambda run: run.stop - run.start)
    return float(time[best.start]), float(time[best.stop])


def _no_events(what: str, where: str) -> InputError:
    return InputError(
        what, where=where, hint="give bending_s and landing_s of this trial under [events] in the study file"
    )
