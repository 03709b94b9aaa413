"""Last repairs of a cleaned pattern, only where struts or slits were measured as too narrow.

The clean-up works with distances that are accurate to a fraction of a mesh edge. What is left a little too
narrow after it is widened, cut or filled in its own neighbourhood with a growing margin, and measured again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from hilbrace.errors import GeometryError
from hilbrace.pattern.axis import StrutAxis, strut_axis
from hilbrace.pattern.border import Border, border, hole_numbers, slit_widths, strut_widths
from hilbrace.pattern.clean import BUMP, close_slits, drop_islands, fill_specks, shave_bumps, widen
from hilbrace.pattern.clip import ZeroLine, zero_line
from hilbrace.pattern.refine import RefinedSkin
from hilbrace.pattern.zone import EVERYWHERE, Zone

Array = np.ndarray

NEEDLE = 0.3
"""Struts were widened to the least width before: what is still below this share of it is a needle [-]."""
NEEDLE_MM = 0.1
"""A needle's tip lies no deeper in the solid, or in the hole, than this [mm]."""
PLUG_STEP = 0.5
"""What each attempt adds to the radius of the plugs [mean edges]."""
_GENTLE = 3
_PATIENT = 6
"""Attempts after which slits, and struts, are covered with discs."""
_ROUNDS = 14
_MARGIN = 0.03
"""What each round adds to the width that is asked for, as a share of the least one [-]."""
_START = 1.02
LOOK = 2.5
"""Widths are looked for up to this multiple of the least one [-]."""
_LOCAL = 4.0
"""Reach of the changes that a repair makes, and of what is measured again, in least widths [-]."""


@dataclass(frozen=True)
class Mended:
    """A pattern whose struts and slits have their least widths.

    Attributes:
        line: Its zero line.
        edge: Its border.
        islands: Pieces that the repairs cut off and removed.
        strut_mm: Narrowest strut [mm]; no wider one than `LOOK` times the least is looked for.
        slit_mm: Narrowest slit [mm], likewise.
    """

    line: ZeroLine
    edge: Border
    islands: int
    strut_mm: float
    slit_mm: float


def mended(
    skin: RefinedSkin,
    depth: Float[Array, " vertex"],
    rim_depth: Float[Array, " vertex"],
    areas: Float[Array, " triangle"],
    strut_mm: float,
    slit_mm: float,
) -> Mended:
    """Repair a cleaned pattern until no strut and no slit is too narrow.

    Args:
        skin: The refined skin.
        depth: Depth of the cleaned pattern at its vertices [mm].
        rim_depth: Depth inside the solid bands, which stay [mm].
        areas: Areas of the skin's triangles [mm^2].
        strut_mm: Least width of a strut [mm].
        slit_mm: Least width of a slit [mm].

    Raises:
        GeometryError: Some places resist.
    """
    line, islands, zone = zero_line(skin, depth), 0, EVERYWHERE
    narrow = tight = np.zeros((0, 3))
    for extra in range(1, _ROUNDS + 1):
        edge = border(skin, line, hole_numbers(skin, line))
        struts, slits = _measured(edge, strut_mm, slit_mm, zone)
        if zone is not EVERYWHERE and struts.min() >= strut_mm and slits.min() >= slit_mm:
            struts, slits = _measured(edge, strut_mm, slit_mm, EVERYWHERE)
        narrow, tight = edge.middle[struts < strut_mm], edge.middle[slits < slit_mm]
        if not len(narrow) and not len(tight):
            return Mended(line, edge, islands, float(struts.min()), float(slits.min()))
        zone = Zone(np.concatenate([narrow, tight]), _LOCAL * max(strut_mm, slit_mm))
        if len(narrow):
            needles = edge.middle[struts < NEEDLE * strut_mm]
            if len(needles):
                line = zero_line(skin, trim_needles(skin, line, needles, strut_mm / 2))
            wide = (_START + _MARGIN * extra) * strut_mm
            line = zero_line(skin, widened(skin, line, rim_depth, narrow, wide))
            if extra > _PATIENT:
                line = zero_line(skin, plugged(skin, line, narrow, 0.25 * strut_mm, extra - _PATIENT))
        if len(tight):
            needles = edge.middle[slits < NEEDLE * slit_mm]
            if len(needles):
                line = zero_line(skin, trim_needles(skin, line, needles, slit_mm / 2))
            line = zero_line(skin, filled(skin, line, tight, slit_mm, extra))
            line = zero_line(skin, fill_specks(skin, line, areas, slit_mm))
        depth, dropped = drop_islands(skin, line.depth, areas)
        line, islands = zero_line(skin, depth), islands + dropped
    raise GeometryError(
        f"{len(narrow)} places of struts and {len(tight)} of slits stay narrower than asked, the first near "
        f"({', '.join(f'{x:.0f}' for x in np.concatenate([narrow, tight])[0])}) mm",
        where="pattern",
        hint="lower pattern.resolution_mm or pattern.min_slit_mm, or raise pattern.scale",
    )


