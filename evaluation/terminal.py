"""Results on a terminal."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluation.comparison import EVENTS, TABLE_PLANES
from evaluation.measure import MeasuredStudy
from evaluation.results import StudyResult
from evaluation.tables import table_cells
from evaluation.verification import TOLERANCE_DEG, JointCheck
from hilbrace.errors import InputError


def print_table(result: StudyResult, folder: Path) -> None:
    """Print the paper's table with signed degrees, intervals and published values, and the warnings.

    Args:
        result: The compared conditions.
        folder: Where the files were written.
    """
    console = _plain()
    settings = result.measured.study.settings
    if settings.synthetic:
        console.print("Synthetic trials: a reproduction of the processing, never of the measurement.")
    table = Table(
        title="Squared degrees by the paper's method; signed degrees and their 95 % interval", box=None
    )
    table.add_column("condition")
    for event in EVENTS:
        for plane in TABLE_PLANES:
            table.add_column(f"{event}\n{plane}", justify="right", no_wrap=True)
    cells = [cell for cell in table_cells(result) if cell["method"] == "paper"]
    for start in range(0, len(cells), 4):
        row = cells[start : start + 4]
        table.add_row(row[0]["condition"], *(_squared(cell) for cell in row))
        table.add_row("", *(Text(f"{cell['signed_deg']:+.1f} deg", style="dim") for cell in row))
        table.add_row("", *(Text(_interval(cell), style="dim") for cell in row))
        if row[0]["published_deg2"] is not None:
            published = (f"paper {cell['published_deg2']:.3f}" for cell in row)
            table.add_row("", *(Text(text, style="dim") for text in published))
    console.print(table)
    for warning in result.warnings:
        console.print(f"- {warning}", soft_wrap=True)
    for label, name in (("report", "report.html"), ("table", "table.csv"), ("events", "events.toml")):
        console.print(f"{label:<7} {folder / name}", soft_wrap=True)


def print_trials(measured: MeasuredStudy, folder: Path) -> None:
    """Print the quality of every trial and where its angles are.

    Args:
        measured: The tracked trials.
        folder: Where the files were written.
    """
    console = _plain()
    table = Table(box=None)
    for name in ("trial", "frames", "thigh mm", "shank mm", "knee gap mm", "known", "filled"):
        table.add_column(name, justify="left" if name == "trial" else "right")
    for trial in measured.trials:
        quality = trial.quality
        table.add_row(
            trial.name,
            str(len(trial.motion.time)),
            f"{quality.residual_mm['thigh']:.1f}",
            f"{quality.residual_mm['shank']:.1f}",
            f"{quality.knee_gap_mm:.1f}",
            f"{100 * quality.known:.1f} %",
            str(quality.filled_by_cluster + quality.filled_by_spline),
        )
    console.print(table)
    for trial in measured.trials:
        for flag in trial.quality.flags:
            console.print(f"- {trial.name}: {flag}", soft_wrap=True)
    for note in measured.notes:
        console.print(f"- {note}", soft_wrap=True)
    console.print(f"angles  {folder}", soft_wrap=True)


def print_checks(
    checks: list[tuple[Path, JointCheck]], refused: list[tuple[Path, InputError]], notes: list[str]
) -> None:
    """Print how well stored angles are reproduced, file by file.

    Args:
        checks: File and comparison.
        refused: File and why it could not be compared.
        notes: What else could not be compared, one sentence each.
    """
    console = _plain()
    title = f"Stored Plug-in Gait angles against ours (tolerance {TOLERANCE_DEG:g} deg)"
    table = Table(title=title, box=None)
    for name in ("file", "angles", "ours from", "frames", "RMS [deg]", "largest [deg]", ""):
        right = "deg" in name or name == "frames"
        table.add_column(name, justify="right" if right else "left", overflow="fold")
    for path, check in checks:
        table.add_row(
            path.name,
            check.name,
            check.source,
            str(check.frames),
            f"{check.rms_deg.max():.6f}",
            f"{check.largest_deg.max():.6f}",
            "reproduced" if check.agrees else Text("DIFFERS", style="bold red"),
        )
    console.print(table)
    for note in notes:
        console.print(f"- {note}", soft_wrap=True)
    for path, fault in refused:
        console.print(f"{path.name}: {fault.what}\n  mend: {fault.hint}", soft_wrap=True)


def _plain() -> Console:
    """A terminal that shows names as they are, with whatever brackets and colons are in them."""
    return Console(markup=False, emoji=False, highlight=False)


def _squared(cell: dict) -> Text:
    return Text(f"{cell['squared_deg2']:.2f}", style="bold" if cell["best"] else "")


def _interval(cell: dict) -> str:
    if cell["ci_low_deg"] is None:
        return ""
    return f"[{cell['ci_low_deg']:+.1f}, {cell['ci_high_deg']:+.1f}]"
