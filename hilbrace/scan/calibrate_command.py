"""``hilbrace scan calibrate``: camera and projector from pictures of a board."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from hilbrace.errors import HilbraceError, InputError
from hilbrace.run.progress import Report, display, silent
from hilbrace.scan.board import FORMS, Board, parse_board
from hilbrace.scan.calibrate import SeenBoard, calibrate_pair, see_board
from hilbrace.scan.calibration import Calibration, save_calibration
from hilbrace.scan.capture import SUFFIXES, open_capture
from hilbrace.scan.decode import decode_capture
from hilbrace.scan.patterns import MANIFEST, PatternPlan, read_manifest

EXAMPLE = "hilbrace scan calibrate captures --patterns patterns --board charuco:7x5:30:22"
GOOD_COVER = 0.5
"""Part of the camera's picture that corners should span [-]."""


def add_options(command: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    command.add_argument(
        "captures", type=Path, nargs="+", metavar="FOLDER", help="one folder a pose, or a folder of such"
    )
    add_patterns_option(command)
    command.add_argument("--board", required=True, metavar="BOARD", help=FORMS)
    command.add_argument(
        "--out", type=Path, default=Path("calibration.toml"), metavar="FILE", help="(calibration.toml)"
    )
    command.epilog = f"example: {EXAMPLE}"


def add_patterns_option(command: argparse.ArgumentParser) -> None:
    """The folder of patterns, for commands that read pictures of them."""
    command.add_argument(
        "--patterns",
        type=Path,
        metavar="DIR",
        help="folder that was projected (default: a manifest.json beside the pictures, or patterns)",
    )


def patterns_folder(named: Path | None, captures: list[Path]) -> Path:
    """The folder with the list of patterns: the one named, else that of the pictures or the one around it."""
    if named is not None:
        return named
    around = (folder for capture in captures for folder in (capture, capture.resolve().parent))
    return next((folder for folder in around if (folder / MANIFEST).is_file()), Path("patterns"))


def act(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Calibrate; figures, and what to tell a person."""
    plan, board = (
        read_manifest(patterns_folder(options.patterns, options.captures)),
        parse_board(options.board),
    )
    folders = pose_folders(options.captures)
    with display(Console(stderr=True, quiet=options.json or not sys.stderr.isatty()), "poses") as progress:
        seen, refused, size = see_poses(folders, plan, board, progress)
    try:
        calibration, odd = calibrate_pair(seen, board, size, (plan.width, plan.height))
    except InputError as fault:
        raise InputError(
            fault.what + "".join(f"; {name}: {why}" for name, why in refused.items()),
            where=fault.where if fault.where != "calibration" else ", ".join(map(str, options.captures)),
            hint=fault.hint,
        ) from None
    options.out.parent.mkdir(parents=True, exist_ok=True)
    save_calibration(calibration, options.out)
    cover = covered(seen, size)
    figures = {
        "file": str(options.out),
        "rms_px": calibration.rms_px,
        "camera_rms_px": calibration.camera.rms_px,
        "projector_rms_px": calibration.projector.rms_px,
        "base_mm": calibration.base_mm,
        "cover": cover,
        "poses": [asdict(pose) for pose in calibration.poses],
        "left_out": {**refused, **{name: "does not fit the other poses" for name in odd}},
    }
    return figures, _text(calibration, figures["left_out"], cover, options.out)


def pose_folders(named: list[Path]) -> list[Path]:
    """Folders of pictures: those named, or the folders inside them.

    Raises:
        InputError: A folder does not exist, or there are neither pictures nor folders in it.
    """
    found = []
    for folder in named:
        if not folder.is_dir():
            raise InputError("no such folder", where=str(folder), hint="name folders of pictures")
        inside = sorted(path for path in folder.iterdir() if path.is_dir() and path.name[0] != ".")
        pictures = any(path.suffix.lower() in SUFFIXES for path in folder.iterdir())
        if not pictures and not inside:
            raise InputError(
                "the folder holds neither pictures nor folders of pictures",
                where=str(folder),
                hint="store the pictures of each pose of the board in a folder of its own",
            )
        found += [folder] if pictures else inside
    return found


def see_poses(
    folders: list[Path], plan: PatternPlan, board: Board, progress: Report = silent
) -> tuple[list[SeenBoard], dict[str, str], tuple[int, int]]:
    """The board in every folder, why others cannot be used, and the size of the pictures.

    Raises:
        InputError: The poses have pictures of different sizes.
    """
    seen: list[SeenBoard] = []
    refused: dict[str, str] = {}
    size, first = (0, 0), ""
    for number, folder in enumerate(folders):
        progress(number, len(folders))
        try:
            capture = open_capture(folder, plan)
            if first and capture.size != size:
                raise InputError(
                    f"pictures of {capture.size[0]} x {capture.size[1]} pixels, those of {first} have"
                    f" {size[0]} x {size[1]}",
                    where=str(folder),
                    hint="photograph all poses with the same settings",
                )
            seen.append(see_board(decode_capture(capture), board, folder))
            size, first = capture.size, folder.name
        except HilbraceError as fault:
            refused[folder.name] = f"{fault.what} [{fault.where}]"
    return seen, refused, size


def covered(seen: list[SeenBoard], size: tuple[int, int]) -> float:
    """Part of the camera's picture that the box around all corners spans [-]."""
    corners = np.concatenate([pose.camera for pose in seen])
    return float(np.prod(np.ptp(corners, axis=0) / size))


def _text(calibration: Calibration, left_out: dict[str, str], cover: float, out: Path) -> str:
    lines = ["pose                corners   camera px   projector px"]
    lines += [
        f"{pose.folder:<18} {pose.corners:>8} {pose.camera_px:>11.3f} {pose.projector_px:>14.3f}"
        for pose in calibration.poses
    ]
    lines += [f"{name}: left out, {why}" for name, why in left_out.items()]
    lines.append(
        f"camera {calibration.camera.rms_px:.3f} px, projector {calibration.projector.rms_px:.3f} px,"
        f" base {calibration.base_mm:.1f} mm"
    )
    if cover < GOOD_COVER:
        lines.append(
            f"note: the corners span {100 * cover:.0f} % of the picture; hold the board wherever the"
            " limb will be"
        )
    lines += [f"written: {out}", f"then: hilbrace scan decode leg_front leg_left --calibration {out}", ""]
    return "\n".join(lines)
