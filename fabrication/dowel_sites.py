"""Where dowel pins cross a cut: inside a core, and in bosses on a shell's wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from manifold3d import CrossSection, FillRule, Manifold, OpType

from fabrication.fixtures.dowel import SPARE_MM, WALL_MM
from fabrication.fixtures.place import Place, frame
from fabrication.printers import profile
from hilbrace.config.mold import MoldSettings

Array = np.ndarray

CORE_PINS = ((8.0, 40), (6.0, 30), (6.0, 20), (4.0, 16), (3.0, 10))
"""Diameter and length of the pins that a core may get, the stoutest first [mm]."""

SHELL_PIN = (3.0, 10)
"""Diameter and length of a shell's pins [mm]."""

CORE_WALL_MM = 4.0
"""Least material around a core's pins [mm]."""

CLOSEST_MM = 12.0
"""Pins of one cut lie at least this far apart [mm]."""

BOSS_WALL_MM = 1.8
"""Material around the hole of a pin in a boss [mm]."""

BOSS_TIP_MM = 0.5
"""Radius to which bosses taper, at 45 degrees, so that they print without support [mm]."""

AVOID_MM = 12.0
"""Bosses stay this far from bolts, port and vents [mm]."""

FROM_FLANGE = (0.5, 0.15, 0.85, 0.3, 0.7, 0.4, 0.6)
"""Places along a wall where bosses are tried, as part of its length; those near the middle and both ends
first [-]."""

BOSSES = 3
"""Most bosses of one cut."""


@dataclass(frozen=True)
class Sites:
    """Dowel pins across a cut.

    Attributes:
        places: On the cut, along the pins.
        diameter_mm: Of the pins [mm].
        bosses: What the piece needs besides, around the holes.
    """

    places: tuple[Place, ...]
    diameter_mm: float
    bosses: Manifold


def core_sites(
    solid: Manifold, normal: Float[Array, "3"], level: float, names: tuple[str, str]
) -> Sites | None:
    """Pins inside a massive body: the stoutest pair that fits, as far apart as can be.

    Args:
        solid: The body, not yet cut.
        normal: Unit normal of the cut.
        level: Its coordinate along the normal [mm].
        names: Names of the lower and the upper part.

    Returns:
        The pins; ``None`` where no two fit.
    """
    turn = plane_axes(normal)
    turned = solid.transform(np.column_stack([turn, np.zeros(3)]))
    for diameter, length in CORE_PINS:
        depth = 0.5 * length + SPARE_MM + WALL_MM
        room = turned.slice(level)
        for step in (-1.0, -0.5, 0.5, 1.0):
            room = room ^ turned.slice(level + step * depth)
        room = room.offset(-(0.5 * diameter + CORE_WALL_MM))
        spots = _apart(room, CLOSEST_MM + diameter)
        if spots is not None:
            places = tuple(_place(spot, level, turn, names, depth) for spot in spots)
            return Sites(places, diameter, Manifold())
    return None


def shell_sites(
    solid: Manifold,
    land: Manifold,
    others: Sequence[Manifold],
    avoid: Float[Array, "point 3"],
    normal: Float[Array, "3"],
    level: float,
    names: tuple[str, str],
    settings: MoldSettings,
) -> Sites | None:
    """Pins in bosses on the outside of a wall, in its middle and towards both flanges.

    Args:
        solid: The shell, not yet cut.
        land: What it lies on.
        others: The other shells.
        avoid: Points that bosses stay clear of [mm].
        normal: Unit normal of the cut.
        level: Its coordinate along the normal [mm].
        names: Names of the lower and the upper part.
        settings: Section ``mold``: the printer sets the clearance.

    Returns:
        The pins and their bosses; ``None`` where no two fit.
    """
    turn = plane_axes(normal)
    back = np.column_stack([turn, np.zeros(3)])
    radius, depth, away = _boss_size(settings)
    line = _along_wall(solid.transform(back).slice(level), land.transform(back).slice(level), away)
    places, bosses = [], []
    for part in FROM_FLANGE:
        if line is None or len(places) == BOSSES:
            break
        spot = line[int(part * (len(line) - 1))]
        place = _place(spot, level, turn, names, depth)
        boss = _boss(radius, depth).transform(frame(place.point, normal, turn[0]))
        near = np.linalg.norm(avoid - place.point, axis=1).min(initial=np.inf) < AVOID_MM
        crowded = any(np.linalg.norm(place.point - other.point) < CLOSEST_MM for other in places)
        if near or crowded or any((boss ^ other).volume() > 0 for other in others):
            continue
        places.append(place)
        bosses.append(boss)
    if len(places) < 2:
        return None
    return Sites(tuple(places), SHELL_PIN[0], Manifold.batch_boolean(bosses, OpType.Add))


