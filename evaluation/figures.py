"""The laboratory report's pictures; each function draws one."""

from __future__ import annotations

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evaluation.comparison import EVENTS, TABLE_PLANES
from evaluation.conventions import FRONTAL, SAGITTAL
from evaluation.results import StudyResult
from evaluation.synchronize import Ensemble

INK, GREY = "#22313f", "#9aa5ad"
SERIES = ("#5d6d7a", "#b08900", "#c8553d", "#8a6fae", "#588157", "#2a6f97", "#d99a3d", "#3b8ea5")
SHOWN_BEFORE_S, SHOWN_AFTER_S = 1.0, 0.8
"""Time shown before the bending and after the landing peak."""

_LABELS = {
    SAGITTAL: "knee extension (+) flexion (-) [deg]",
    FRONTAL: "knee adduction (+) abduction (-) [deg]",
}


def mean_curves(result: StudyResult) -> Figure:
    """Mean curves of all conditions in both planes, shifted to the bending peak."""
    figure = Figure(figsize=(10.4, 4.6), layout="constrained")
    for place, plane in enumerate((SAGITTAL, FRONTAL)):
        axes = figure.add_subplot(1, 2, place + 1)
        for k, (name, ensemble) in enumerate(zip(result.measured.study.names, result.ensembles, strict=True)):
            shown = _shown(ensemble)
            axes.plot(
                ensemble.time[shown],
                ensemble.mean[shown, plane],
                color=SERIES[k % len(SERIES)],
                linewidth=1.6,
                label=name,
            )
        _mark_events(axes, result)
        axes.set(xlabel="time from the bending peak [s]", ylabel=_LABELS[plane])
        _quiet(axes)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False
    )
    return figure


def spread_by_condition(result: StudyResult) -> Figure:
    """Mean and standard deviation of each condition beside the baseline, both planes."""
    names = result.measured.study.names
    baseline = result.measured.study.baseline
    figure = Figure(figsize=(2.15 * max(3, len(names)), 4.6), layout="constrained")
    grid = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
    for row, plane in enumerate((SAGITTAL, FRONTAL)):
        for k, name in enumerate(names):
            axes = grid[row, k]
            if k != baseline:
                _band(axes, result.ensembles[baseline], plane, GREY)
            _band(axes, result.ensembles[k], plane, SERIES[k % len(SERIES)])
            _mark_events(axes, result)
            _quiet(axes)
            if row == 0:
                axes.set_title(_wrapped(name), fontsize=8.5, color=INK)
        grid[row, 0].set_ylabel("sagittal [deg]" if plane == SAGITTAL else "frontal [deg]")
    figure.supxlabel("time from the bending peak [s]", fontsize=9)
    return figure


def signed_differences(result: StudyResult) -> Figure:
    """Signed difference of every condition with its 95 % interval, by all three methods.

    The grey band is the detectable change: of two means in the sagittal plane, of a mean and zero in the
    frontal one, whose error is smaller by the root of two.
    """
    names = result.measured.study.names
    figure = Figure(figsize=(10.4, 0.9 + 0.62 * len(names)), layout="constrained")
    marks = {"paper": ("o", INK), "per_trial": ("s", "#2a6f97"), "two_landmark": ("^", "#c8553d")}
    grid = figure.subplots(1, 4, sharey=True)
    for column, axes in enumerate(grid):
        event, plane = divmod(column, len(TABLE_PLANES))
        for shift, (method, table) in enumerate(result.tables.items()):
            rows = np.arange(len(names)) + 0.22 * (shift - 1)
            middle = table.signed_deg[:, event, plane]
            reach = np.nan_to_num(table.high_deg[:, event, plane] - middle)
            mark, colour = marks[method]
            axes.errorbar(
                middle, rows, xerr=reach, fmt=mark, color=colour, markersize=4, linewidth=1.1,
                label=method.replace("_", " ") if column == 0 else None,
            )  # fmt: skip
        change = result.reliability[column].change_mean_deg / (1.0 if plane == SAGITTAL else np.sqrt(2.0))
        if np.isfinite(change):
            axes.axvspan(-change, change, color="#eef1f3", zorder=0)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        against = result.measured.study.settings.baseline if plane == SAGITTAL else "zero"
        axes.set(title=f"{EVENTS[event]}, {TABLE_PLANES[plane]}", xlabel=f"deg, against {against}")
        _quiet(axes)
    grid[0].set_yticks(range(len(names)), [_wrapped(name) for name in names], fontsize=8)
    grid[0].invert_yaxis()
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return figure


def single_trials(result: StudyResult) -> Figure:
    """Every repeat of every condition, to see the odd one out."""
    names = result.measured.study.names
    figure = Figure(figsize=(2.15 * max(3, len(names)), 4.2), layout="constrained")
    grid = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
    for row, plane in enumerate((SAGITTAL, FRONTAL)):
        for k, name in enumerate(names):
            ensemble = result.registered[k]
            shown = _shown(ensemble)
            for curve in ensemble.curves:
                grid[row, k].plot(
                    ensemble.time[shown], curve[shown, plane], color=SERIES[k % len(SERIES)], linewidth=0.9
                )
            _mark_events(grid[row, k], result)
            _quiet(grid[row, k])
            if row == 0:
                grid[row, k].set_title(_wrapped(name), fontsize=8.5, color=INK)
        grid[row, 0].set_ylabel("sagittal [deg]" if plane == SAGITTAL else "frontal [deg]")
    figure.supxlabel("time, both peaks brought together [s]", fontsize=9)
    return figure


def _band(axes: Axes, ensemble: Ensemble, plane: int, colour: str) -> None:
    shown = _shown(ensemble)
    time, mean, spread = ensemble.time[shown], ensemble.mean[shown, plane], ensemble.spread[shown, plane]
    axes.fill_between(time, mean - spread, mean + spread, color=colour, alpha=0.25, linewidth=0)
    axes.plot(time, mean, color=colour, linewidth=1.4)


def _shown(ensemble: Ensemble) -> slice:
    first = int(np.searchsorted(ensemble.time, -SHOWN_BEFORE_S))
    return slice(first, int(np.searchsorted(ensemble.time, ensemble.landing_s + SHOWN_AFTER_S)))


def _mark_events(axes: Axes, result: StudyResult) -> None:
    for at in (0.0, result.ensembles[result.measured.study.baseline].landing_s):
        axes.axvline(at, color=GREY, linewidth=0.7, linestyle=":")


def _wrapped(name: str, width: int = 22) -> str:
    lines = [""]
    for word in name.split():
        if lines[-1] and len(lines[-1]) + len(word) + 1 > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)


def _quiet(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e3e8eb", linewidth=0.6)
    axes.set_axisbelow(True)
