"""The folder of a mold: made beside the old one and put in its place when all is written."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fabrication.build import Step, quietly
from fabrication.checks import Check, check_mold
from fabrication.export import write_glb, write_stl_files
from fabrication.fixtures.cad import write_step
from fabrication.mold import Mold
from fabrication.pictures import write_pictures
from fabrication.printable import Printable, printable
from fabrication.printers import Printer
from fabrication.slicer import Slicing, required_slicer, slice_piece
from fabrication.three_mf import write_3mf
from fabrication.worksheet import worksheet
from hilbrace.config.mold import MoldSettings
from hilbrace.errors import GeometryError, InputError
from hilbrace.run.folder import METRICS, write_json
from hilbrace.run.records import write_atomic


@dataclass(frozen=True)
class MoldResult:
    """A mold with its proof and its files.

    Attributes:
        mold: The mold.
        pieces: Its pieces as exported.
        checks: Every figure by name.
        slicings: Time and filament by piece, where the slicer was asked.
        printer: What prints it.
    """

    mold: Mold
    pieces: tuple[Printable, ...]
    checks: dict[str, Check]
    slicings: dict[str, Slicing]
    printer: Printer

    @property
    def failed(self) -> tuple[Check, ...]:
        """Checks that do not hold."""
        return tuple(check for check in self.checks.values() if not check.passed)

    def failure(self, folder: Path) -> GeometryError | None:
        """The first check that does not hold, as an error to show; ``None`` of a sound mold."""
        if not self.failed:
            return None
        first, count = self.failed[0], len(self.failed)
        more = f" (and {count - 1} more)" if count > 1 else ""
        at = f", {first.where}" if first.where else ""
        return GeometryError(
            f"the mold fails '{first.name}': {first.value:.4g}, {first.rule}{more}",
            where=f"{folder / 'checks.json'}{at}",
            hint=first.mend,
        )

    def figures(self) -> dict[str, Any]:
        """Group ``mold`` of the metrics."""
        values = {name: _plain(check.value) for name, check in self.checks.items()}
        overlap = max(values["core_overlap_mm3"], values["shell_overlap_mm3"])
        return values | {
            "max_overlap_mm3": overlap,
            "passed": not self.failed,
            "vents": len(self.mold.filling.vents),
            "printer": self.printer.name,
            "pieces_by_name": {piece.piece.name: _size(piece) for piece in self.pieces},
        }

    def content(self, folder: Path) -> dict[str, Any]:
        """What ``--json`` prints."""
        return {
            "mold": self.mold.casting.name,
            "passed": not self.failed,
            "failed": [check.name for check in self.failed],
            "metrics": self.figures(),
            "folder": str(folder),
        }


def write_mold(
    folder: Path,
    mold: Mold,
    printer: Printer,
    settings: MoldSettings,
    slice_pieces: bool = False,
    step: Step = quietly,
) -> MoldResult:
    """Prove a mold and write everything that belongs to it; an older mold in the folder is replaced.

    Args:
        folder: Folder of the mold.
        mold: The closed mold.
        printer: What prints it.
        settings: Section ``mold``.
        slice_pieces: Let PrusaSlicer tell time and filament.
        step: Opened around each step.

    Raises:
        ConfigError: PrusaSlicer is asked for and not there.
        InputError: The folder cannot be written, or holds something else.
    """
    if slice_pieces:
        required_slicer()
    with replaced(folder) as fresh:
        with step("pieces"):
            pieces = tuple(printable(piece) for piece in mold.pieces)
        with step("checks"):
            checks = check_mold(mold, pieces, printer)
        with step("files"):
            (fresh / "stl").mkdir()
            files = write_stl_files(fresh / "stl", pieces)
            write_3mf(fresh / "mold.3mf", mold.casting.name, pieces)
            write_glb(fresh / "mold.glb", mold)
            write_step(fresh / "fixtures.step", mold.drawn)
        slicings: dict[str, Slicing] = {}
        if slice_pieces:
            for piece, file in zip(pieces, files, strict=True):
                with step(f"slice {piece.piece.name}"):
                    slicings[piece.piece.name] = slice_piece(file, printer)
        result = MoldResult(mold, pieces, checks, slicings, printer)
        with step("pictures"):
            (fresh / "pictures").mkdir()
            pictures = write_pictures(fresh / "pictures", mold)
        page = worksheet(result, settings, pictures)
        write_atomic(fresh / "worksheet.html", page.encode())
        write_json(fresh / "checks.json", _checks_content(result))
    return result


def record_metrics(run: Path, result: MoldResult) -> None:
    """Put the mold's figures into the metrics of a run.

    Args:
        run: The run folder.
        result: The mold.

    Raises:
        InputError: The metrics are damaged.
    """
    path = run / METRICS
    try:
        metrics = json.loads(path.read_text("utf-8")) if path.exists() else {}
    except ValueError as fault:
        raise InputError(f"damaged: {fault}", where=str(path), hint="run the folder again") from None
    write_json(path, metrics | {"mold": result.figures()})


def _checks_content(result: MoldResult) -> dict[str, Any]:
    return {
        "mold": result.mold.casting.name,
        "note": "research software, not a medical device",
        "passed": not result.failed,
        "checks": {
            name: {
                "value": _plain(check.value),
                "rule": check.rule,
                "limit": check.limit,
                "passed": check.passed,
                "means": check.means,
                "mend": check.mend,
                "where": check.where,
            }
            for name, check in result.checks.items()
        },
        "metrics": result.figures(),
        "pictures": {
            "exploded view": "pictures/exploded.png",
            "section through the cavity": "pictures/section.png",
            "undercut map": "pictures/undercut.png",
        },
    }


def _size(piece: Printable) -> dict[str, Any]:
    width, depth, height = (round(length, 2) for length in piece.size)
    return {
        "width_mm": width,
        "depth_mm": depth,
        "height_mm": height,
        "volume_ml": round(piece.volume_mm3 / 1000.0, 2),
        "triangles": len(piece.triangles),
    }


def _plain(value: float) -> float | int:
    return int(value) if float(value).is_integer() else float(f"{value:.6g}")


@contextmanager
def replaced(folder: Path) -> Iterator[Path]:
    """A fresh folder that takes the place of the old one when the work has ended well.

    Args:
        folder: The folder to make or to replace.

    Raises:
        InputError: It holds something that is no mold, or cannot be made.
    """
    if folder.exists() and not (folder / "checks.json").exists() and any(folder.iterdir()):
        raise InputError(
            "the folder is not empty and holds no mold", where=str(folder), hint="give another --out"
        )
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    except OSError as fault:
        raise InputError(
            f"cannot make the folder: {fault.strerror}", where=str(folder), hint="give another --out"
        ) from None
    try:
        fresh.chmod(0o755)
        yield fresh
        if folder.exists():
            old = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}.old."))
            folder.replace(old / "mold")
            fresh.replace(folder)
            shutil.rmtree(old)
        else:
            fresh.replace(folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
