"""The files of an ablation: table, picture and page."""

from __future__ import annotations

import base64
import csv
import io
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from jinja2 import Environment
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from hilbrace import __version__
from hilbrace.config import OptimizeSettings
from hilbrace.domain.domain import Domain
from hilbrace.optimize.ablation import AblationRow, BraceFigures, Finding, findings
from hilbrace.optimize.design import LOSSES
from hilbrace.report.figures import FIELD, INK
from hilbrace.report.paint import BACK, FRONT, LEFT, RIGHT, paint
from hilbrace.run.folder import write_json
from hilbrace.run.records import write_atomic

Array = np.ndarray

COLUMNS = (
    ("L1", "deg^2"), ("L2", "MPa"), ("L3", "N*mm"), ("L4", "-"), ("L5", "-"),
    ("frontal", "N*m/deg"), ("sagittal", "N*m/deg"), ("ratio", "x unif."),
    ("d_front", "deg"), ("d_sagit", "deg"), ("volume", "-"),
)  # fmt: skip
"""Columns of the printed table and their units."""

LEGEND = (
    "L1 to L5: losses of the last field, without weights. frontal, sagittal: stiffness of the brace between "
    "its edges, joint straight. ratio: frontal over sagittal, against a uniform brace of the same volume. "
    "d_front, d_sagit: largest predicted changes of the angles over the motion."
)
"""What the columns mean."""


@dataclass(frozen=True)
class AblationField:
    """The design variable of one variant.

    Attributes:
        label: How people call the variant.
        d_triangle: Design variable at triangle centres [-]; ``None`` where there is no such brace.
    """

    label: str
    d_triangle: Float[Array, " triangle"] | None


@dataclass(frozen=True)
class Ablation:
    """An ablation, finished.

    Attributes:
        subject: Name of the subject.
        joint: Braced joint in words.
        preset: Name of the preset.
        settings: The optimizer's settings of the design.
        rows: One row per variant, the design first, the uniform brace last.
        fields: Their fields, in the same order.
    """

    subject: str
    joint: str
    preset: str
    settings: OptimizeSettings
    rows: tuple[AblationRow, ...]
    fields: tuple[AblationField, ...]


def ablation_figures(ablation: Ablation) -> dict[str, Any]:
    """The rows and the verdict as ``ablation.json`` holds them."""
    return {
        "subject": ablation.subject,
        "joint": ablation.joint,
        "preset": ablation.preset,
        "coupling": ablation.settings.coupling,
        "volume_fraction": ablation.settings.volume_fraction,
        "iterations": ablation.settings.iterations,
        "rows": [
            {"name": row.name, "label": row.label, "reason": row.reason or None}
            | (_named_losses(asdict(row.figures)) if row.figures else {})
            for row in ablation.rows
        ],
        "findings": [asdict(finding) for finding in findings(ablation.rows, ablation.settings)],
    }


def ablation_text(ablation: Ablation) -> str:
    """The table and the verdict as people read them in a terminal."""
    width = max(len(row.label) for row in ablation.rows) + 2
    head = "".join(f"{name:>10}" for name, _ in COLUMNS)
    units = "".join(f"{unit:>10}" for _, unit in COLUMNS)
    lines = [" " * width + head, " " * width + units]
    for row in ablation.rows:
        cells = _cells(row.figures) if row.figures else None
        text = "".join(f"{cell:>10}" for cell in cells) if cells else f"  no such brace: {row.reason}"
        lines.append(f"{row.label:<{width}}{text}")
    lines += ["", *textwrap.wrap(LEGEND, 120), ""]
    for finding in findings(ablation.rows, ablation.settings):
        told = (finding.claim, finding.sentence, *textwrap.wrap(finding.why, 105))
        lines += [f"{verdict(finding) if place == 0 else '':<14} {line}" for place, line in enumerate(told)]
    return "\n".join(lines) + "\n"


def write_ablation(ablation: Ablation, domain: Domain, folder: Path) -> None:
    """Write ``ablation.csv``, ``ablation.json``, ``ablation.png`` and ``ablation.html``.

    Args:
        ablation: What came out.
        domain: The brace's surface.
        folder: Where to write.
    """
    write_json(folder / "ablation.json", ablation_figures(ablation))
    write_atomic(folder / "ablation.csv", _csv(ablation.rows).encode())
    buffer = io.BytesIO()
    ablation_picture(ablation.fields, domain).savefig(
        buffer, format="png", dpi=150, metadata={"Software": None}
    )
    write_atomic(folder / "ablation.png", buffer.getvalue())
    write_atomic(folder / "ablation.html", _page(ablation, buffer.getvalue()).encode())


