"""``hilbrace scan decode``: points and mesh of a limb from pictures of it."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from rich.console import Console

from hilbrace.errors import ConfigError
from hilbrace.run.progress import display
from hilbrace.run.records import write_atomic
from hilbrace.scan.calibrate_command import add_patterns_option, patterns_folder
from hilbrace.scan.calibration import Calibration, read_calibration
from hilbrace.scan.capture import open_capture
from hilbrace.scan.clean import CleanMesh, clean_mesh, inner_holes
from hilbrace.scan.decode import decode_capture
from hilbrace.scan.fuse import fuse_views
from hilbrace.scan.merge import Move, merge_views
from hilbrace.scan.patterns import PatternPlan, read_manifest
from hilbrace.scan.point_cloud import PointCloud, SmoothView, joined, smooth_view, view_cloud, write_cloud
from hilbrace.scan.triangulate import triangulate
from hilbrace.scan.view_picture import write_view_picture

EXAMPLE = "hilbrace scan decode leg_front leg_left --calibration calibration.toml --turn 0,45 --out leg"
GRID_MM = 2.0
"""Distance of the mesh's grid points [mm]."""
LARGE_PIECE = 0.2
"""Area of a dropped piece, against that which stays, from which it is told [-]."""
DARK = 40.0
"""Contrast below which the pictures are called dark [grey levels]."""


@dataclass(frozen=True)
class View:
    """A decoded and triangulated view.

    Attributes:
        name: Its name, which its files carry.
        smooth: Normals and means on the pixels.
        cloud: Its points.
        figures: What to say about it.
    """

    name: str
    smooth: SmoothView
    cloud: PointCloud
    figures: dict[str, float]


