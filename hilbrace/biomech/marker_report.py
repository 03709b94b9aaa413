"""How far the markers are from the model's: which, when, and whether that is acceptable.

The limits are those of OpenSim's checklist for simulations ("Checklist - Evaluating your Simulation", OpenSim
documentation): in a motion, RMS error below 2 cm and no error above 4 cm.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.run.records import write_atomic
from hilbrace.units import MM_PER_M

Array = np.ndarray

RMS_LIMIT_M = 0.02
MAX_LIMIT_M = 0.04
NAMED = 5
"""Most markers and frames that a note names."""
_LOAD_BEARING = ("pelvis", "femur", "tibia", "patella", "talus", "calcn", "toes")


@dataclass(frozen=True)
class MarkerReport:
    """Marker errors of a motion.

    Attributes:
        names: Markers.
        marker_rms: RMS error of each over the frames that show it [m].
        marker_max: Largest error of each [m].
        marker_worst_frame: Frame of the largest error of each.
        frame_rms: RMS error of each frame over its visible markers [m]; NaN where none is.
        frame_max: Largest error of each frame [m].
        frame_worst: Index of the marker with the largest error in each frame.
        rms: RMS over everything [m].
        largest: Largest error [m].
    """

    names: tuple[str, ...]
    marker_rms: Float[Array, " marker"]
    marker_max: Float[Array, " marker"]
    marker_worst_frame: Float[Array, " marker"]
    frame_rms: Float[Array, " frame"]
    frame_max: Float[Array, " frame"]
    frame_worst: Float[Array, " frame"]
    rms: float
    largest: float


def marker_report(names: tuple[str, ...], errors: Float[Array, "frame marker"]) -> MarkerReport:
    """Sum up marker errors by marker and by frame.

    Args:
        names: Markers.
        errors: Distance of each from the model's [m]; NaN in gaps.
    """
    known = np.isfinite(errors)
    squares = np.where(known, errors, 0.0) ** 2
    size = np.where(known, errors, -1.0)

    def root_mean(axis: int | None) -> Array:
        count = known.sum(axis=axis)
        mean = squares.sum(axis=axis) / np.maximum(count, 1)
        return np.where(count > 0, np.sqrt(mean), np.nan)

    return MarkerReport(
        names=names,
        marker_rms=root_mean(0),
        marker_max=np.where(known.any(axis=0), size.max(axis=0), np.nan),
        marker_worst_frame=size.argmax(axis=0).astype(float),
        frame_rms=root_mean(1),
        frame_max=np.where(known.any(axis=1), size.max(axis=1), np.nan),
        frame_worst=size.argmax(axis=1).astype(float),
        rms=float(root_mean(None)),
        largest=float(size.max()),
    )


def load_bearing(
    names: tuple[str, ...], bodies: tuple[str, ...], errors: Float[Array, "frame marker"]
) -> MarkerReport:
    """The report on pelvis and legs alone, on which the loads of knees and ankles stand.

    Args:
        names: Markers.
        bodies: Body that carries each.
        errors: Distance of each from the model's [m]; NaN in gaps.
    """
    kept = [k for k, body in enumerate(bodies) if body.partition("_")[0] in _LOAD_BEARING]
    return marker_report(tuple(names[k] for k in kept), errors[:, kept])


def report_notes(whole: MarkerReport, legs: MarkerReport, time: Float[Array, " frame"]) -> list[str]:
    """Errors against the checklist, worst markers and frames named, one sentence each.

    Args:
        whole: Report on all markers.
        legs: Report on pelvis and legs.
        time: Instants [s].
    """
    return [
        _sentence(label, report, time)
        for label, report in (("all markers", whole), ("markers of pelvis and legs", legs))
        if report.names
    ]


def _sentence(label: str, report: MarkerReport, time: Float[Array, " frame"]) -> str:
    frame = int(np.nanargmax(report.frame_max))
    worst = report.names[int(report.frame_worst[frame])]
    fine = report.rms <= RMS_LIMIT_M and report.largest <= MAX_LIMIT_M
    text = (
        f"{label}: RMS {MM_PER_M * report.rms:.1f} mm, largest {MM_PER_M * report.largest:.1f} mm "
        f"({worst} at {time[frame]:.2f} s); OpenSim's checklist allows 20 and 40 mm"
    )
    if fine:
        return text
    order = np.argsort(-np.nan_to_num(report.marker_max))
    beyond = [k for k in order if report.marker_max[k] > MAX_LIMIT_M]
    frames = int(((report.frame_rms > RMS_LIMIT_M) | (report.frame_max > MAX_LIMIT_M)).sum())
    named = ", ".join(f"{report.names[k]} {MM_PER_M * report.marker_max[k]:.0f} mm" for k in beyond[:NAMED])
    more = f" and {len(beyond) - NAMED} more" if len(beyond) > NAMED else ""
    return f"{text}; beyond it in {frames} of {len(time)} frames: {named or 'RMS alone'}{more}"


def write_marker_errors_csv(
    time: Float[Array, " frame"], names: tuple[str, ...], errors: Float[Array, "frame marker"], path: Path
) -> None:
    """Write the errors as a table that opens anywhere, one row a frame; a gap is an empty cell.

    Columns: ``time_s``, ``rms_mm``, ``max_mm``, ``worst_marker``, then each marker's error in mm. The last
    two rows, ``rms`` and ``max`` instead of a time, sum up each marker.

    Args:
        time: Instants [s].
        names: Markers.
        errors: Distance of each from the model's [m]; NaN in gaps.
        path: File to write, ``.csv``.
    """
    report = marker_report(names, errors)

    def cells(values: Float[Array, " value"]) -> list[str]:
        return ["" if np.isnan(value) else f"{MM_PER_M * value:.2f}" for value in values]

    rows = [["time_s", "rms_mm", "max_mm", "worst_marker", *(f"{name}_mm" for name in names)]]
    for frame, instant in enumerate(time):
        worst = names[int(report.frame_worst[frame])]
        sums = cells(np.array([report.frame_rms[frame], report.frame_max[frame]]))
        rows.append([f"{instant:.6g}", *sums, worst, *cells(errors[frame])])
    sums = cells(np.array([report.rms, report.largest]))
    rows.append(["rms", sums[0], "", "", *cells(report.marker_rms)])
    rows.append(["max", "", sums[1], "", *cells(report.marker_max)])
    write_atomic(path, ("\n".join(",".join(_quoted(c) for c in row) for row in rows) + "\n").encode())


def _quoted(cell: str) -> str:
    return f'"{cell}"' if any(mark in cell for mark in ',"') else cell
