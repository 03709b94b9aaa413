"""Where shells end: planes across the limb, just inside the borders of its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from manifold3d import Manifold

from fabrication.mold import Casting
from hilbrace.errors import GeometryError

Array = np.ndarray

INSIDE_MM = 0.6
"""How far inside the border shells end: never in one plane with the core's own end [mm]."""


@dataclass(frozen=True)
class End:
    """A plane in which the shells end.

    Attributes:
        normal: Unit normal, out of the mold.
        level: Coordinate of the plane along it [mm].
    """

    normal: Float[Array, "3"]
    level: float

    def trim(self, solid: Manifold) -> Manifold:
        """What of a body lies inside the plane."""
        return solid.trim_by_plane(tuple(-self.normal), -self.level)

    def depth(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point"]:
        """How far points lie inside the plane [mm]."""
        return self.level - points @ self.normal


def find_ends(casting: Casting) -> tuple[End, ...]:
    """A plane just inside each border of a tube.

    Args:
        casting: What shall be cast; its surface runs straight beyond the brace's edges.

    Returns:
        The lower end and the upper one.

    Raises:
        GeometryError: The surface ends with the brace.
    """
    ends = []
    for beyond, normal in ((-1, casting.down), (1, casting.up)):
        triangles = casting.triangles[casting.beyond == beyond]
        if not len(triangles):
            raise GeometryError(
                "the limb's surface ends with the brace",
                where="mold shells",
                hint="give a limb that is longer than the brace at both ends",
            )
        levels = (float((casting.outer[loop] @ normal).min()) for loop in border_loops(triangles))
        ends.append(End(normal, max(levels) - INSIDE_MM))
    return tuple(ends)


def inside(
    ends: tuple[End, ...], points: Float[Array, "point 3"], margin_mm: float = 0.0
) -> Bool[Array, " point"]:
    """Which points lie further inside all ends than a margin."""
    within = np.ones(len(points), bool)
    for end in ends:
        within &= end.depth(points) > margin_mm
    return within


def reaching_inside(
    ends: tuple[End, ...], vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Bool[Array, " triangle"]:
    """Which triangles reach inside all ends; those that lie beyond one of them do not."""
    within = np.ones(len(triangles), bool)
    for end in ends:
        within &= (end.depth(vertices) > 0)[triangles].any(axis=1)
    return within


def border_loops(triangles: Int[Array, "triangle 3"]) -> list[Int[Array, " corner"]]:
    """Vertices along each border of a surface, in order; the one with the smallest vertex first."""
    count = int(triangles.max()) + 1
    forth = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    single = ~np.isin(forth[:, 0] * count + forth[:, 1], forth[:, 1] * count + forth[:, 0])
    following = dict(map(tuple, forth[single].tolist()))
    loops = []
    while following:
        start = min(following)
        loop = [start]
        while (vertex := following.pop(loop[-1])) != start:
            loop.append(vertex)
        loops.append(np.array(loop))
    return loops
