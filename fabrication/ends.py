"""Where shells end: planes across the limb, just inside the borders of its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from manifold3d import Manifold

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


def find_ends(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], axis: Float[Array, "3"]
) -> tuple[End, ...]:
    """A plane just inside each border of a tube.

    Args:
        vertices: The surface [mm].
        triangles: Its triangles, outward.
        axis: Direction from the lower end to the upper one.

    Returns:
        Planes, from the lower one to the upper one.

    Raises:
        GeometryError: The surface has no border, or more than two.
    """
    borders = border_loops(triangles)
    if not 1 <= len(borders) <= 2:
        raise GeometryError(
            f"the limb's surface has {len(borders)} borders, a tube has two",
            where="mold shells",
            hint="give the limb as a tube that is open at both ends of the brace, its windows closed",
        )
    middle = vertices[triangles].mean(axis=(0, 1))
    ends = []
    for loop in borders:
        points = vertices[loop]
        centre = points.mean(axis=0)
        normal = 0.5 * np.cross(points - centre, np.roll(points, -1, axis=0) - centre).sum(axis=0)
        normal *= np.sign(normal @ (centre - middle)) / np.linalg.norm(normal)
        ends.append(End(normal, float((points @ normal).min() - INSIDE_MM)))
    return tuple(sorted(ends, key=lambda end: float(end.normal @ axis)))


def inside(ends: tuple[End, ...], points: Float[Array, "point 3"], margin_mm: float = 0.0) -> Bool[Array, " point"]:
    """Which points lie further inside all ends than a margin."""
    within = np.ones(len(points), bool)
    for end in ends:
        within &= end.depth(points) > margin_mm
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
