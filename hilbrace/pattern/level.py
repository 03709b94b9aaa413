"""How wide the struts must be drawn so that they cover the share of the skin that the design promises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.config import PatternSettings
from hilbrace.pattern.clean import clean, drop_islands
from hilbrace.pattern.clip import solid_fraction
from hilbrace.pattern.implicit import BlendedPattern
from hilbrace.pattern.refine import RefinedSkin

Array = np.ndarray

STRUT_MARGIN = 1.02
"""Least width that struts are widened to, over the configured one [-]: room for the mesh's error."""
SLIT_MARGIN = 1.02
"""The same of slits [-]."""
FRACTION_TOLERANCE = 0.006
"""Relative difference between the pattern's share of the skin and the design's that is small enough [-]."""
LEVEL_LIMIT = 0.2
"""Largest constant added to the half width [cell sides]."""
_ROUNDS = 6


@dataclass(frozen=True)
class Levelled:
    """A clean pattern that covers the share of the skin that it should.

    Attributes:
        depth: Its depth at the vertices of the refined skin [mm].
        shift: Constant that was added to the half width [cell sides].
        islands: Pieces that hung on nothing and were removed.
    """

    depth: Float[Array, " vertex"]
    shift: float
    islands: int


def levelled(
    skin: RefinedSkin,
    blended: BlendedPattern,
    areas: Float[Array, " triangle"],
    share: float,
    settings: PatternSettings,
) -> Levelled:
    """Find the level at which the clean pattern covers ``share`` of the skin (secant method).

    Args:
        skin: The refined skin.
        blended: The two microstructures on it.
        areas: Areas of its triangles [mm^2].
        share: Share of the skin that the design fills [-].
        settings: Least widths of struts and slits.

    Returns:
        The best of the levels tried.

    Raises:
        GeometryError: The struts do not hang together.
    """
    best, error = Levelled(np.zeros(0), 0.0, 0), np.inf
    aims, errors = [share], []
    for _ in range(_ROUNDS):
        shift = _shift_for(skin, blended, areas, aims[-1])
        depth = clean(
            skin,
            blended.depth(shift),
            blended.rim_depth,
            areas,
            STRUT_MARGIN * settings.min_strut_mm,
            SLIT_MARGIN * settings.min_slit_mm,
        )
        depth, dropped = drop_islands(skin, depth, areas)
        errors.append(solid_fraction(skin, depth, areas) - share)
        if abs(errors[-1]) < error:
            best, error = Levelled(depth, shift, dropped), abs(errors[-1])
        if error <= FRACTION_TOLERANCE * share or abs(shift) >= 0.99 * LEVEL_LIMIT:
            break
        slope = 1.0 if len(aims) == 1 else (errors[-1] - errors[-2]) / (aims[-1] - aims[-2])
        aims.append(aims[-1] - errors[-1] / np.clip(slope, 0.5, 4.0))
    return best


def _shift_for(
    skin: RefinedSkin, blended: BlendedPattern, areas: Float[Array, " triangle"], share: float
) -> float:
    """Level shift at which the pattern, before any clean-up, covers ``share`` of the skin (bisection)."""
    low, high = -LEVEL_LIMIT, LEVEL_LIMIT
    for _ in range(18):
        middle = (low + high) / 2
        covered = solid_fraction(skin, blended.depth(middle), areas)
        low, high = (middle, high) if covered < share else (low, middle)
    return (low + high) / 2
