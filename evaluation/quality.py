"""What the markers say about their own trial: refuse what cannot be angles, flag what may mislead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.calibration import LimbCalibration
from evaluation.conventions import FRONTAL, SAGITTAL, TRANSVERSE
from evaluation.tracking import LimbMotion
from hilbrace.errors import InputError

Array = np.ndarray

REFUSED_RESIDUAL_MM, FLAGGED_RESIDUAL_MM = 15.0, 8.0
"""Median misfit of a cluster: two recordings with other marker places reach 20 mm, skin 2 to 5 mm."""

REFUSED_KNEE_GAP_MM, FLAGGED_KNEE_GAP_MM = 80.0, 30.0
"""Median distance of the two knee centres; about 10 mm in walking."""

FLAGGED_STATIC_DEG = 2.0
"""Difference between standing trials that says that a cluster or a landmark moved."""

PLAUSIBLE_DEG = {SAGITTAL: (-160.0, 20.0), FRONTAL: (-20.0, 20.0), TRANSVERSE: (-40.0, 40.0)}
"""Range of a knee's anatomical angles (extension, adduction, internal rotation)."""

IMPOSSIBLE_EXTENSION_DEG = 40.0
"""No knee extends this far."""

_NAMES = {SAGITTAL: "extension", FRONTAL: "adduction", TRANSVERSE: "internal rotation"}


@dataclass(frozen=True)
class Quality:
    """Figures of one trial, and sentences about those that are out of line.

    Attributes:
        residual_mm: Median misfit of each cluster [mm].
        worst_residual_mm: 95th percentile of the misfit of each cluster [mm].
        knee_gap_mm: Median distance of the two knee centres [mm].
        known: Share of frames with knee angles.
        filled_by_cluster: Samples that a cluster's other markers filled.
        filled_by_spline: Samples that neighbouring frames filled.
        frontal_flexion_correlation: Correlation of frontal angle and flexion beyond 20 degrees of flexion;
            near +-1 it is cross-talk of a wrong flexion axis. NaN where the knee hardly bends.
        flags: What is out of line, one sentence each.
    """

    residual_mm: dict[str, float]
    worst_residual_mm: dict[str, float]
    knee_gap_mm: float
    known: float
    filled_by_cluster: int
    filled_by_spline: int
    frontal_flexion_correlation: float
    flags: tuple[str, ...]


def judge(motion: LimbMotion, calibration: LimbCalibration, where: str) -> Quality:
    """Figures and flags of a trial.

    Args:
        motion: The tracked trial.
        calibration: The standing leg it was tracked with.
        where: The file, for messages.

    Raises:
        InputError: The cluster has another shape than while standing, the knee comes apart or bends
            backwards, or no frame has angles.
    """
    names = [segment.name for segment in calibration.segments]
    known = np.asarray(np.isfinite(motion.knee_deg).all(axis=1))
    if not known.any():
        raise InputError(
            "no frame shows three markers of both clusters",
            where=where,
            hint="label the trajectories, or fill them in the recording software",
        )
    residual = {name: _median(motion.residual_mm[:, k]) for k, name in enumerate(names)}
    worst = {
        name: float(np.nanpercentile(motion.residual_mm[:, k], 95))
        for k, name in enumerate(names)
        if np.isfinite(residual[name])
    }
    gap = _median(motion.knee_gap_mm)
    _refuse(residual, gap, calibration.source, where)
    _refuse_bent_backwards(motion, where)
    correlation = cross_talk_correlation(motion.knee_deg)
    flags = [
        *_cluster_flags(residual, worst),
        *(f"The {name} never shows three markers at once." for name in names if name not in worst),
        *_knee_flags(gap, correlation, motion),
        *([f"{(~known).sum()} of {len(known)} frames have no angles."] if not known.all() else []),
    ]
    return Quality(
        residual, worst, gap, float(known.mean()), motion.filled_by_cluster, motion.filled_by_spline,
        correlation, tuple(flags),
    )  # fmt: skip


