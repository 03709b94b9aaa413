"""Pieces larger than the printer's bed, cut into parts that fit it and that dowel pins bring together again.

Cuts run across the limb, at heights that stay clear of bolts, keys, ports and vents, and not at the height of
another shell's cut, so that each joint is bridged by the shell beside it. They contain the way in which their
piece comes off: a part slides off along its own cut. Where a part is still too wide, it is cut lengthwise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold

from fabrication.bodies import mesh_of
from fabrication.dowel_sites import Sites, core_sites, shell_sites
from fabrication.fixtures.cad import Placed
from fabrication.fixtures.dowel import dowels, placed_dowels
from fabrication.mold import Core, Hardware, Piece
from fabrication.print_pose import best_pose
from fabrication.printers import Printer
from hilbrace.config.mold import MoldSettings
from hilbrace.errors import GeometryError

Array = np.ndarray

CLEAR_MM = 10.0
"""A cut this far from bolts, keys and holes is clear of them [mm]."""

LEAST_CLEAR_MM = 6.5
"""A cut never comes closer to them than this: the radius of a washer's seat and a wall [mm]."""

STAGGER_MM = 20.0
"""Cuts of different shells keep this distance where they can [mm]."""

LEVEL_MM = 0.5
"""Steps in which heights are tried [mm]."""

TRIES = 12
"""Heights that are tried before a piece counts as one that cannot be cut."""

DUST_MM3 = 1.0
"""Crumbs that rounding leaves beside a part, all together [mm^3]."""

DEEPEST = 4
"""Most times that a part is cut again."""


@dataclass(frozen=True)
class Split:
    """Pieces that fit the bed.

    Attributes:
        pieces: The parts, in the order of the pieces; a piece that fits is left as it is. Parts are called
            ``<piece>_part1``, ``_part2`` and so on, from the lower end.
        hardware: Dowel pins to buy.
        drawn: Their holes, for the STEP file.
    """

    pieces: tuple[Piece, ...]
    hardware: tuple[Hardware, ...]
    drawn: tuple[Placed, ...]


@dataclass(frozen=True)
class Cut:
    """A plane that parts a piece.

    Attributes:
        normal: Unit normal, from the lower part to the upper one.
        level: Coordinate of the plane along it [mm].
    """

    normal: Float[Array, "3"]
    level: float

    def along(self, normal: Float[Array, "3"]) -> bool:
        """Whether this cut lies across nearly the same direction."""
        return abs(float(self.normal @ normal)) > 0.9


def split_for_bed(
    pieces: Sequence[Piece],
    printer: Printer,
    core: Core,
    settings: MoldSettings,
    avoid: Float[Array, "point 3"] | None = None,
) -> Split:
    """Cut what does not fit the printer's bed.

    Args:
        pieces: Pieces with all their holes.
        printer: The printer.
        core: The core: its axis is across the cuts, and bosses around dowel pins are hollowed by its land.
        settings: Section ``mold``: wall of the shells, clearance.
        avoid: Points that cuts and pins stay clear of: bolts, keys, jack slots, port, vents [mm].

    Raises:
        GeometryError: A piece cannot be cut so that it fits.
    """
    avoid = np.zeros((0, 3)) if avoid is None else np.asarray(avoid, float).reshape(-1, 3)
    work = _Splitter(printer, core, settings, avoid, tuple(pieces))
    out: list[Piece] = []
    for piece in pieces:
        parts = work.parts(piece, 0)
        out += parts if len(parts) == 1 else _numbered(piece, parts)
    return Split(tuple(out), tuple(work.hardware), tuple(work.drawn))


