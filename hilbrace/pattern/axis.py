"""The axis of the struts that carry load: where two different holes are equally near."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hilbrace.pattern.border import border, hole_numbers
from hilbrace.pattern.clip import ZeroLine
from hilbrace.pattern.refine import RefinedSkin
from hilbrace.pattern.zone import EVERYWHERE, Zone

Array = np.ndarray

_STEPS = np.array([0.25, 0.75])
"""Where points of the axis lie between the middle of a triangle and where the axis leaves it [-]."""


@dataclass(frozen=True)
class StrutAxis:
    """Points along the middle of the struts that run between two different holes.

    Attributes:
        points: Positions [mm].
        radius: Distance to the border [mm].
    """

    points: Float[Array, "point 3"]
    radius: Float[Array, " point"]


def strut_axis(skin: RefinedSkin, line: ZeroLine, zone: Zone = EVERYWHERE) -> StrutAxis:
    """Find where two different holes are equally near (what lies beyond an edge of the brace is a hole too).

    Args:
        skin: The refined skin.
        line: Zero line of the pattern.
        zone: Where the axis is wanted.
    """
    hole = hole_numbers(skin, line)
    edge = border(skin, line, hole)
    near_line = np.zeros(len(skin.vertices), dtype=bool)
    near_line[skin.triangles[line.triangle]] = True
    asked = np.flatnonzero((line.depth > 0) | near_line)
    asked = asked[zone.holds(skin.vertices[asked])]
    foot = np.zeros_like(skin.vertices)
    _, segment, foot[asked] = edge.nearest(skin.vertices[asked])
    nearest_hole = np.where(line.depth > 0, -1, hole)
    solid = line.depth[asked] > 0
    nearest_hole[asked[solid]] = edge.hole[segment[solid]]
    known = np.zeros(len(skin.vertices), dtype=bool)
    known[asked] = True
    points = _equidistant_segments(
        skin, skin.triangles[known[skin.triangles].all(axis=1)], nearest_hole, foot
    )
    if not len(points):
        return StrutAxis(np.zeros((0, 3)), np.zeros(0))
    return StrutAxis(points, edge.nearest(points)[0])


def _equidistant_segments(
    skin: RefinedSkin,
    triangles: Int[Array, "triangle 3"],
    nearest_hole: Int[Array, " vertex"],
    foot: Float[Array, "vertex 3"],
) -> Float[Array, "point 3"]:
    """Points on the lines where the nearest hole changes, inside every triangle that they cross."""
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]]
    differs = nearest_hole[sides[..., 0]] != nearest_hole[sides[..., 1]]
    crossed = differs.any(axis=1)
    sides, differs = sides[crossed], differs[crossed]
    a, b = sides[..., 0], sides[..., 1]
    x, y = skin.vertices[a], skin.vertices[b]
    at_a = ((x - foot[a]) ** 2).sum(-1) - ((x - foot[b]) ** 2).sum(-1)
    at_b = ((y - foot[a]) ** 2).sum(-1) - ((y - foot[b]) ** 2).sum(-1)
    change = at_a - at_b
    t = np.clip(np.where(np.abs(change) > 1e-12, at_a / np.where(change == 0, 1, change), 0.5), 0, 1)
    crossing = x + t[..., None] * (y - x)
    centre = (crossing * differs[..., None]).sum(axis=1) / differs.sum(axis=1)[:, None]
    rays = centre[:, None, None] + _STEPS[:, None] * (crossing - centre[:, None])[:, :, None]
    return rays[differs].reshape(-1, 3)
