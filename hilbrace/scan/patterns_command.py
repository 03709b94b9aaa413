"""``hilbrace scan patterns``: what the projector shows, and the board for the calibration."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Any

from hilbrace.errors import ConfigError
from hilbrace.scan.board import parse_board, write_board
from hilbrace.scan.patterns import PatternPlan, checked_plan, write_patterns

EXAMPLE = "hilbrace scan patterns --out patterns --projector 1280x720"


def add_options(command: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    plan = PatternPlan(0, 0)
    command.add_argument(
        "--projector", required=True, metavar="WIDTHxHEIGHT", help="pixels that the projector shows"
    )
    command.add_argument(
        "--period",
        type=int,
        default=plan.period,
        metavar="PX",
        help=f"of the cosine (default: {plan.period})",
    )
    command.add_argument(
        "--steps",
        type=int,
        default=plan.steps,
        metavar="N",
        help=f"shifts of the cosine; 0 for Gray code alone (default: {plan.steps})",
    )
    command.add_argument(
        "--board",
        default="charuco:7x5:30:22",
        metavar="BOARD",
        help="board to print: charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM or chessboard:COLUMNSxROWS:SQUARE_MM,"
        " inner corners (default: charuco:7x5:30:22)",
    )
    command.add_argument(
        "--out",
        type=Path,
        default=Path("patterns"),
        metavar="DIR",
        help="folder to write (default: patterns)",
    )
    command.epilog = f"example: {EXAMPLE}"


def act(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Write the patterns and the board; figures, and what to tell a person."""
    width, height = _pixels(options.projector)
    plan = checked_plan(width, height, options.period, options.steps)
    board = parse_board(options.board)
    files = write_patterns(plan, options.out)
    files += write_board(board, options.out)
    pictures = sum(name.endswith(".png") and name[:3].isdigit() for name in files)
    figures = {"folder": str(options.out), "pictures": pictures, "board": board.text, "files": files}
    text = (
        f"{pictures} pictures for a projector of {width} x {height} pixels in {options.out}\n"
        f"{options.out / 'board.pdf'}: print at 100 %, measure a square, glue it to something flat\n"
        f"read {options.out / 'README.txt'}: how to take the pictures\n"
        "then: hilbrace scan calibrate captures --patterns"
        f" {options.out} --board {board.text}\n"
    )
    return figures, text


def _pixels(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip().lower())
    if not match:
        raise ConfigError(
            f"'{text}' is no size of a picture", where="--projector", hint="write it as 1280x720"
        )
    return int(match[1]), int(match[2])
