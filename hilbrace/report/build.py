"""Write the report: pictures as files, and one page that holds everything."""

from __future__ import annotations

import base64
import io
from importlib import resources
from pathlib import Path
from typing import Any

import matplotlib
from jinja2 import Environment
from markupsafe import Markup
from matplotlib.figure import Figure

from hilbrace import __version__
from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.config import ANGLES, OPEN, Config, passive_stiffness
from hilbrace.optimize.design import Design
from hilbrace.pattern.picture import strut_width_histogram
from hilbrace.report import figures
from hilbrace.report.light_solid import lighter
from hilbrace.report.map_pictures import map_distortion_picture
from hilbrace.report.mold import MoldSection, mold_section
from hilbrace.report.reasons import pull_picture, reasons, zones
from hilbrace.report.viewer import turnable
from hilbrace.report.words import preset_sentence, summary
from hilbrace.run.records import write_atomic

PAINTED = frozenset(
    {
        "key_frames",
        "field_on_leg",
        "map_distortion",
        "soft_and_firm",
        "solid",
        "strut_widths",
        "brace_on_body",
        "pulls",
    }
)
"""Pictures made of many triangles: PNG alone. The others are drawings: SVG as well."""

LOSSES_CAPTION = {
    "stiffness": "Losses over the iterations. L1 is 1 for a brace like the uniform one and falls as it frees "
    "the joint; L2 and L3 are in units of their start, L4 and L5 in those of a 5 % error.",
    "paper": "Losses over the iterations: L1 to L3 in units of their start, L4 and L5 in those of a 5 % "
    "error.",
}
"""What the losses are measured by, for each coupling."""

FIGURES = (
    ("motion", "frames", "frames of the motion", ""),
    ("motion", "rate_hz", "their rate", "Hz"),
    ("motion", "markers", "markers", ""),
    ("biomech", "coordinates", "coordinates of the skeleton", ""),
    ("biomech", "muscles", "muscles", ""),
    ("biomech", "marker_rms_mm", "marker error of the inverse kinematics, RMS", "mm"),
    ("biomech", "pelvis_residual_rms_n", "residual force at the pelvis, RMS", "N"),
    ("body", "height_m", "height of the body model", "m"),
    ("domain", "triangles", "triangles of the brace's surface", ""),
    ("domain", "quasi_conformal_mean", "mean quasi-conformal ratio of its flat map (1 keeps angles)", ""),
    ("optimize", "iterations", "iterations of the optimizer", ""),
    ("optimize", "seconds_per_iteration", "time for each", "s"),
    ("brace", "volume_fraction", "volume over that of a solid sleeve, as optimized", ""),
    ("pattern", "area_fraction", "area of the struts over that of a solid sleeve", ""),
    ("solid", "volume_ml", "volume of the solid", "ml"),
    ("solid", "volume_error", "its relative distance from area x fraction x thickness", ""),
    ("solid", "triangles", "triangles of the solid", ""),
    ("solid", "genus", "handles of the solid (genus)", ""),
    ("solid", "manifold_status", "manifold check of the solid", ""),
    ("solid", "thickness_p01_mm", "thickness that 99 % of the solid exceed", "mm"),
)
"""Group and key in `metrics.json`, what they are called on the page, and their unit."""


def build_report(
    folder: Path, config: Config, records: dict[str, Any], metrics: dict[str, dict[str, Any]]
) -> list[Path]:
    """Draw every picture and write ``index.html``, which needs no other file and no network.

    Args:
        folder: The report's folder.
        config: The run's configuration.
        records: The record of each stage.
        metrics: Figures of the stages.

    Returns:
        The files written.
    """
    records = records | {"solid": lighter(records["solid"])}
    drawn = _draw(records, config.pattern.min_strut_mm)
    pictures = folder / "figures"
    pictures.mkdir(exist_ok=True)
    files: list[Path] = []
    inline: dict[str, str] = {}
    for name, figure in drawn.items():
        kinds = ("png",) if name in PAINTED else ("png", "svg")
        rendered = {kind: _render(figure, kind) for kind in kinds}
        for kind, content in rendered.items():
            write_atomic(pictures / f"{name}.{kind}", content)
            files.append(pictures / f"{name}.{kind}")
        inline[name] = (
            _image(rendered["svg"], "svg+xml") if "svg" in rendered else _image(rendered["png"], "png")
        )
    view = turnable(records["body"], records["domain"], records["optimize"], records["solid"])
    page = folder / "index.html"
    film = folder.parent / "optimize" / "film.gif"
    if film.is_file():
        inline["film"] = _image(film.read_bytes(), "gif")
    mold = mold_section(folder.parent) if "mold" in metrics else None
    write_atomic(page, _page(config, records, metrics, inline, view, mold).encode())
    return [page, *files]