class _Splitter:
    """Cuts pieces one after the other and remembers where."""

    def __init__(
        self,
        printer: Printer,
        core: Core,
        settings: MoldSettings,
        avoid: Float[Array, "point 3"],
        pieces: tuple[Piece, ...],
    ) -> None:
        self.printer, self.core, self.settings, self.avoid, self.pieces = (
            printer,
            core,
            settings,
            avoid,
            pieces,
        )
        self.cuts: list[tuple[str, Cut]] = []
        self.hardware: list[Hardware] = []
        self.drawn: list[Placed] = []

    def parts(self, piece: Piece, depth: int) -> list[Piece]:
        """A piece, cut until every part fits."""
        if piece.kind not in ("core", "shell") or best_pose(piece, self.printer, self.core.axis).fits:
            return [piece]
        if depth == DEEPEST:
            raise _too_large(piece, self.printer)
        normal, count = self._direction(piece)
        rest, out = piece, []
        for number in range(1, count):
            low, rest = self._cut(rest, normal, count - number)
            out += self.parts(low, depth + 1)
        return out + self.parts(rest, depth + 1)

    def _direction(self, piece: Piece) -> tuple[Array, int]:
        """Across which direction to cut, and into how many parts."""
        vertices, _ = mesh_of(piece.solid)
        along = _square(self.core.axis, piece.pull)
        tall = float(np.ptp(vertices @ along))
        if tall > self.printer.usable_mm[2]:
            return along, int(np.ceil(tall / self.printer.usable_mm[2]))
        if piece.pull is not None:
            return np.cross(along, piece.pull / np.linalg.norm(piece.pull)), 2
        flat = vertices - np.outer(vertices @ along, along)
        wide = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)[2][0]
        return _square(wide, along), 2

    def _cut(self, piece: Piece, normal: Array, remaining: int) -> tuple[Piece, Piece]:
        """Cut off the lowest part."""
        for level in list(self._levels(piece, normal, remaining))[:TRIES]:
            done = self._try(piece, Cut(normal, level))
            if done is not None:
                return done
        raise GeometryError(
            f"no height was found at which {piece.title.lower()} can be cut in two for the bed",
            where=f"{piece.name}, {self.printer.title}",
            hint="use a larger printer (mold.printer) or fewer bolts (mold.bolt_spacing_mm)",
        )

    def _levels(self, piece: Piece, normal: Array, remaining: int) -> Iterator[float]:
        """Heights for a cut, the best first: clear of holes and of other cuts, and parts of equal size."""
        heights = mesh_of(piece.solid)[0] @ normal
        low, high = float(heights.min()), float(heights.max())
        along = abs(float(normal @ _square(self.core.axis, piece.pull))) > 0.5
        room = self.printer.usable_mm[2] if along else max(self.printer.usable_mm[:2])
        least, most = max(low + LEVEL_MM, high - remaining * room), min(high - LEVEL_MM, low + room)
        if most <= least:
            least, most = low + LEVEL_MM, high - LEVEL_MM
        levels = np.arange(least, most, LEVEL_MM)
        holes = self.avoid @ normal
        clear = np.abs(levels[:, None] - holes).min(axis=1, initial=CLEAR_MM)
        others = np.array([cut.level for kind, cut in self.cuts if kind == piece.kind and cut.along(normal)])
        apart = np.abs(levels[:, None] - others).min(axis=1, initial=STAGGER_MM)
        even = np.abs(levels - (low + (high - low) / (remaining + 1))) / (high - low)
        cost = 2.0 * (1.0 - clear / CLEAR_MM) + (1.0 - apart / STAGGER_MM) + 2.0 * even
        order = np.argsort(np.where(clear >= LEAST_CLEAR_MM, cost, cost + 10.0), kind="stable")
        taken: list[float] = []
        for level in levels[order]:
            if all(abs(level - other) > 4 * LEVEL_MM for other in taken):
                taken.append(float(level))
                yield float(level)

    def _try(self, piece: Piece, cut: Cut) -> tuple[Piece, Piece] | None:
        """Both sides of a cut with the holes of their pins; ``None`` where they are no two bodies."""
        sites = self._sites(piece, cut)
        if sites is None:
            return None
        solid = piece.solid
        if not sites.bosses.is_empty():
            solid = solid + (sites.bosses - self.core.land)
            solid.volume()
        holes, hardware = dowels(sites.places, sites.diameter_mm, self.settings)
        upper, lower = (solid - holes).split_by_plane(tuple(cut.normal), cut.level)
        sides = [_whole(side) for side in (lower, upper)]
        if any(side is None for side in sides):
            return None
        self.cuts.append((piece.kind, cut))
        self.hardware += hardware
        self.drawn += placed_dowels(sites.places, sites.diameter_mm, self.settings)
        below, above = (replace(piece, solid=side) for side in sides if side is not None)
        return below, above

    def _sites(self, piece: Piece, cut: Cut) -> Sites | None:
        names = (f"{piece.name}, lower part", f"{piece.name}, upper part")
        if piece.kind == "core":
            return core_sites(piece.solid, cut.normal, cut.level, names)
        others = [other.solid for other in self.pieces if other.name != piece.name and other.kind == "shell"]
        return shell_sites(
            piece.solid, self.core.land, others, self.avoid, cut.normal, cut.level, names, self.settings
        )


def _whole(solid: Manifold) -> Manifold | None:
    """A body freed of crumbs; ``None`` if it is not one body."""
    parts = sorted(solid.decompose(), key=lambda part: part.volume(), reverse=True)
    if not parts or sum(abs(part.volume()) for part in parts[1:]) > DUST_MM3:
        return None
    return parts[0]


def _square(direction: Array, pull: Array | None) -> Float[Array, "3"]:
    """A direction freed of its part along a pull, as a unit vector."""
    direction = np.asarray(direction, float)
    if pull is not None:
        way = pull / np.linalg.norm(pull)
        direction = direction - (direction @ way) * way
    length = float(np.linalg.norm(direction))
    if length < 0.1:
        side = np.eye(3)[int(np.argmin(np.abs(pull)))] if pull is not None else np.eye(3)[0]
        return _square(side, pull)
    return direction / length


def _numbered(piece: Piece, parts: list[Piece]) -> list[Piece]:
    return [
        replace(
            part, name=f"{piece.name}_part{number}", title=f"{piece.title}, part {number} of {len(parts)}"
        )
        for number, part in enumerate(parts, 1)
    ]


def _too_large(piece: Piece, printer: Printer) -> GeometryError:
    width, depth, height = printer.usable_mm
    return GeometryError(
        f"{piece.title.lower()} does not fit the bed however it is cut",
        where=f"{piece.name}, usable {width:g} x {depth:g} x {height:g} mm",
        hint="use a larger printer (mold.printer)",
    )
