"""``hilbrace scan fit``: the body of a person from a scan of the legs."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from rich.console import Console

from hilbrace.body.anny_lite import load_anny_lite
from hilbrace.body.model import BodyModel
from hilbrace.body.skel import load_skel
from hilbrace.errors import GeometryError, InputError
from hilbrace.run.progress import Report, display, silent
from hilbrace.run.records import save, write_atomic
from hilbrace.scan.alignment import Start, find_start, mirrored_misfit, start_from_marks
from hilbrace.scan.deviation import Deviation, deviation
from hilbrace.scan.deviation_report import report_figures, write_report
from hilbrace.scan.fit_limb import limb_of
from hilbrace.scan.fit_pose import LAST_SIDEWAYS, LimbFit, fit_pose, held_at
from hilbrace.scan.free_form import FittedSkin, displaced
from hilbrace.scan.landmarks import PLACES, check_near, marks_of, read_landmarks
from hilbrace.scan.surface_scan import SurfaceScan, describe_holes, legs_seen, read_scan
from hilbrace.units import DEG, MESH_TO_M

Array = np.ndarray

EXAMPLE = "hilbrace scan fit leg.ply --leg left --landmarks leg.txt --out leg-fit"
SIDES = {"left": ("l",), "right": ("r",), "both": ("r", "l")}
DIRECTIONS = ("x", "y", "z", "minus-x", "minus-y", "minus-z")
FIRST_POINTS, POINTS = 1500, 1500
FIRST_STEPS, STEPS = 15, 30
LEADING = 16
"""Shape coefficients of the first round: the components of whole people, before the sliders of the legs."""


def add_options(command: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    command.add_argument("scan", type=Path, metavar="SCAN", help="mesh or cloud: .ply, .obj or .stl")
    command.add_argument(
        "--leg", choices=tuple(SIDES), required=True, help="what the scan shows, in the person's own view"
    )
    command.add_argument("--units", choices=tuple(MESH_TO_M), help="unit of the file (by its size: mm or m)")
    axes = f"{', '.join(DIRECTIONS[:-1])} or {DIRECTIONS[-1]}"
    command.add_argument(
        "--up", type=_direction, metavar="AXIS", help=f"of the file, upwards: {axes} (found)"
    )
    command.add_argument(
        "--forward", type=_direction, metavar="AXIS", help="of the file, to the toes (found)"
    )
    command.add_argument(
        "--landmarks",
        type=Path,
        metavar="FILE",
        help=f"text file, a line each: name and coordinates. {', '.join(PLACES)}; of both legs with _r or _l",
    )
    command.add_argument(
        "--knee-angle", type=float, metavar="DEG", help="flexion in the scan, where it is known (fitted)"
    )
    command.add_argument("--skel", type=Path, metavar="FILE.npz", help="your converted SKEL file")
    command.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (SCAN-fit)")
    command.epilog = f"example: {EXAMPLE}"


def act(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Fit, report, and leave the body for the body stage.

    Raises:
        GeometryError: The limb is none that the model can be; the report is written all the same.
    """
    scan = read_scan(options.scan, options.units)
    out: Path = options.out or options.scan.with_name(f"{options.scan.stem}-fit")
    quiet = options.json or not sys.stderr.isatty()
    with display(Console(stderr=True, quiet=quiet), "fit") as progress:
        skin, start = fitted(scan, options, progress)
    found = deviation(skin, scan)
    doubts = found.doubts + doubts_of(start) + ([] if found.stump else doubts_of_side(skin.fit, scan))
    out.mkdir(parents=True, exist_ok=True)
    write_report(skin, scan, found, doubts, out)
    figures = report_figures(skin, scan, found) | {"doubts": doubts, "good_enough": not doubts}
    write_atomic(out / "fit.json", (json.dumps(figures, indent=1) + "\n").encode())
    if found.stump:
        raise GeometryError(
            found.stump,
            where=str(options.scan),
            hint=f"use the surface as it is: body.model = 'mesh'; the report is in {out}",
        )
    save(skin.body, out / "body.npz")
    return figures | {"body": str(out / "body.npz")}, _text(scan, found, doubts, out)