def cross_talk_correlation(knee_deg: Float[Array, "frame 3"]) -> float:
    """Correlation of adduction with flexion beyond 20 degrees of flexion; NaN where the knee hardly bends."""
    bent = np.isfinite(knee_deg).all(axis=1) & (knee_deg[:, SAGITTAL] < -20.0)
    if bent.sum() < 10 or np.ptp(knee_deg[bent, SAGITTAL]) < 20.0 or np.ptp(knee_deg[bent, FRONTAL]) == 0:
        return float("nan")
    return float(np.corrcoef(-knee_deg[bent, SAGITTAL], knee_deg[bent, FRONTAL])[0, 1])


def compare_standing(first: LimbCalibration, other: LimbCalibration) -> tuple[str, ...]:
    """Sentences about knee angles that differ between two standing trials of one leg."""
    change = np.abs(other.knee_deg - first.knee_deg)
    return tuple(
        f"Standing, {_NAMES[plane]} differs by {change[plane]:.1f} deg from {first.source}: "
        "a cluster or a landmark has moved."
        for plane in range(3)
        if change[plane] > FLAGGED_STATIC_DEG
    )


def _median(values: Float[Array, " frame"]) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")


def _refuse(residual: dict[str, float], gap: float, standing: str, where: str) -> None:
    for name, misfit in residual.items():
        if misfit > REFUSED_RESIDUAL_MM:
            raise InputError(
                f"the {name} cluster does not have its standing shape: residual {misfit:.1f} mm, "
                f"at most {REFUSED_RESIDUAL_MM:g} mm",
                where=where,
                hint=f"its markers were moved or exchanged since {standing}: record another standing trial",
            )
    if gap > REFUSED_KNEE_GAP_MM:
        raise InputError(
            f"thigh and shank carry the knee to places {gap:.0f} mm apart",
            where=where,
            hint=f"a cluster was moved as a whole since {standing}: record another standing trial",
        )


def _refuse_bent_backwards(motion: LimbMotion, where: str) -> None:
    """Refuse a knee that extends as far as knees only bend: left and right, or in and out, are exchanged."""
    extension = motion.knee_deg[:, SAGITTAL]
    if np.nanmax(extension) > IMPOSSIBLE_EXTENSION_DEG > -np.nanmin(extension):
        raise InputError(
            f"the knee extends by {np.nanmax(extension):.0f} deg and hardly bends",
            where=where,
            hint="correct protocol.side, or the medial and lateral labels under [protocol.markers]",
        )


def _cluster_flags(residual: dict[str, float], worst: dict[str, float]) -> list[str]:
    return [
        f"The {name} cluster deforms: residual {residual[name]:.1f} mm (95 % below {worst[name]:.1f} mm)."
        for name in residual
        if residual[name] > FLAGGED_RESIDUAL_MM or worst.get(name, 0.0) > REFUSED_RESIDUAL_MM
    ]


def _knee_flags(gap: float, correlation: float, motion: LimbMotion) -> list[str]:
    flags = []
    if gap > FLAGGED_KNEE_GAP_MM:
        flags.append(f"Thigh and shank carry the knee to places {gap:.0f} mm apart.")
    for plane, (low, high) in PLAUSIBLE_DEG.items():
        angle = motion.knee_deg[:, plane]
        if np.nanmin(angle) < low or np.nanmax(angle) > high:
            flags.append(
                f"Implausible {_NAMES[plane]}: {np.nanmin(angle):.0f} to {np.nanmax(angle):.0f} deg."
            )
    frontal = motion.knee_deg[:, FRONTAL]
    if abs(correlation) > 0.8 and np.nanmax(frontal) - np.nanmin(frontal) > 8.0:
        flags.append(
            f"The frontal angle follows flexion (r = {correlation:.2f}): "
            "probably cross-talk of a misplaced knee axis."
        )
    return flags