def _draw(records: dict[str, Any], min_strut_mm: float) -> dict[str, Figure]:
    trial, body, domain = records["motion"], records["body"], records["domain"]
    loads: JointLoads = records["biomech"]
    design: Design = records["optimize"]
    joint = domain.joint
    return {
        "key_frames": figures.key_frames(trial, body, loads, joint),
        "ground_reactions": figures.ground_reactions(trial),
        "joint_angles": figures.joint_angles(loads, joint),
        "acting_force": figures.acting_force(loads, joint),
        "contact_force": figures.contact_force(loads, joint),
        "field_on_leg": figures.field_on_leg(domain, design),
        "soft_and_firm": figures.soft_and_firm(domain, design),
        "flat_map": figures.flat_map(domain, design),
        "map_distortion": map_distortion_picture(domain),
        "losses": figures.losses(design),
        "pulls": pull_picture(domain, design),
        "stiffness": figures.stiffness(design, joint),
        "flexion_moment": figures.flexion_moment(design, joint),
        "predicted_change": figures.predicted_change(domain, design),
        "solid": figures.solid(records["solid"], domain),
        "strut_widths": figures.strut_widths(records["solid"], domain, min_strut_mm),
        "strut_histogram": strut_width_histogram(records["pattern"], min_strut_mm),
        "brace_on_body": figures.brace_on_body(records["solid"], body, domain),
    }


def _render(figure: Figure, kind: str) -> bytes:
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "hilbrace", "svg.fonttype": "path", "font.size": 10}):
        metadata = {"Date": None} if kind == "svg" else {"Software": None}
        figure.savefig(buffer, format=kind, dpi=150, metadata=metadata)
    return buffer.getvalue()


