"""Everything that is proved of a mold before anyone prints it, each as one named figure with its limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fabrication.cavity import measure_cavity
from fabrication.filling import trapped_maxima
from fabrication.mold import Mold, Piece
from fabrication.parting import MOST_UNDERCUT
from fabrication.printable import Printable
from fabrication.printers import Printer
from fabrication.removal import collision
from fabrication.thickness import thinnest_wall

VOLUME_ERROR = 2e-3
"""Largest relative difference between the cavity and the brace: chords of the limb's mesh make 3e-4."""

DEPTH_ERROR_MM = 0.25
"""Largest difference between the depth of the cavity and the thickness of the brace [mm]: about a layer."""

CORE_OVERLAP_MM3 = 2.0
"""Largest overlap of core and shells [mm^3]: rounding along a thousand square centimetres of contact."""

TOUCH_MM3 = 1e-3
"""Overlap that two bodies which only touch may show [mm^3]."""

CHANNEL_MM = 1.0
"""Narrowest channel that fills: silicone of 20 Pa s at 1 mm/s loses 12 * 20 * 0.001 / 0.001^2 Pa/m, that is
5 kPa on 20 mm of a slit 1 mm wide, which a hand on a syringe has to spare."""

REACH_MM = 12.0
"""Walls thicker than this are not measured [mm]."""

RESTING_MM = 0.3
"""Faces this close to the bed rest on it [mm]."""