def widened(
    skin: RefinedSkin,
    line: ZeroLine,
    rim_depth: Float[Array, " vertex"],
    narrow: Float[Array, "place 3"],
    strut_mm: float,
) -> Float[Array, " vertex"]:
    """Widen struts and cut spurs about the places that were measured as too narrow.

    Args:
        skin: The refined skin.
        line: Zero line of the cleaned pattern.
        rim_depth: Depth inside the solid bands, which stay [mm].
        narrow: Places on the border [mm].
        strut_mm: Width to give the struts there [mm].

    Returns:
        The new depth at the vertices [mm].
    """
    zone = Zone(narrow, 2 * strut_mm)
    axis = strut_axis(skin, line, zone)
    close = Zone(narrow, strut_mm).holds(axis.points)
    depth = shave_bumps(skin, line, rim_depth, BUMP * strut_mm, zone)
    return widen(skin, depth, StrutAxis(axis.points[close], axis.radius[close]), strut_mm)


def filled(
    skin: RefinedSkin, line: ZeroLine, tight: Float[Array, "place 3"], slit_mm: float, attempt: int
) -> Float[Array, " vertex"]:
    """Fill slits about the places that were measured as too narrow.

    A disc wider than the least slit rolls inside the holes; what still resists after some attempts is
    plugged with discs.

    Args:
        skin: The refined skin.
        line: Zero line of the pattern.
        tight: Places on the border [mm].
        slit_mm: Least width of a slit [mm].
        attempt: Number of this attempt, from 1.

    Returns:
        The new depth at the vertices [mm].
    """
    wide = (1.0 + 2 * _MARGIN * attempt) * slit_mm
    depth = close_slits(skin, line, wide, Zone(tight, 2 * slit_mm))
    if attempt <= _GENTLE:
        return depth
    return plugged(skin, zero_line(skin, depth), tight, slit_mm / 2, attempt - _GENTLE)


def plugged(
    skin: RefinedSkin, line: ZeroLine, places: Float[Array, "place 3"], radius_mm: float, attempt: int
) -> Float[Array, " vertex"]:
    """Cover places with discs, the larger the more often it was tried.

    Args:
        skin: The refined skin.
        line: Zero line of the pattern.
        places: Where struts or slits stay too narrow [mm].
        radius_mm: Radius of the discs to begin with [mm].
        attempt: Number of this attempt, from 1.

    Returns:
        The new depth at the vertices [mm].
    """
    radius = radius_mm + PLUG_STEP * attempt * skin.edge_mm
    distance = KDTree(places).query(skin.vertices, distance_upper_bound=2 * radius)[0]
    return np.maximum(line.depth, radius - distance)


def trim_needles(
    skin: RefinedSkin, line: ZeroLine, narrow: Float[Array, "place 3"], reach_mm: float
) -> Float[Array, " vertex"]:
    """Blunt needles: vertices near zero draw the border out to a point, unlike all around them.

    Such a vertex takes the mean depth of its neighbours, which for a straight border is the depth it should
    have.

    Args:
        skin: The refined skin.
        line: Zero line of the pattern.
        narrow: Places on needles [mm].
        reach_mm: How far from these places a needle's tip may be [mm].

    Returns:
        The new depth at the vertices [mm].
    """
    near = np.isfinite(KDTree(narrow).query(skin.vertices, distance_upper_bound=reach_mm)[0])
    tip = near & (np.abs(line.depth) < NEEDLE_MM)
    ends = np.concatenate([skin.edges, skin.edges[:, ::-1]])
    count = np.bincount(ends[:, 0], minlength=len(tip))
    mean = np.bincount(ends[:, 0], line.depth[ends[:, 1]], minlength=len(tip)) / count
    return np.where(tip, mean, line.depth)


def _measured(
    edge: Border, strut_mm: float, slit_mm: float, zone: Zone
) -> tuple[Float[Array, " segment"], Float[Array, " segment"]]:
    return strut_widths(edge, LOOK * strut_mm, zone), slit_widths(edge, LOOK * slit_mm, zone)
