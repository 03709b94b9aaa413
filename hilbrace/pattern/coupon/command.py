"""``hilbrace cells coupon`` and ``hilbrace cells calibrate``: a test piece for the laboratory, and back."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hilbrace.config import MaterialSettings
from hilbrace.errors import ConfigError
from hilbrace.pattern.coupon.calibration import WINDOW, calibrate, run_file_lines
from hilbrace.pattern.coupon.curve import read_curve
from hilbrace.pattern.coupon.files import read_coupon, write_coupon
from hilbrace.pattern.coupon.piece import CouponPlan

EXAMPLES = {
    "coupon": "hilbrace cells coupon voronoi_open --d 0.5 --out coupon",
    "calibrate": "hilbrace cells calibrate curve.csv --coupon coupon/coupon.json",
}
ABOUT = {
    "coupon": "A flat plate of one microstructure between grips, for a tensile machine: STL file, predicted "
    "force line, picture.",
    "calibrate": "Young's modulus of the rubber from the measured curve of a coupon, for run.toml.",
}


def add_options(command: argparse.ArgumentParser, action: str) -> None:
    """Give the parser of ``hilbrace cells`` the arguments of one of the two actions."""
    command.prog = f"hilbrace cells {action}"
    command.description = ABOUT[action]
    command.add_argument("action", choices=(action,), help=argparse.SUPPRESS)
    if action == "coupon":
        _coupon_options(command)
    else:
        _calibrate_options(command)
    command.add_argument("--json", action="store_true", help="one JSON object on standard output")
    command.epilog = f"example: {EXAMPLES[action]}"


def coupon(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Write a test piece; its figures, and what to tell a person."""
    plan = CouponPlan(
        cell=options.cell,
        d=options.d,
        along=options.along,
        cell_mm=options.cell_mm,
        across=options.across,
        length=2 * options.across if options.length is None else options.length,
        thickness_mm=options.thickness_mm,
        grip_mm=options.grip_mm,
    )
    figures = write_coupon(plan, options.out, options.modulus_mpa, options.poisson, not options.quick)
    ratio = figures["every_strut_over_homogenized"]
    stiffness = figures["stiffness_n_per_mm_per_mpa"] * options.modulus_mpa
    lines = [
        f"{plan.cell} at d = {plan.d:g}: {figures['width_mm']:g} x {figures['gauge_mm']:g} mm between grips,"
        f" {plan.across} x {plan.length} cells of {plan.cell_mm:g} mm,",
        f"struts {figures['strut_mm']:.2f} mm wide, {100 * figures['volume_fraction']:.1f} % rubber",
        f"predicted: {stiffness:.4g} N/mm for a rubber of {options.modulus_mpa:g} MPa (homogenized)",
    ]
    if ratio is not None:
        lines.append(
            f"           {stiffness * ratio:.4g} N/mm with every strut meshed ({100 * (ratio - 1):+.1f} %:"
            " free edges and grips, which fade with more cells across)"
        )
    lines += ["pull it to 10 % strain, then:", f"  {EXAMPLES['calibrate']}", "written:"]
    return figures, "\n".join([*lines, *(f"  {name}" for name in figures["files"]), ""])


def calibrated(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Read a measured curve; the rubber's modulus, and what to tell a person."""
    beside = options.curve.parent / "coupon.json"
    piece = read_coupon(options.coupon or beside)
    thickness = piece.plan.thickness_mm if options.thickness_mm is None else options.thickness_mm
    if not 0.1 <= thickness <= 50.0:
        raise ConfigError(
            f"a plate of {thickness:g} mm is none",
            where="--thickness-mm",
            hint="give the measured thickness in mm",
        )
    stiffness = piece.best * thickness / piece.plan.thickness_mm
    curve = read_curve(options.curve, piece.plan.gauge_mm)
    found = calibrate(curve, stiffness, piece.plan.gauge_mm, (options.start, options.end))
    by = "homogenized" if piece.stiffness_every_strut is None else "every strut meshed"
    figures = {**asdict(found), "stiffness_n_per_mm_per_mpa": stiffness, "stiffness_by": by}
    text = (
        f"Young's modulus {found.youngs_modulus_mpa:.4g} +- {found.half_width_mpa:.2g} MPa"
        f" (95 %, of the fit alone; {by})\n"
        f"rows {found.rows[0]} to {found.rows[1]}, strain {100 * found.strain[0]:.1f} to"
        f" {100 * found.strain[1]:.1f} %, {found.samples} samples, {found.residual_n:.2g} N off the line\n"
        f"upper half of the window {100 * found.bend:+.1f} % steeper than the lower half\n\n"
        f"{run_file_lines(found)}"
    )
    return figures, text


def _coupon_options(command: argparse.ArgumentParser) -> None:
    rubber = MaterialSettings.model_validate({})
    plan = CouponPlan(cell="", d=0.0)
    command.add_argument("cell", metavar="CELL", help="microstructure: a built-in name or a skeleton file")
    command.add_argument(
        "--d", type=float, required=True, help="design variable: 0 thinnest, 1 widest struts of designs"
    )
    command.add_argument(
        "--along", choices=("u", "v"), default=plan.along, help="axis of the map along the pull (default: v)"
    )
    sizes = (
        ("--cell-mm", float, plan.cell_mm, "side of a cell, half a period"),
        ("--across", int, plan.across, "cells from edge to edge, an even number; 6 or more"),
        ("--thickness-mm", float, plan.thickness_mm, "thickness of the plate"),
        ("--grip-mm", float, plan.grip_mm, "length of each grip"),
        ("--modulus-mpa", float, rubber.youngs_modulus_mpa, "Young's modulus of the rubber, for the line"),
        ("--poisson", float, rubber.poisson, "Poisson's ratio of the rubber"),
    )
    for name, kind, default, text in sizes:
        command.add_argument(
            name, type=kind, default=default, metavar="X", help=f"{text} (default: {default:g})"
        )
    command.add_argument(
        "--length", type=int, metavar="X", help="cells from grip to grip (default: 2 across)"
    )
    command.add_argument(
        "--quick", action="store_true", help="leave out the stiffness with every strut meshed"
    )
    command.add_argument(
        "--out", type=Path, default=Path("coupon"), metavar="DIR", help="folder to write (default: coupon)"
    )


def _calibrate_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "curve", type=Path, metavar="CURVE.csv", help="force and extension, units in the header"
    )
    command.add_argument(
        "--coupon", type=Path, metavar="FILE", help="coupon.json of the piece (default: beside the curve)"
    )
    command.add_argument("--thickness-mm", type=float, metavar="X", help="measured thickness of the casting")
    for name, key, value in (("--from", "start", WINDOW[0]), ("--to", "end", WINDOW[1])):
        command.add_argument(
            name, dest=key, type=float, default=value, metavar="STRAIN", help=f"(default: {value:g})"
        )