def fitted(
    scan: SurfaceScan, options: argparse.Namespace, progress: Report = silent
) -> tuple[FittedSkin, Start]:
    """Both stages of the fit.

    Args:
        scan: The scan.
        options: Those of the command.
        progress: Called with (steps done, steps in all).

    Raises:
        InputError: Landmarks, or what the scan shows, do not match the leg asked for.
    """
    limb = limb_of(_model(options.skel), SIDES[options.leg])
    up, forward = axis_of(options.up), axis_of(options.forward)
    marks = None
    if options.landmarks is not None:
        places = read_landmarks(options.landmarks)
        marks = marks_of(limb, places, MESH_TO_M[scan.unit], str(options.landmarks))
        check_near(limb, marks, places, scan, str(options.landmarks))
    if marks is not None and len(marks.places) > 2:
        start = start_from_marks(limb, marks)
    else:
        if up is not None:
            check_legs(scan, up, options.leg)
        start = find_start(limb, scan, up, forward, lambda done, total: progress(done, total + 6))
    check_legs(scan, start.fit.pose.rotation[:, 1], options.leg)
    fit = start.fit
    if options.knee_angle is not None:
        fit = held_at(fit, {f"knee_angle_{side}": options.knee_angle * DEG for side in limb.sides})
    progress(3, 6)
    fit = fit_pose(fit, scan, FIRST_POINTS, FIRST_STEPS, shaped=LEADING, marks=marks)
    progress(4, 6)
    fit = fit_pose(fit, scan, POINTS, STEPS, marks=marks, sideways=LAST_SIDEWAYS)
    progress(5, 6)
    skin = displaced(fit, scan)
    progress(6, 6)
    return skin, start


def check_legs(scan: SurfaceScan, up: Float[Array, "3"], leg: str) -> None:
    """Does the scan show as many legs as asked for?

    Raises:
        InputError: It shows two where one was asked for.
    """
    if leg != "both" and legs_seen(scan.points, up) == 2:
        raise InputError(
            "the scan shows two legs",
            where=scan.where,
            hint=f"cut the other leg away, or fit both: --leg both (asked for: --leg {leg})",
        )


def doubts_of(start: Start) -> list[str]:
    """Doubts about the direction in which the leg was found."""
    if not start.doubt:
        return []
    return ["the leg fits almost as well turned otherwise: give --up and --forward, or three landmarks"]


def doubts_of_side(fit: LimbFit, scan: SurfaceScan) -> list[str]:
    """Doubts whether a single leg is the left or the right one."""
    if len(fit.limb.sides) > 1 or mirrored_misfit(fit, scan) >= 1.0:
        return []
    asked, other = ("left", "right") if fit.limb.sides == ("l",) else ("right", "left")
    return [
        f"this looks like a {other} leg, not a {asked} one: check --leg, and that the file is not mirrored"
    ]


def _model(skel: Path | None) -> BodyModel:
    return load_anny_lite() if skel is None else load_skel(skel, None)


def _direction(word: str) -> str:
    """A direction as the command takes it: ``--up minus-z``, or ``--up=-z``, which needs its equals sign."""
    word = word.lower().replace("minus-", "-").removeprefix("+")
    if word.replace("-", "minus-") not in DIRECTIONS:
        raise argparse.ArgumentTypeError(f"'{word}' is none of {', '.join(DIRECTIONS)}")
    return word


def axis_of(name: str | None) -> Float[Array, "3"] | None:
    """A direction in the scan's axes, by its name; nothing where none was given."""
    if name is None:
        return None
    return np.eye(3)["xyz".index(name[-1])] * (-1.0 if name.startswith("-") else 1.0)


def _text(scan: SurfaceScan, found: Deviation, doubts: list[str], out: Path) -> str:
    lines = [
        f"mean {found.mean_mm:.2f} mm, 95 % {found.p95_mm:.2f} mm, largest {found.max_mm:.2f} mm"
        f" ({found.worst})",
        f"{100 * found.cover:.0f} % of the skin around the knee was scanned; file in {scan.unit}",
    ]
    lines += describe_holes(scan)
    lines += [f"doubt: {doubt}" for doubt in doubts] or ["good enough to design on"]
    lines.append(f"report: {out / 'report.html'}")
    lines.append(f"use it: --set body.model=scan --set body.model_file={out / 'body.npz'}")
    return "\n".join(lines) + "\n"
