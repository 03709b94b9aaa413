"""The laboratory report: one page that needs no other file, and its pictures for papers."""

from __future__ import annotations

import base64
import io
import math
from importlib import resources
from pathlib import Path
from typing import Any

import matplotlib
from jinja2 import Environment
from markupsafe import Markup
from matplotlib.figure import Figure

from evaluation import figures
from evaluation.comparison import EVENTS, METHODS_DIFFER_DEG, TABLE_PLANES
from evaluation.results import StudyResult
from evaluation.tables import table_cells, trials_json
from hilbrace import __version__
from hilbrace.run.records import write_atomic


def write_report(folder: Path, result: StudyResult) -> Path:
    """Write ``report.html`` and, beside it, every picture as PNG and SVG.

    Args:
        folder: Folder of the evaluation.
        result: The compared conditions.

    Returns:
        The page.
    """
    drawn = {
        "mean_curves": figures.mean_curves(result),
        "spread_by_condition": figures.spread_by_condition(result),
        "signed_differences": figures.signed_differences(result),
        "single_trials": figures.single_trials(result),
    }
    pictures = folder / "figures"
    pictures.mkdir(exist_ok=True)
    inline = {}
    for name, figure in drawn.items():
        rendered = {kind: _render(figure, kind) for kind in ("png", "svg")}
        for kind, content in rendered.items():
            write_atomic(pictures / f"{name}.{kind}", content)
        inline[name] = f"data:image/svg+xml;base64,{base64.b64encode(rendered['svg']).decode()}"
    page = folder / "report.html"
    write_atomic(page, _page(result, inline).encode())
    return page


def _render(figure: Figure, kind: str) -> bytes:
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "hilbrace", "svg.fonttype": "path"}):
        metadata = {"Date": None} if kind == "svg" else {"Software": None}
        figure.savefig(buffer, format=kind, dpi=150, metadata=metadata)
    return buffer.getvalue()


def _page(result: StudyResult, inline: dict[str, str]) -> str:
    environment = Environment(autoescape=True)
    template = environment.from_string(
        resources.files("evaluation").joinpath("page.html.j2").read_text("utf-8")
    )

    def figure(name: str, caption: str) -> Markup:
        return Markup('<figure><img alt="{}" src="{}"><figcaption>{}</figcaption></figure>').format(
            caption, Markup(inline[name]), caption
        )

    settings = result.measured.study.settings
    protocol = settings.protocol
    calibration = result.measured.calibration
    repeats = [int(count) for count in result.tables["paper"].repeats]
    return template.render(
        figure=figure,
        study=settings,
        version=__version__,
        side=protocol.side,
        hip=protocol.hip.model,
        cutoff=f"filtered at {protocol.processing.cutoff_hz:g} Hz" if protocol.processing.cutoff_hz else
        "unfiltered",
        cross_talk=calibration.cross_talk_deg,
        repeats=f"{min(repeats)}" if min(repeats) == max(repeats) else f"{min(repeats)} to {max(repeats)}",
        trials=len(result.measured.trials),
        standing=calibration.knee_deg.round(1) + 0.0,
        knee_width_mm=1000 * calibration.knee_width_m,
        rows=_rows(result),
        columns=[f"{event.capitalize()}, {plane}" for event in EVENTS for plane in TABLE_PLANES],
        methods=_method_rows(result),
        differ=METHODS_DIFFER_DEG,
        reliability=_reliability_rows(result),
        quality=trials_json(result.measured, result.events),
        warnings=result.warnings,
        events_seen=sorted({found.found_by for found in result.events}),
    )  # fmt: skip


def _rows(result: StudyResult) -> list[dict[str, Any]]:
    """The table by the paper's method, condition by condition."""
    cells = [cell for cell in table_cells(result) if cell["method"] == "paper"]
    width = len(EVENTS) * len(TABLE_PLANES)
    return [
        {
            "name": cells[start]["condition"],
            "baseline": start // width == result.measured.study.baseline,
            "cells": cells[start : start + width],
        }
        for start in range(0, len(cells), width)
    ]


def _method_rows(result: StudyResult) -> list[dict[str, Any]]:
    """Signed degrees by every method."""
    width = len(EVENTS) * len(TABLE_PLANES)
    rows = []
    for k, name in enumerate(result.measured.study.names):
        flat = {method: table.signed_deg[k].reshape(width) for method, table in result.tables.items()}
        spread = [max(v[c] for v in flat.values()) - min(v[c] for v in flat.values()) for c in range(width)]
        rows += [
            {
                "name": name if index == 0 else "",
                "method": method.replace("_", " "),
                "values": [f"{value:+.2f}" for value in values],
                "wide": [value > METHODS_DIFFER_DEG for value in spread],
            }
            for index, (method, values) in enumerate(flat.items())
        ]
    return rows


def _reliability_rows(result: StudyResult) -> list[dict[str, str]]:
    rows = []
    for index, entry in enumerate(result.reliability):
        event, plane = divmod(index, len(TABLE_PLANES))
        icc = entry.correlation
        rows.append(
            {
                "name": f"{EVENTS[event]}, {TABLE_PLANES[plane]}",
                "error": _degrees(entry.error_deg),
                "trial": _degrees(entry.change_trial_deg),
                "mean": _degrees(entry.change_mean_deg),
                "icc": "-" if icc is None else f"{icc.one_way:.2f} / {icc.two_way:.2f} / {icc.fixed:.2f}",
            }
        )
    return rows


def _degrees(value: float) -> str:
    """A figure of the reliability table; a dash where nothing was repeated."""
    return f"{value:.2f}" if math.isfinite(value) else "-"