@dataclass(frozen=True)
class Check:
    """One figure of a mold.

    Attributes:
        name: Its name in ``checks.json``, unit included.
        value: What was found.
        limit: What it may be at most, or must be at least; ``None`` of a figure that only informs.
        means: What it says, in one sentence.
        mend: What to change if it fails.
        least: The limit is the least value, not the largest.
        where: Pieces that it was found at, the worst first.
    """

    name: str
    value: float
    limit: float | None
    means: str
    mend: str
    least: bool = False
    where: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value keeps its limit."""
        if self.limit is None:
            return True
        return self.value >= self.limit if self.least else self.value <= self.limit

    @property
    def rule(self) -> str:
        """The limit in words: ``at most 2``."""
        if self.limit is None:
            return "for information"
        return f"{'at least' if self.least else 'at most'} {self.limit:g}"


def check_mold(mold: Mold, pieces: Sequence[Printable], printer: Printer) -> dict[str, Check]:
    """Prove a mold.

    Args:
        mold: The closed mold.
        pieces: Its pieces as they are exported.
        printer: What prints them.

    Returns:
        Every figure by its name, in the order in which they matter.
    """
    found = (
        *piece_checks(pieces, printer),
        *cavity_checks(mold),
        *closing_checks(mold),
        *opening_checks(mold),
        *wall_checks(mold, pieces, printer),
    )
    return {check.name: check for check in found}


def piece_checks(pieces: Sequence[Printable], printer: Printer) -> tuple[Check, ...]:
    """Each piece by itself: one part, watertight, fits the bed."""
    broken = [piece for piece in pieces if piece.parts != 1 or piece.voids]
    leaky = [piece for piece in pieces if piece.open_edges]
    large = [piece for piece in pieces if not fits(piece, printer)]
    return (
        Check("pieces", len(pieces), None, "Pieces to print.", ""),
        Check(
            "pieces_not_in_one_part", len(broken), 0,
            "Pieces that fall apart or enclose a hollow that nothing leads into.",
            "change mold.wall_mm or mold.flange_mm a little", where=_names(broken),
        ),
        Check(
            "pieces_not_watertight", len(leaky), 0,
            "Pieces whose STL file, read back in single precision, has an open edge.",
            "change mold.resolution_mm a little", where=_names(leaky),
        ),
        Check(
            "pieces_larger_than_bed", len(large), 0,
            f"Pieces that do not fit {printer.title}: {printer.width_mm:g} x {printer.depth_mm:g} x "
            f"{printer.height_mm:g} mm.",
            "name a larger printer in mold.printer, or make mold.flange_mm narrower", where=_names(large),
        ),
    )  # fmt: skip


def fits(piece: Printable, printer: Printer) -> bool:
    """Whether a piece fits the printer as it stands, straight or turned by a quarter."""
    width, depth, height = piece.size
    bed = sorted(printer.usable_mm[:2])
    footprint = sorted((width, depth))
    return footprint[0] <= bed[0] and footprint[1] <= bed[1] and height <= printer.usable_mm[2]


def cavity_checks(mold: Mold) -> tuple[Check, ...]:
    """The cavity: its volume, its depth, that it hangs together, and that no air stays in it."""
    cavity = measure_cavity(mold)
    trapped = trapped_maxima(mold.casting.brace, mold.core, mold.filling.up)
    vents = mold.filling.vents
    free = [
        maximum
        for maximum in trapped
        if not len(vents) or np.linalg.norm(vents - maximum.point, axis=1).min() > 1e-6
    ]
    return (
        Check(
            "cavity_volume_error", cavity.volume_error, VOLUME_ERROR,
            f"The cavity holds {cavity.volume_mm3 / 1e3:.2f} ml, the brace {cavity.brace_mm3 / 1e3:.2f} ml.",
            "make mold.resolution_mm finer",
        ),
        Check(
            "cavity_depth_error_mm", cavity.depth_error_mm, DEPTH_ERROR_MM,
            "Depth of the grooves against the thickness of the brace, 99 of 100 places.",
            "make mold.resolution_mm finer",
        ),
        Check(
            "cavities", cavity.parts, 1,
            "Cavities that do not hang together: from one, silicone reaches all of the brace and the gutter.",
            "cast the parts of the brace one by one",
        ),
        Check(
            "trapped_maxima", len(free), 0,
            f"Places where air stays in pockets deeper than 0.4 mm; {len(vents)} more have vents.",
            "look at the undercut map: drill a vent of 1.6 mm there",
        ),
    )  # fmt: skip


def closing_checks(mold: Mold) -> tuple[Check, ...]:
    """The closed mold: no two pieces share room."""
    with_core, between = [0.0], [0.0]
    for first, second in combinations(mold.pieces, 2):
        shared = (first.solid ^ second.solid).volume()
        (with_core if "core" in (first.kind, second.kind) else between).append(shared)
    return (
        Check(
            "core_overlap_mm3", max(with_core), CORE_OVERLAP_MM3,
            "Largest overlap of a core piece with any other piece of the closed mold.",
            "change mold.resolution_mm a little",
        ),
        Check(
            "shell_overlap_mm3", max(between), TOUCH_MM3,
            "Largest overlap of any two other pieces of the closed mold.",
            "change mold.shells or mold.flange_mm",
        ),
    )  # fmt: skip


def opening_checks(mold: Mold) -> tuple[Check, ...]:
    """The way apart: every piece comes off, and how much of the shells had to be relieved."""
    worst = {piece.name: _collision(piece, mold) for piece in mold.pieces if piece.pull is not None}
    return (
        Check(
            "removal_collision_mm3", max(worst.values(), default=0.0), TOUCH_MM3,
            "Largest overlap of a piece with the others while it comes off, 0.25 to 128 mm along its pull.",
            "use another number of shells (mold.shells)",
            where=max(worst, key=lambda name: worst[name]) if worst else "",
        ),
        Check(
            "undercut_area_mm2", sum(mold.undercut.values()), MOST_UNDERCUT * _area(mold),
            "Area of the shells' inner faces that leans more than a degree against the pull; it is relieved.",
            "use another number of shells (mold.shells)",
        ),
    )  # fmt: skip


def _collision(piece: Piece, mold: Mold) -> float:
    """The base is taken away first, then everything else comes off while all the others stay."""
    others = (other for other in mold.pieces if other is not piece)
    staying = [other for other in others if piece.kind == "base" or other.kind != "base"]
    return collision(piece, staying, piece.pull)


def _area(mold: Mold) -> float:
    """Area of the surface that the shells lie on [mm^2]."""
    corners = mold.casting.outer[mold.casting.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * float(np.linalg.norm(normals, axis=1).sum())


def wall_checks(mold: Mold, pieces: Sequence[Printable], printer: Printer) -> tuple[Check, ...]:
    """What a printer and silicone ask of thickness: walls, channels, overhangs."""
    walls = {piece.name: _thinnest(piece, mold) for piece in mold.pieces}
    thinnest = min(walls, key=lambda name: walls[name])
    channel = thinnest_wall(mold.casting.brace, REACH_MM)
    overhang = {piece.piece.name: overhang_mm2(piece, printer) for piece in pieces}
    return (
        Check(
            "min_wall_mm", walls[thinnest], printer.min_wall_mm,
            f"Thinnest wall of any piece; {printer.title} prints {printer.min_wall_mm:g} mm.",
            "widen pattern.min_slit_mm, or print with a finer nozzle", least=True, where=thinnest,
        ),
        Check(
            "min_channel_mm", channel, CHANNEL_MM,
            "Narrowest channel of the cavity: a strut's width or the brace's thickness.",
            "widen pattern.min_strut_mm", least=True,
        ),
        Check(
            "overhang_area_mm2", sum(overhang.values()), None,
            f"Faces flatter than {printer.overhang_deg:g} degrees seen from below, as pieces are printed.",
            "", where=max(overhang, key=lambda name: overhang[name]),
        ),
    )  # fmt: skip


def _thinnest(piece: Piece, mold: Mold) -> float:
    """Thinnest wall of a piece, away from the parts that it is glued to [mm]."""
    whole = piece.name.split("_part")[0]
    parts = [each.solid for each in mold.pieces if each is not piece and each.name.split("_part")[0] == whole]
    return thinnest_wall(piece.solid, REACH_MM, glued_to=parts)


def overhang_mm2(piece: Printable, printer: Printer) -> float:
    """Area that hangs over more flatly than the printer can build without support [mm^2]."""
    corners = piece.vertices.astype(float)[piece.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    down = -0.5 * normal[:, 2] > np.cos(np.deg2rad(printer.overhang_deg)) * area
    return float(area[down & (corners[..., 2].max(axis=1) > RESTING_MM)].sum())


def _names(pieces: Sequence[Printable]) -> str:
    return ", ".join(piece.piece.name for piece in pieces)