def add_options(command: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    command.add_argument(
        "captures", type=Path, nargs="+", metavar="FOLDER", help="pictures, one folder a view"
    )
    add_patterns_option(command)
    command.add_argument(
        "--calibration",
        type=Path,
        default=Path("calibration.toml"),
        metavar="FILE",
        help="(calibration.toml)",
    )
    command.add_argument(
        "--turn",
        metavar="DEG,DEG,...",
        help="turn of the limb in each view against the first, counter-clockwise from above; 0,30,60 for"
        " three views (default: views start where they are)",
    )
    command.add_argument(
        "--depth",
        metavar="NEAR:FAR",
        help="leave out what is nearer or farther than this from the camera [mm]",
    )
    command.add_argument(
        "--voxel", type=float, default=GRID_MM, metavar="MM", help=f"grid of the mesh ({GRID_MM:g})"
    )
    command.add_argument(
        "--out", type=Path, default=Path("scan"), metavar="DIR", help="folder to write (scan)"
    )
    command.epilog = f"example: {EXAMPLE}"


def act(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Decode, merge and mesh; figures, and what to tell a person."""
    plan = read_manifest(patterns_folder(options.patterns, options.captures))
    calibration = read_calibration(options.calibration)
    _check_pair(plan, calibration, options)
    turns = _turns(options.turn, len(options.captures))
    depth = _depth(options.depth)
    if not 0.2 <= options.voxel <= 20.0:
        raise ConfigError(
            f"a grid of {options.voxel:g} mm", where="--voxel", hint="choose 0.2 to 20; 2 is usual"
        )
    options.out.mkdir(parents=True, exist_ok=True)
    views = []
    with display(Console(stderr=True, quiet=options.json or not sys.stderr.isatty()), "views") as progress:
        for number, folder in enumerate(options.captures):
            progress(number, len(options.captures))
            name = _name(folder, number, options.captures)
            views.append(decode_view(folder, name, plan, calibration, depth, options.out))
    moves = merge_views([view.cloud for view in views], [view.name for view in views], turns)
    cloud = joined(
        [view.cloud.moved(move.rotation, move.shift) for view, move in zip(views, moves, strict=True)]
    )
    write_cloud(cloud, options.out / "cloud.ply")
    mesh = clean_mesh(
        *fuse_views([view.smooth for view in views], moves, calibration.camera, options.voxel),
        str(options.out),
    )
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(options.out / "limb.ply")
    figures = _figures(views, moves, cloud, mesh)
    write_atomic(options.out / "scan.json", (json.dumps(figures, indent=1) + "\n").encode())
    return figures, _text(figures, options.out)


def decode_view(
    folder: Path,
    name: str,
    plan: PatternPlan,
    calibration: Calibration,
    depth_mm: tuple[float, float],
    out: Path,
) -> View:
    """Decode one view and write its cloud and picture.

    Args:
        folder: Its pictures.
        name: Name of its files.
        plan: What was projected.
        calibration: Camera and projector.
        depth_mm: Nearest and farthest depth that counts [mm].
        out: Folder of the files.

    Raises:
        InputError: A picture or the calibration cannot be used.
        ConfigError: Nothing lies at the depths that were asked for.
    """
    decoded = decode_capture(open_capture(folder, plan))
    ranges = triangulate(decoded, calibration, str(folder))
    smooth = smooth_view(ranges, depth_mm)
    cloud = view_cloud(ranges, smooth)
    write_view_picture(decoded, ranges, smooth, out / f"{name}.png")
    if not len(cloud.points):
        seen = ranges.points[..., 2][ranges.valid]
        reach = f"{seen.min():.0f} to {seen.max():.0f} mm" if len(seen) else "nowhere"
        raise ConfigError(
            f"no points between {depth_mm[0]:g} and {depth_mm[1]:g} mm; the view has some at {reach}",
            where=str(folder),
            hint="change --depth",
        )
    write_cloud(cloud, out / f"{name}.ply")
    lit = int(decoded.lit.sum())
    figures = {
        "points": len(cloud.points),
        "lit_pixels": lit,
        "decoded_part": float(decoded.valid.sum() / lit),
        "over_exposed_part": float(decoded.saturated.sum() / lit),
        "contrast_grey_levels": decoded.contrast,
        "noise_grey_levels": decoded.noise,
        "expected_error_mm": float(np.sqrt(np.mean(cloud.error.astype(float) ** 2))),
        "off_line_px": ranges.off_line_px,
    }
    return View(name, smooth, cloud, figures)


def _figures(
    views: Sequence[View], moves: Sequence[Move], cloud: PointCloud, mesh: CleanMesh
) -> dict[str, Any]:
    parts = [
        {
            "name": view.name,
            **view.figures,
            "overlap": move.overlap,
            "misfit_mm": move.misfit_mm,
            "rotation": move.rotation.tolist(),
            "shift_mm": move.shift.tolist(),
        }
        for view, move in zip(views, moves, strict=True)
    ]
    return {
        "unit": "mm",
        "axes": "y up, z towards the camera of the first view",
        "views": parts,
        "points": len(cloud.points),
        "mesh": {
            "vertices": len(mesh.vertices),
            "triangles": len(mesh.triangles),
            "size_mm": np.ptp(mesh.vertices, axis=0).tolist(),
            "pieces_dropped": mesh.pieces_dropped,
            "area_dropped": mesh.area_dropped,
            "depth_mm": (-mesh.vertices[:, 2].max(), -mesh.vertices[:, 2].min()),
            "second_piece_middle": mesh.second_middle,
            "second_piece_part": mesh.second_part,
            "borders": [asdict(hole) for hole in mesh.holes],
            "holes_inside": len(inner_holes(mesh)),
        },
    }


def _text(figures: dict[str, Any], out: Path) -> str:
    lines = ["view               points   decoded  over-exposed   error mm   overlap   misfit mm"]
    for view in figures["views"]:
        lines.append(
            f"{view['name']:<16} {view['points']:>8} {100 * view['decoded_part']:>7.0f} %"
            f" {100 * view['over_exposed_part']:>11.1f} % {view['expected_error_mm']:>10.3f}"
            f" {100 * view['overlap']:>7.0f} % {view['misfit_mm']:>11.3f}"
        )
        if view["contrast_grey_levels"] < DARK:
            lines.append(
                f"  note: white is {view['contrast_grey_levels']:.0f} grey levels above black; expose longer"
                " or darken the room to lower the error"
            )
    mesh = figures["mesh"]
    width, height, depth = mesh["size_mm"]
    lines.append(
        f"mesh: {mesh['triangles']} triangles, {width:.0f} x {height:.0f} x {depth:.0f} mm,"
        f" {mesh['pieces_dropped']} smaller pieces dropped ({100 * mesh['area_dropped']:.1f} % of the area)"
    )
    if mesh["second_piece_part"] > LARGE_PIECE:
        near, far = mesh["depth_mm"]
        x, y, z = mesh["second_piece_middle"]
        lines += [
            f"  note: a dropped piece around ({x:.0f}, {y:.0f}, {z:.0f}) mm has"
            f" {100 * mesh['second_piece_part']:.0f} % of the area of this one,",
            f"  which is {near:.0f} to {far:.0f} mm away; choose the limb with --depth NEAR:FAR",
        ]
    for border in mesh["borders"][:6]:
        x, y, z = border["middle"]
        lines.append(
            f"  border of {border['length_mm']:.0f} mm, {border['across_mm']:.0f} mm across, around"
            f" ({x:.0f}, {y:.0f}, {z:.0f}) mm"
        )
    if len(mesh["borders"]) > 6:
        lines.append(f"  and {len(mesh['borders']) - 6} shorter borders, see scan.json")
    lines += [
        "axes: y up, z towards the camera of the first view, mm",
        f"written: {out}/cloud.ply, limb.ply, scan.json, and a cloud and a picture of each view",
        "",
    ]
    return "\n".join(lines)


def _check_pair(plan: PatternPlan, calibration: Calibration, options: argparse.Namespace) -> None:
    if calibration.projector.size != (plan.width, plan.height):
        width, height = calibration.projector.size
        raise ConfigError(
            f"the patterns are for a projector of {plan.width} x {plan.height} pixels, the calibration for"
            f" {width} x {height}",
            where=str(options.calibration),
            hint="calibrate with the patterns that are projected on the limb",
        )


def _turns(text: str | None, count: int) -> list[float] | None:
    if text is None:
        return None
    try:
        turns = [float(word) for word in text.split(",")]
    except ValueError:
        turns = []
    if len(turns) != count or turns[0] != 0.0 or not np.isfinite(turns).all():
        raise ConfigError(
            f"'{text}' are not the turns of {count} views",
            where="--turn",
            hint="write one angle a view in degrees, 0 for the first, such as --turn 0,45,90",
        )
    return turns


def _depth(text: str | None) -> tuple[float, float]:
    if text is None:
        return 0.0, float("inf")
    try:
        near, far = (float(word) for word in text.split(":"))
    except ValueError:
        near, far = 0.0, 0.0
    if not 0.0 <= near < far:
        raise ConfigError(
            f"'{text}' is no range of depth", where="--depth", hint="write --depth 400:900, in mm"
        )
    return near, far


def _name(folder: Path, number: int, folders: Sequence[Path]) -> str:
    name = folder.resolve().name
    alike = sum(other.resolve().name == name for other in folders)
    return f"{name}_{number + 1}" if alike > 1 or name in ("cloud", "limb") else name
