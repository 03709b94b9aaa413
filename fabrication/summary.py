"""What came out of a mold, on one screen."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from fabrication.files import MoldResult
from fabrication.worksheet import silicone_needed


def print_mold(result: MoldResult, folder: Path) -> None:
    """Print pieces, checks, and where the files are.

    Args:
        result: The mold with its proof.
        folder: Where the files are.
    """
    console = Console(markup=False, emoji=False, highlight=False)
    pieces = Table(box=None, pad_edge=False)
    for name in ("piece", "on the bed [mm]", "[ml]"):
        pieces.add_column(name, justify="left" if name == "piece" else "right")
    for piece in result.pieces:
        size = " x ".join(f"{length:.0f}" for length in piece.size)
        pieces.add_row(piece.piece.title, size, f"{piece.volume_mm3 / 1000:.0f}")
    console.print(pieces)
    checks = Table(box=None, pad_edge=False)
    for name in ("check", "found", "limit", ""):
        checks.add_column(name, justify="right" if name == "found" else "left")
    for check in result.checks.values():
        verdict = Text("ok") if check.passed else Text("FAILS", style="bold red")
        checks.add_row(check.name, f"{check.value:.4g}", check.rule, "" if check.limit is None else verdict)
    console.print(checks)
    silicone = silicone_needed(result.mold)
    console.print(
        f"silicone  {silicone.component_g:.0f} g of A and {silicone.component_g:.0f} g of B, Shore 30A"
    )
    for label, name in (("sheet", "worksheet.html"), ("print", "mold.3mf"), ("proof", "checks.json")):
        console.print(f"{label:<9} {folder / name}", soft_wrap=True)