def ablation_picture(fields: Sequence[AblationField], domain: Domain) -> Figure:
    """The fields side by side: from the front, from the medial side, from behind, and the flat map.

    Args:
        fields: Fields of the variants, in order.
        domain: The brace's surface.
    """
    medial = LEFT if domain.joint.endswith("_r") else RIGHT
    views = (("front", FRONT), ("medial", medial), ("back", BACK))
    norm = Normalize(0.0, 1.0)
    figure = Figure(figsize=(1.75 * len(fields) + 0.9, 9.4), layout="constrained")
    for column, field in enumerate(fields):
        places = [figure.add_subplot(4, len(fields), row * len(fields) + column + 1) for row in range(4)]
        places[0].set_title(field.label, fontsize=10, color=INK)
        if column == 0:
            for axes, (name, _) in zip(places, views, strict=False):
                _row_label(axes, name)
        if field.d_triangle is None:
            _nothing(places)
            continue
        colours = colormaps[FIELD](norm(field.d_triangle))[:, :3]
        for axes, (_, towards) in zip(places, views, strict=False):
            paint(axes, domain.vertices, domain.triangles, colours, towards)
        _flat(places[-1], domain, field.d_triangle)
    bar = figure.colorbar(ScalarMappable(norm, FIELD), ax=figure.axes, shrink=0.4, pad=0.01)
    bar.set_label("design variable d [-]")
    return figure


def verdict(finding: Finding) -> str:
    """``came out``, ``did not`` or ``not known``."""
    return {True: "came out:", False: "did NOT:", None: "not known:"}[finding.came_out]


def _row_label(axes: Axes, name: str) -> None:
    axes.text(-0.06, 0.5, name, rotation=90, va="center", ha="right", transform=axes.transAxes, color=INK)


def _nothing(places: Sequence[Axes]) -> None:
    for axes in places:
        axes.axis("off")
    centre = places[1].transAxes
    places[1].text(
        0.5, 0.5, "cannot\nbe cast", ha="center", va="center", transform=centre, color=INK, fontsize=10
    )


def _flat(axes: Axes, domain: Domain, d: Float[Array, " triangle"]) -> None:
    mesh = Triangulation(domain.uv[:, 0], domain.uv[:, 1], domain.cut_triangles)
    axes.tripcolor(mesh, d, cmap=FIELD, vmin=0, vmax=1, rasterized=True)
    axes.set_aspect("equal")
    axes.axis("off")


def _cells(figures: BraceFigures) -> tuple[str, ...]:
    stability, energy, compliance, volume, seam = figures.losses
    return (
        f"{stability * np.rad2deg(1.0) ** 2:.5g}",
        _plain(energy),
        _plain(compliance),
        f"{volume:.2g}",
        f"{seam:.2g}",
        f"{figures.frontal_nm_per_deg:.5f}",
        f"{figures.sagittal_nm_per_deg:.5f}",
        f"{figures.ratio_vs_uniform:.2f}",
        f"{figures.frontal_change_deg:.3g}",
        f"{figures.sagittal_change_deg:.3g}",
        f"{figures.volume_fraction:.4f}",
    )


def _plain(value: float) -> str:
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.4g}"


def _named_losses(figures: dict[str, Any]) -> dict[str, Any]:
    losses = {
        f"L{place}_{name}": value
        for place, (name, value) in enumerate(zip(LOSSES, figures["losses"], strict=True), 1)
    }
    return losses | {key: value for key, value in figures.items() if key != "losses"}


def _csv(rows: Sequence[AblationRow]) -> str:
    names = list(next(_named_losses(asdict(row.figures)) for row in rows if row.figures))
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["variant", "label", *names, "reason"])
    for row in rows:
        values = _named_losses(asdict(row.figures)) if row.figures else dict.fromkeys(names, "")
        cells = (f"{value:.10g}" if isinstance(value, float) else value for value in values.values())
        table.writerow([row.name, row.label, *cells, row.reason])
    return text.getvalue()


def _page(ablation: Ablation, picture: bytes) -> str:
    texts = resources.files("hilbrace.report")
    template = Environment(autoescape=True).from_string(texts.joinpath("ablation.html.j2").read_text("utf-8"))
    return template.render(
        style=Markup(texts.joinpath("style.css").read_text("utf-8")),
        ablation=ablation,
        columns=COLUMNS,
        legend=LEGEND,
        rows=[(row, _cells(row.figures) if row.figures else ()) for row in ablation.rows],
        findings=[(finding, verdict(finding)) for finding in findings(ablation.rows, ablation.settings)],
        picture=Markup(f"data:image/png;base64,{base64.b64encode(picture).decode()}"),
        version=__version__,
    )
