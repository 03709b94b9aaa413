"""The results as files that open anywhere: CSV, JSON and TOML."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from evaluation.comparison import EVENTS, TABLE_PLANES, Comparison
from evaluation.conventions import KNEE_MEANING, PLANES, Convention, in_convention
from evaluation.events import Events
from evaluation.measure import MeasuredStudy, MeasuredTrial
from evaluation.published import published_rows
from evaluation.quality import Quality
from evaluation.results import StudyResult
from hilbrace.run.records import write_atomic

TABLE_COLUMNS = (
    "condition", "event", "plane", "method", "repeats", "angle_deg", "signed_deg", "ci_low_deg",
    "ci_high_deg", "squared_deg2", "squared_low_deg2", "squared_high_deg2", "unbiased_deg2", "sem_deg",
    "mdc_trial_deg", "mdc_mean_deg", "icc_1_1", "icc_2_1", "icc_3_1", "best", "published_deg2",
)  # fmt: skip


def table_cells(result: StudyResult) -> list[dict[str, Any]]:
    """One entry per method, condition, event and plane; the paper's method first."""
    return [
        _cell(result, table, condition, event, plane)
        for table in result.tables.values()
        for condition in range(len(result.measured.study.names))
        for event in range(len(EVENTS))
        for plane in range(len(TABLE_PLANES))
    ]


def table_json(result: StudyResult) -> dict[str, Any]:
    """Everything that the table says, as one object without NaN."""
    measured = result.measured
    settings = measured.study.settings
    return {
        "study": settings.name,
        "synthetic": settings.synthetic,
        "unit": "deg^2",
        "signs": dict(zip(PLANES, KNEE_MEANING["paper"], strict=True)),
        "baseline": settings.baseline,
        "conditions": list(measured.study.names),
        "cells": table_cells(result),
        "frontal_from_standing_deg": {
            name: dict(zip(EVENTS, map(_number, row), strict=True))
            for name, row in zip(measured.study.names, result.from_static_deg, strict=True)
        },
        "trials": trials_json(measured, result.events),
        "warnings": list(result.warnings),
    }


def trials_json(measured: MeasuredStudy, events: tuple[Events, ...] | None) -> list[dict[str, Any]]:
    """Quality, and events where they were looked for, of every trial."""
    rows = []
    for index, trial in enumerate(measured.trials):
        row = {
            "trial": trial.name,
            "condition": measured.study.names[trial.condition],
            "frames": len(trial.motion.time),
            "rate_hz": trial.motion.rate_hz,
        } | quality_json(trial.quality)
        if events is not None:
            found = events[index]
            row["events"] = {
                "bending_s": _number(found.bending_s),
                "touchdown_s": _number(found.touchdown_s),
                "landing_s": _number(found.landing_s),
                "found_by": found.found_by,
            }
        row["notes"] = list(trial.notes)
        rows.append(row)
    return rows


def quality_json(quality: Quality) -> dict[str, Any]:
    """Figures of one trial."""
    return {
        "residual_mm": {name: _number(value) for name, value in quality.residual_mm.items()},
        "worst_residual_mm": {name: _number(value) for name, value in quality.worst_residual_mm.items()},
        "knee_gap_mm": _number(quality.knee_gap_mm),
        "known_frames": _number(quality.known),
        "filled_by_cluster": quality.filled_by_cluster,
        "filled_by_spline": quality.filled_by_spline,
        "frontal_flexion_correlation": _number(quality.frontal_flexion_correlation),
        "flags": list(quality.flags),
    }


def write_table_csv(path: Path, result: StudyResult) -> None:
    """Write the cells, one a row; a value that does not exist is empty."""
    rows = [["" if cell[key] is None else cell[key] for key in TABLE_COLUMNS] for cell in table_cells(result)]
    write_atomic(path, _csv([list(TABLE_COLUMNS), *rows]))


def write_angles_csv(path: Path, trial: MeasuredTrial, side: str, convention: Convention) -> None:
    """Write the angles of one trial over time; gaps are empty.

    Args:
        path: File to write.
        trial: The tracked trial.
        side: Which leg.
        convention: Signs of the knee angles; ankle angles are dorsiflexion, inversion, internal rotation.
    """
    motion = trial.motion
    knee = in_convention(motion.knee_deg, "left" if side == "left" else "right", convention)
    header = ["time_s", *(f"knee_{plane}_deg" for plane in PLANES)]
    columns = [motion.time, *knee.T]
    if np.isfinite(motion.ankle_deg).any():
        header += ["ankle_dorsiflexion_deg", "ankle_inversion_deg", "ankle_internal_rotation_deg"]
        columns += [*motion.ankle_deg.T]
    header += ["thigh_residual_mm", "shank_residual_mm", "knee_gap_mm"]
    columns += [*motion.residual_mm[:, :2].T, motion.knee_gap_mm]
    rows = [["" if value != value else f"{value:.6g}" for value in row] for row in np.column_stack(columns)]
    write_atomic(path, _csv([header, *rows]))


def write_events_toml(path: Path, result: StudyResult) -> None:
    """Write the events in the form in which the study file takes them, for correction by hand."""
    content: dict[str, dict[str, float]] = {}
    for file, found in zip(result.measured.study.trials, result.events, strict=True):
        values = {
            "bending_s": found.bending_s,
            "touchdown_s": found.touchdown_s,
            "landing_s": found.landing_s,
        }
        content[file.key or file.path.name] = {
            key: round(value, 4) for key, value in values.items() if math.isfinite(value)
        }
    write_atomic(path, tomli_w.dumps({"events": content}).encode())


def _cell(result: StudyResult, table: Comparison, condition: int, event: int, plane: int) -> dict[str, Any]:
    settings = result.measured.study.settings.conditions[condition]
    reliability = result.reliability[event * len(TABLE_PLANES) + plane]
    icc = reliability.correlation
    published = published_rows()[settings.published] if settings.published else None
    at = (condition, event, plane)
    values: tuple[Any, ...] = (
        settings.name, EVENTS[event], TABLE_PLANES[plane], table.method,
        int(table.repeats[condition]),
        _number(table.angle_deg[at]), _number(table.signed_deg[at]), _number(table.low_deg[at]),
        _number(table.high_deg[at]), _number(table.squared[at]), _number(table.squared_low[at]),
        _number(table.squared_high[at]), _number(table.unbiased[at]), _number(reliability.error_deg),
        _number(reliability.change_trial_deg), _number(reliability.change_mean_deg),
        *((None,) * 3 if icc is None else map(_number, (icc.one_way, icc.two_way, icc.fixed))),
        bool(table.best[event, plane] == condition),
        None if published is None else float(published.squared[event, plane]),
    )  # fmt: skip
    return dict(zip(TABLE_COLUMNS, values, strict=True))


def _number(value: Any) -> float | None:
    """A float for JSON; none for what does not exist."""
    number = float(value)
    return round(number, 9) if math.isfinite(number) else None


def _csv(rows: list[list[Any]]) -> bytes:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue().encode()
