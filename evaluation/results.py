"""From measured trials to the table: events, three methods, reliability, warnings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.comparison import (
    EVENTS,
    METHODS,
    TABLE_PLANES,
    Comparison,
    compare,
    disagreements,
    estimate,
)
from evaluation.conventions import FRONTAL, SAGITTAL, in_convention
from evaluation.events import Events
from evaluation.measure import MeasuredStudy, events_of
from evaluation.reliability import (
    IntraclassCorrelation,
    detectable_change,
    intraclass_correlation,
    standard_error_of_measurement,
)
from evaluation.synchronize import (
    NEAR_PEAK_S,
    Ensemble,
    Repeat,
    has_gap_at_peak,
    peaks_of_repeats,
    register_both_peaks,
    shift_to_bending,
)
from hilbrace.errors import InputError

Array = np.ndarray

FEW_REPEATS = 3


@dataclass(frozen=True)
class Reliability:
    """How repeatable one column of the table is, from the peaks of single trials.

    Attributes:
        correlation: Intraclass correlations; ``None`` without two conditions of two repeats.
        error_deg: Standard error of measurement of a single trial [deg].
        change_trial_deg: Detectable change between two trials at 95 % [deg].
        change_mean_deg: Detectable change between two means of as many repeats as the study has [deg].
    """

    correlation: IntraclassCorrelation | None
    error_deg: float
    change_trial_deg: float
    change_mean_deg: float


@dataclass(frozen=True)
class StudyResult:
    """Everything that the table and the report show.

    Attributes:
        measured: The tracked trials.
        events: Events of every trial, in the order of the trials.
        tables: Comparison by method; the paper's first.
        reliability: One per event and plane: bending sagittal, bending frontal, landing sagittal, ...
        ensembles: Repeats of every condition, shifted to the bending peak.
        registered: The same with both peaks brought together.
        from_static_deg: Frontal angle at the events less the standing one [deg].
        warnings: What a reader must know, one sentence each.
    """

    measured: MeasuredStudy
    events: tuple[Events, ...]
    tables: dict[str, Comparison]
    reliability: tuple[Reliability, ...]
    ensembles: tuple[Ensemble, ...]
    registered: tuple[Ensemble, ...]
    from_static_deg: Float[Array, "condition event"]
    warnings: tuple[str, ...]


def evaluate(measured: MeasuredStudy, seed: int = 0) -> StudyResult:
    """Compare the conditions of a study.

    Args:
        measured: The tracked trials.
        seed: Seed of the bootstrap.

    Raises:
        InputError: Events cannot be found, or a gap lies at a peak.
    """
    study = measured.study
    events = tuple(events_of(trial) for trial in measured.trials)
    conditions, left_out = _usable(group_repeats(measured, events), study.names)
    rate = max(trial.motion.rate_hz for trial in measured.trials)
    tables = {
        method: compare(estimate(conditions, method, rate, seed), study.baseline, method)
        for method in METHODS
    }
    peaks = [peaks_of_repeats(repeats)[:, :, [SAGITTAL, FRONTAL]] for repeats in conditions]
    reliability = tuple(
        _reliability([group[:, event, plane] for group in peaks])
        for event in range(len(EVENTS))
        for plane in range(len(TABLE_PLANES))
    )
    standing = in_convention(measured.calibration.knee_deg, measured.calibration.side, "paper")[FRONTAL]
    return StudyResult(
        measured=measured,
        events=events,
        tables=tables,
        reliability=reliability,
        ensembles=tuple(shift_to_bending(repeats, rate) for repeats in conditions),
        registered=tuple(register_both_peaks(repeats, rate) for repeats in conditions),
        from_static_deg=tables["per_trial"].angle_deg[:, :, FRONTAL] - standing,
        warnings=(
            *measured.notes,
            *left_out,
            *_warnings(measured, events, conditions),
            *disagreements(tables, study.names),
        ),
    )


def group_repeats(measured: MeasuredStudy, events: tuple[Events, ...]) -> list[list[Repeat]]:
    """Repeats of every condition, with the paper's signs (extension and adduction positive).

    Args:
        measured: The tracked trials.
        events: Events of every trial.
    """
    side = measured.calibration.side
    groups: list[list[Repeat]] = [[] for _ in measured.study.names]
    for trial, found in zip(measured.trials, events, strict=True):
        angles = in_convention(trial.motion.knee_deg, side, "paper")
        groups[trial.condition].append(
            Repeat(trial.name, trial.motion.time, angles, found.bending_s, found.landing_s)
        )
    return groups


def _usable(conditions: list[list[Repeat]], names: tuple[str, ...]) -> tuple[list[list[Repeat]], list[str]]:
    """Repeats whose angles are known at both peaks, and sentences about the others."""
    left_out = [
        f"{repeat.name} is left out: it has a gap within {NEAR_PEAK_S:g} s of a peak."
        for repeats in conditions
        for repeat in repeats
        if has_gap_at_peak(repeat)
    ]
    usable = [[r for r in repeats if not has_gap_at_peak(r)] for repeats in conditions]
    for name, repeats in zip(names, usable, strict=True):
        if not repeats:
            raise InputError(
                "no repeat shows both peaks",
                where=f"condition '{name}'",
                hint="fill the gaps at the peaks in the recording software, or record again",
            )
    return usable, left_out


def _reliability(groups: list[Float[Array, " _"]]) -> Reliability:
    error = standard_error_of_measurement(groups)
    repeats = min(len(group) for group in groups)
    correlation = None
    if len(groups) > 1 and repeats > 1:
        correlation = intraclass_correlation(np.stack([group[:repeats] for group in groups]))
    return Reliability(correlation, error, detectable_change(error, 1), detectable_change(error, repeats))


def _warnings(
    measured: MeasuredStudy, events: tuple[Events, ...], conditions: list[list[Repeat]]
) -> list[str]:
    found = []
    for name, repeats in zip(measured.study.names, conditions, strict=True):
        if len(repeats) < 2:
            found.append(f"{name}: a single trial has no confidence interval.")
        elif len(repeats) < FEW_REPEATS:
            found.append(f"{name}: {len(repeats)} repeats give very wide intervals.")
    by_order = [t.name for t, e in zip(measured.trials, events, strict=True) if e.found_by == "order"]
    if by_order:
        found.append(
            f"No flight was seen in {', '.join(by_order)}: the first two flexion peaks are taken as bending "
            "and landing."
        )
    found.append(
        "All repeats are of one person: intervals speak of this person on this day, not of other people."
    )
    return found