def plane_axes(normal: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation whose last row is a direction: it lays planes across that direction level."""
    return frame(np.zeros(3), normal, np.eye(3)[int(np.argmin(np.abs(normal)))])[:, :3].T


def _place(spot: Array, level: float, turn: Array, names: tuple[str, str], depth: float) -> Place:
    point = turn.T @ np.array([spot[0], spot[1], level])
    return Place(point, turn[2], turn[0], names, depth)


def _apart(room: CrossSection, least_mm: float) -> list[Array] | None:
    """The two places of a section that lie farthest apart; ``None`` of a section too small for two."""
    polygons = room.to_polygons()
    if not polygons:
        return None
    points = np.concatenate([np.asarray(polygon, float) for polygon in polygons])
    first = points[np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1))]
    second = points[np.argmax(np.linalg.norm(points - first, axis=1))]
    return [first, second] if np.linalg.norm(first - second) > least_mm else None


def _boss_size(settings: MoldSettings) -> tuple[float, float, float]:
    """Radius of a boss, depth on either side of the cut, and how far its axis lies off the land [mm]."""
    diameter, length = SHELL_PIN
    hole = 0.5 * diameter + profile(settings).clearance_mm
    return hole + BOSS_WALL_MM, 0.5 * length + SPARE_MM + WALL_MM, hole + BOSS_WALL_MM + 2.0


def _boss(radius: float, depth: float) -> Manifold:
    """A round bar across the cut that tapers into the wall at both ends."""
    taper = radius - BOSS_TIP_MM
    ends = [(0.0, -depth - taper), (BOSS_TIP_MM, -depth - taper), (radius, -depth)]
    outline = [*ends, *((x, -z) for x, z in reversed(ends))]
    return Manifold.revolve(CrossSection([np.array(outline)], FillRule.EvenOdd), 48)


def _along_wall(section: CrossSection, land: CrossSection, away: float) -> Array | None:
    """The longest line at a distance from the land that runs inside a wall; its points a millimetre apart."""
    found: list[Array] = []
    inside = section.offset(0.2)
    for polygon in land.offset(away).to_polygons():
        closed = np.concatenate([polygon, polygon[:1]])
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
        even = np.arange(0.0, way[-1], 1.0)
        points = np.stack([np.interp(even, way, closed[:, i]) for i in (0, 1)], axis=1)
        kept = _inside(points, inside)
        if kept.all():
            found.append(points)
            continue
        start = int(np.argmin(kept))
        points, kept = np.roll(points, -start, axis=0), np.roll(kept, -start)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
        found += [points[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return max(found, key=len) if found and max(map(len, found)) > 2 * CLOSEST_MM else None


def _inside(points: Float[Array, "point 2"], section: CrossSection) -> Array:
    """Which points lie inside a section, by the number of edges to their right."""
    count = np.zeros(len(points), int)
    for polygon in section.to_polygons():
        a = np.asarray(polygon, float)
        b = np.roll(a, -1, axis=0)
        x, y = points[:, :1], points[:, 1:]
        crosses = (a[:, 1] > y) != (b[:, 1] > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        count += (crosses & (x < at)).sum(axis=1)
    return count % 2 == 1