def _image(content: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _page(
    config: Config,
    records: dict[str, Any],
    metrics: dict[str, dict[str, Any]],
    inline: dict[str, str],
    view: str,
    mold: MoldSection | None,
) -> str:
    design: Design = records["optimize"]
    why = reasons(design, zones(records["body"], records["domain"], design))
    environment = Environment(autoescape=True)
    template = environment.from_string(
        resources.files("hilbrace.report").joinpath("page.html.j2").read_text("utf-8")
    )

    def figure(name: str, caption: str) -> Markup:
        return Markup('<figure><img alt="{}" src="{}"><figcaption>{}</figcaption></figure>').format(
            caption, Markup(inline[name]), caption
        )

    brace, motion, biomech = metrics["brace"], metrics["motion"], metrics["biomech"]
    return template.render(
        figure=figure,
        style=Markup(resources.files("hilbrace.report").joinpath("style.css").read_text("utf-8")),
        turnable=Markup(view),
        subject=config.subject.name,
        joint_text=f"{config.domain.side} {config.domain.joint}",
        synthetic=motion["origin"] == "synthetic",
        motion=motion["name"],
        mass=f"{motion['subject_mass_kg']:.1f}",
        version=__version__,
        cards=_cards(metrics),
        summary=summary(config, design, metrics, why),
        why=why,
        mold=mold,
        losses_caption=LOSSES_CAPTION[config.optimize.coupling],
        film="film" in inline,
        preset=preset_sentence(config),
        open_points=OPEN if config.preset == "paper" else (),
        cutoff=f"{biomech['cutoff_hz']:g}",
        literal=records["biomech"].convention == "paper_literal",
        marker_rms=f"{biomech['marker_rms_mm']:.1f}",
        volume=f"{100 * brace['volume_fraction']:.1f} %",
        passive=passive_stiffness(config.optimize, config.domain.joint)[1],
        joint=config.domain.joint,
        stiffness_rows=_stiffness_rows(brace, config.domain.joint),
        coupling=brace["coupling"],
        prediction_rows=_prediction_rows(brace),
        contact_change=[
            f"{brace['predicted_by_coupling'][name]['contact_force_change_max_n']:.2g}"
            for name in ("stiffness", "paper")
        ],
        figures_rows=_figure_rows(metrics),
        notes=[
            _sentence(note) for note in (*motion["notes"], *biomech["notes"], *metrics["domain"]["notes"])
        ],
    )


def _sentence(note: str) -> str:
    return note[:1].upper() + note[1:].rstrip(".") + "."


def _cards(metrics: dict[str, dict[str, Any]]) -> list[dict[str, str]]:
    brace, solid, biomech = metrics["brace"], metrics["solid"], metrics["biomech"]
    joint = biomech["joint"].split("_")[0]
    bend = max(biomech["joint_sagittal_range_deg"], key=abs)
    bent = ANGLES[joint][0] if joint == "knee" or bend > 0 else "plantarflexion"
    frontal = brace["stiffness_frontal_nm_per_deg"] / brace["stiffness_frontal_uniform_nm_per_deg"]
    sagittal = brace["stiffness_sagittal_nm_per_deg"] / brace["stiffness_sagittal_uniform_nm_per_deg"]
    return [
        {
            "value": f"{brace['stiffness_ratio_vs_uniform']:.1f} x",
            "label": "frontal over sagittal stiffness, against a uniform brace of the same volume",
        },
        {"value": f"{frontal:.2f} x", "label": "frontal stiffness of that uniform brace"},
        {"value": f"{sagittal:.2f} x", "label": "sagittal stiffness of that uniform brace (less is freer)"},
        {
            "value": f"{biomech['acting_force_peak_bw']:.2f} BW",
            "label": f"peak acting force across the {joint}",
        },
        {"value": f"{abs(bend):.0f} deg", "label": f"peak {joint} {bent}"},
        {"value": f"{solid['mass_g']:.0f} g", "label": f"of rubber, {solid['volume_ml']:.0f} ml to pour"},
        {
            "value": f"{solid['min_strut_mm']:.1f} mm",
            "label": f"narrowest strut; {'watertight' if solid['watertight'] else 'NOT watertight'}, "
            f"{solid['parts']} part{'' if solid['parts'] == 1 else 's'}",
        },
    ]


def _stiffness_rows(brace: dict[str, Any], joint: str) -> list[tuple[str, str, str, str]]:
    """Stiffness of both braces and their ratio, joint straight and bent."""

    def row(label: str, own: float, plain: float) -> tuple[str, str, str, str]:
        return f"{label} [N*m/deg]", f"{own:.4f}", f"{plain:.4f}", f"{own / plain:.2f}"

    rows = [
        row(
            f"{plane}, neutral pose",
            brace[f"stiffness_{plane}_nm_per_deg"],
            brace[f"stiffness_{plane}_uniform_nm_per_deg"],
        )
        for plane in ("frontal", "sagittal", "axial")
    ]
    for posture in brace["postures"]:
        if posture["flexion_deg"] == 0.0:
            continue
        where = f"{posture['flexion_deg']:.0f} deg {ANGLES[joint][0]}"
        for plane in ("frontal", "sagittal"):
            own, plain = posture[f"{plane}_nm_per_deg"], posture[f"{plane}_uniform_nm_per_deg"]
            rows.append(row(f"{plane}, {where}", own, plain))
    return rows


def _prediction_rows(brace: dict[str, Any]) -> list[tuple[str, ...]]:
    """Largest predicted changes by both couplings, as configured and for other passive stiffnesses."""

    def row(label: str, found: dict[str, Any]) -> tuple[str, ...]:
        planes = ("frontal_change_max_deg", "sagittal_change_max_deg")
        return (label, *(f"{found[name][plane]:.3g}" for name in ("stiffness", "paper") for plane in planes))

    rows = [row("as configured", brace["predicted_by_coupling"])]
    for other in brace["passive_sensitivity"]:
        rows.append(row(f"{other['passive_frontal_nm_per_deg']:g} N*m/deg", other))
    return rows


def _figure_rows(metrics: dict[str, dict[str, Any]]) -> list[tuple[str, str]]:
    """What `metrics.json` says, in words; the few figures that say how well each stage went."""
    return [
        (label, _rounded(metrics[group][key]) + (f" {unit}" if unit else ""))
        for group, key, label, unit in FIGURES
        if key in metrics.get(group, {})
    ]


def _rounded(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
