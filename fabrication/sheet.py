"""The limb's surface with the outer face over it, and how it goes on beyond the brace's edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.pattern.thicken import border_edges

Array = np.ndarray

ROWS = 4
"""Rows of triangles in a part beyond an edge."""


@dataclass(frozen=True)
class Sheet:
    """A surface and the way from each of its vertices to the outer face.

    Attributes:
        vertices: Positions on the limb [mm].
        vector: From there to the outer face [mm].
        triangles: Vertex indices, outward.
        covered: Triangles under the brace.
        beyond: Where triangles lie, as in `Casting`.
    """

    vertices: Float[Array, "vertex 3"]
    vector: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    covered: Bool[Array, " triangle"]
    beyond: Int[Array, " triangle"]

    @property
    def outer(self) -> Float[Array, "vertex 3"]:
        """The outer face [mm]."""
        return self.vertices + self.vector

    def joined(
        self,
        vertices: Float[Array, "new 3"],
        vector: Float[Array, "new 3"],
        triangles: Int[Array, "more 3"],
        beyond: int | Int[Array, " more"] = 0,
    ) -> Sheet:
        """The sheet with a part more, bare of brace; triangles index the old vertices, then the new ones."""
        return Sheet(
            np.concatenate([self.vertices, vertices]),
            np.concatenate([self.vector, vector]),
            np.concatenate([self.triangles, triangles]),
            np.concatenate([self.covered, np.zeros(len(triangles), dtype=bool)]),
            np.concatenate([self.beyond, np.broadcast_to(beyond, len(triangles))]),
        )


@dataclass(frozen=True)
class Rim:
    """The open edges of a surface, to walk along.

    Attributes:
        vertices: The vertices on them.
        after: The one that follows each vertex of the surface, surface on the left; -1 inside.
    """

    vertices: Int[Array, " rim"]
    after: Int[Array, " vertex"]

    def walk(self, start: int, stop: int) -> Int[Array, " step"]:
        """Vertices from one to another, both counted; all around if they are the same one."""
        way = [start, int(self.after[start])]
        while way[-1] != stop and len(way) <= len(self.vertices):
            way.append(int(self.after[way[-1]]))
        return np.array(way)


def rim_of(triangles: Int[Array, "triangle 3"]) -> Rim:
    """The open edges of a surface."""
    edges = border_edges(triangles)
    after = np.full(int(triangles.max()) + 1, -1)
    after[edges[:, 0]] = edges[:, 1]
    return Rim(np.sort(edges[:, 0]), after)


def loop_normal(points: Float[Array, "corner 3"]) -> Float[Array, "3"]:
    """Unit normal of a closed line of points: that of its vector area, counterclockwise seen from its tip."""
    away = points - points.mean(axis=0)
    area = np.cross(away, np.roll(away, -1, axis=0)).sum(axis=0)
    return area / np.linalg.norm(area)


def prolonged(
    sheet: Sheet,
    line: Int[Array, " corner"],
    direction: Float[Array, "3"],
    length_mm: float,
    beyond: int | Int[Array, " edge"],
) -> Sheet:
    """The sheet with a ruled part beyond one of its edges, which ends in a plane across a direction.

    The outer edge moves straight along the direction, so that a shell around it has no undercut. The way
    from the limb to the outer face turns until it lies in that plane.

    Args:
        sheet: The sheet.
        line: Vertices along the edge, sheet on the left; the first one again at the end where it is closed.
        direction: Unit direction away from the sheet.
        length_mm: How far beyond the edge's furthest point it goes [mm].
        beyond: Mark of the new triangles, one for all or one for each edge along the line.
    """
    corners = line[:-1] if line[0] == line[-1] else line
    outer, vector = sheet.outer[corners], sheet.vector[corners]
    height = outer @ direction
    step = height.max() + length_mm - height
    reach = np.linalg.norm(vector, axis=1, keepdims=True)
    across = vector - np.outer(vector @ direction, direction)
    across *= reach / np.linalg.norm(across, axis=1, keepdims=True)
    points, ways = [], []
    for part in np.arange(1, ROWS + 1) / ROWS:
        way = (1 - part) * vector + part * across
        way *= reach / np.linalg.norm(way, axis=1, keepdims=True)
        points.append(outer + part * step[:, None] * direction - way)
        ways.append(way)
    count, start = len(corners), len(sheet.vertices)
    rows = np.concatenate([corners[None], start + np.arange(ROWS * count).reshape(ROWS, count)])
    if len(corners) < len(line):
        rows = np.concatenate([rows, rows[:, :1]], axis=1)
    a, b, far_a, far_b = rows[:-1, :-1], rows[:-1, 1:], rows[1:, :-1], rows[1:, 1:]
    quads = np.stack([np.stack([b, a, far_a], -1), np.stack([b, far_a, far_b], -1)], axis=2)
    marks = np.broadcast_to(np.expand_dims(beyond, -1), (*a.shape, 2)).reshape(-1)
    return sheet.joined(np.concatenate(points), np.concatenate(ways), quads.reshape(-1, 3), marks)
