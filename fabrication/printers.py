"""Printers: their beds, and how finely and how loosely they print."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Literal

from hilbrace.config import MoldSettings
from hilbrace.errors import ConfigError

Process = Literal["fdm", "sla"]

MARGIN_MM = 10.0
"""What a piece leaves free of the bed's width, depth and height."""


@dataclass(frozen=True)
class Printer:
    """A printer.

    Attributes:
        name: Key of ``mold.printer``.
        title: What a person calls it.
        process: ``fdm`` lays down beads of molten plastic, ``sla`` cures resin.
        width_mm: Bed, left to right [mm].
        depth_mm: Bed, front to back [mm].
        height_mm: Tallest part [mm].
        clearance_mm: Gap on each side between parts that slide into each other [mm].
        min_wall_mm: Thinnest wall that prints [mm].
        overhang_deg: Faces flatter than this, seen from below, need support: angle to the bed [deg].
        bridge_mm: Longest span that prints without support [mm].
        layer_mm: Height of a layer [mm].
        material: What the mold is printed from.
    """

    name: str
    title: str
    process: Process
    width_mm: float
    depth_mm: float
    height_mm: float
    clearance_mm: float = 0.2
    min_wall_mm: float = 0.8
    overhang_deg: float = 45.0
    bridge_mm: float = 5.0
    layer_mm: float = 0.3
    material: str = "PLA or PETG"

    @property
    def usable_mm(self) -> tuple[float, float, float]:
        """Width, depth and height that a piece may take: the bed less a margin [mm]."""
        return self.width_mm - MARGIN_MM, self.depth_mm - MARGIN_MM, self.height_mm - MARGIN_MM


SLA = {
    "clearance_mm": 0.1,
    "min_wall_mm": 0.5,
    "overhang_deg": 19.0,
    "bridge_mm": 5.0,
    "layer_mm": 0.1,
    "material": "standard resin, washed, cured for long and sealed",
}
"""What differs where resin is cured: 0.1 mm in a sliding fit, walls of 0.5 mm, support for faces up to 19
degrees from level (Formlabs' design guide)."""

PRINTERS = {
    printer.name: printer
    for printer in (
        Printer("prusa_mk4", "Prusa MK4", "fdm", 250, 210, 220),
        Printer("bambu_x1", "Bambu Lab X1 or P1", "fdm", 256, 256, 256),
        Printer("ender3", "Creality Ender-3", "fdm", 220, 220, 250),
        replace(Printer("formlabs_form3", "Formlabs Form 3", "sla", 145, 145, 185), **SLA),
    )
}
"""Printers by their key, with the build volumes that their makers state."""

SMALLEST_BED_MM, LARGEST_BED_MM = 50.0, 2000.0


def profile(settings: MoldSettings) -> Printer:
    """The printer of a configuration.

    Args:
        settings: Section ``mold``; ``printer`` names a profile or gives a bed as ``250x210x220``.

    Returns:
        Its profile. A bed of one's own prints by ``mold.process``, ``fdm`` unless said otherwise.

    Raises:
        ConfigError: No such printer, a bed that no printer has, or a process that the printer does not know.
    """
    known = PRINTERS.get(settings.printer)
    if known is None:
        return custom_bed(settings.printer, settings.process or "fdm")
    if settings.process not in (None, known.process):
        raise ConfigError(
            f"a {known.title} prints by {known.process}, not by {settings.process}",
            where="mold.process",
            hint=f"leave mold.process out, or give the bed of your printer as "
            f"{known.width_mm:g}x{known.depth_mm:g}x{known.height_mm:g}",
        )
    return known


def custom_bed(text: str, process: Process) -> Printer:
    """A printer that is known by its bed alone.

    Args:
        text: Width, depth and height in mm, such as ``250x210x220``.
        process: How it prints.

    Raises:
        ConfigError: The text is no bed, or one smaller than 50 mm or larger than 2 m.
    """
    match = re.fullmatch(r"\s*([\d.]+)\s*[xX*×]\s*([\d.]+)\s*[xX*×]\s*([\d.]+)\s*(?:mm)?\s*", text)
    try:
        width, depth, height = (float(part) for part in match.groups()) if match else (0.0, 0.0, 0.0)
    except ValueError:
        width = depth = height = 0.0
    if not all(SMALLEST_BED_MM <= length <= LARGEST_BED_MM for length in (width, depth, height)):
        raise ConfigError(
            f"no printer '{text}'",
            where="mold.printer",
            hint=f"use {', '.join(PRINTERS)}, or a bed in mm such as 250x210x220 "
            f"({SMALLEST_BED_MM:g} to {LARGEST_BED_MM:g} each)",
        )
    title = f"Printer with a bed of {width:g} x {depth:g} x {height:g} mm"
    printer = Printer(f"{width:g}x{depth:g}x{height:g}", title, process, width, depth, height)
    return replace(printer, **SLA) if process == "sla" else printer
