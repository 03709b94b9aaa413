"""The limb in the mold: the brace's skin with its windows filled, and the line through its middle."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay

from hilbrace.domain.rim import loop_distance
from hilbrace.errors import GeometryError

Array = np.ndarray

LEVELS = 40
"""Sections that the centreline runs through."""
_CLEAR = 0.6
"""Distance of the points in a window from its edge, in edges [-]."""
_ROUNDS = 2


@dataclass(frozen=True)
class Limb:
    """A surface around the limb and the way from it to the outer face, on a coarse mesh.

    Attributes:
        vertices: Positions [mm].
        vector: From there to the outer face [mm].
        triangles: Outward.
        filled: Triangles that close windows.
    """

    vertices: Float[Array, "vertex 3"]
    vector: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    filled: Bool[Array, " triangle"]


def with_windows_filled(limb: Limb, windows: tuple[Int[Array, " _corner"], ...]) -> Limb:
    """Close windows by caps that go on as the skin around them ends: bent, and without a crease.

    The caps are biharmonic: they keep the place and, but for one row of triangles, the slope of the skin.

    Args:
        limb: The limb.
        windows: Vertices along the edge of each window, limb on the left.

    Raises:
        GeometryError: A window's edge crosses itself when seen from outside.
    """
    known = len(limb.vertices)
    for number, loop in enumerate(windows):
        points, triangles = _cap(limb, loop, number)
        limb = Limb(
            np.concatenate([limb.vertices, points]),
            np.concatenate([limb.vector, np.zeros_like(points)]),
            np.concatenate([limb.triangles, triangles]),
            np.concatenate([limb.filled, np.ones(len(triangles), dtype=bool)]),
        )
    fixed = np.arange(known)
    values = np.concatenate([limb.vertices, limb.vector], axis=1)
    for _ in range(_ROUNDS if windows else 0):
        values = _harmonic(values[:, :3], limb.triangles, fixed, values[:known], 2)
    return Limb(values[:, :3].copy(), values[:, 3:].copy(), limb.triangles, limb.filled)


def _cap(
    limb: Limb, loop: Int[Array, " corner"], number: int
) -> tuple[Float[Array, "new 3"], Int[Array, "triangle 3"]]:
    """Points inside a window, in the plane that fits it best, and triangles over it."""
    edge = limb.vertices[loop]
    middle = edge.mean(axis=0)
    axes = np.linalg.svd(edge - middle)[2]
    if axes[2] @ limb.vector[loop].mean(axis=0) < 0:
        axes[2] *= -1
    axes[1] = np.cross(axes[2], axes[0])
    flat = (edge - middle) @ axes[:2].T
    inner = _points_inside(flat)
    corners = Delaunay(np.concatenate([flat, inner])).simplices.astype(np.int64)
    plane = np.concatenate([flat, inner])
    corners = corners[_inside(plane[corners].mean(axis=1), flat)]
    a, b, c = np.moveaxis(plane[corners], 1, 0)
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    turned = ux * vy - uy * vx < 0
    corners[turned] = corners[turned][:, ::-1]
    ears = (corners < len(loop)).all(axis=1)
    inner = np.concatenate([inner, plane[corners[ears]].mean(axis=1)])
    new = len(plane) + np.arange(int(ears.sum()))
    split = [np.stack([corners[ears, k], corners[ears, (k + 1) % 3], new], axis=1) for k in range(3)]
    corners = np.concatenate([corners[~ears], *split])
    _check_cap(corners, len(loop), number)
    index = np.concatenate([loop, len(limb.vertices) + np.arange(len(inner))])
    return middle + inner @ axes[:2], index[corners]


def _points_inside(polygon: Float[Array, "corner 2"]) -> Float[Array, "inner 2"]:
    """Points of a grid of triangles inside a polygon, as far apart as its corners."""
    edge = float(np.linalg.norm(polygon - np.roll(polygon, 1, axis=0), axis=1).mean())
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    rows = np.arange(low[1], high[1], edge * np.sqrt(0.75))
    grid = [
        np.stack([np.arange(low[0] + edge * (k % 2) / 2, high[0], edge), np.full_like(row, y)], axis=1)
        for k, y in enumerate(rows)
        for row in [np.arange(low[0] + edge * (k % 2) / 2, high[0], edge)]
    ]
    points = np.concatenate([np.zeros((0, 2)), *grid])
    points = points[_inside(points, polygon)]
    raised = [np.pad(part, ((0, 0), (0, 1))) for part in (points, polygon)]
    return points[loop_distance(*raised) > _CLEAR * edge]


def _inside(points: Float[Array, "point 2"], polygon: Float[Array, "corner 2"]) -> Bool[Array, " point"]:
    """Whether points lie inside a polygon (crossings of a ray to the right)."""
    inside = np.zeros(len(points), dtype=bool)
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        straddles = (start[1] > points[:, 1]) != (end[1] > points[:, 1])
        if straddles.any():
            part = (points[:, 1] - start[1]) / (end[1] - start[1])
            inside ^= straddles & (points[:, 0] < start[0] + part * (end[0] - start[0]))
    return inside


def _check_cap(triangles: Int[Array, "triangle 3"], rim: int, number: int) -> None:
    """The cap's own border must be the window's edge, turned around."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    steps = {tuple(edge) for edge in edges.tolist()}
    border = {edge for edge in steps if edge[::-1] not in steps}
    around = {((k + 1) % rim, k) for k in range(rim)}
    if border != around:
        raise GeometryError(
            f"window {number + 1} of the brace cannot be closed for the core: its edge crosses itself seen "
            "from outside",
            where="domain.windows",
            hint="make the window smaller, or give its edge fewer bends",
        )


def centreline(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    lower: Int[Array, " low"],
    upper: Int[Array, " up"],
) -> Float[Array, "point 3"]:
    """Centres of sections around a limb, from its lower to its upper edge.

    Sections are level lines of the harmonic function that is 0 along the lower edge and 1 along the upper
    one: they turn with the limb, also around an ankle.

    Args:
        vertices: Surface around the limb [mm].
        triangles: Its triangles.
        lower: Vertices of its lower edge, in order.
        upper: Vertices of its upper edge, in order.
    """
    fixed = np.concatenate([lower, upper])
    ends = np.concatenate([np.zeros(len(lower)), np.ones(len(upper))])[:, None]
    level = _harmonic(vertices, triangles, fixed, ends, 1)[:, 0]
    inner = [section(vertices, triangles, level - value) for value in np.arange(1, LEVELS) / LEVELS]
    return np.array([_middle(vertices[lower]), *inner, _middle(vertices[upper])])


def section(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], level: Float[Array, " vertex"]
) -> Float[Array, "3"]:
    """Middle, by length, of the line where a function of a surface's vertices is zero [mm]."""
    ends = []
    start, end = level[triangles], level[np.roll(triangles, -1, axis=1)]
    crossed = (start > 0) != (end > 0)
    mixed = np.flatnonzero(crossed.sum(axis=1) == 2)
    for which in (crossed[mixed].argmax(axis=1), 2 - crossed[mixed][:, ::-1].argmax(axis=1)):
        tail, head = triangles[mixed, which], triangles[mixed, (which + 1) % 3]
        part = (level[tail] / (level[tail] - level[head]))[:, None]
        ends.append((1 - part) * vertices[tail] + part * vertices[head])
    length = np.linalg.norm(ends[1] - ends[0], axis=1)
    return ((ends[0] + ends[1]) / 2 * length[:, None]).sum(axis=0) / length.sum()


def _harmonic(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    fixed: Int[Array, " fixed"],
    values: Float[Array, "fixed column"],
    power: int,
) -> Float[Array, "vertex column"]:
    """Smooth values on a surface that are given at some vertices: harmonic (1) or biharmonic (2)."""
    points, given = np.ascontiguousarray(vertices), np.ascontiguousarray(values)
    return np.asarray(igl.harmonic(points, triangles, fixed, given, power), dtype=float)


def _middle(loop: Float[Array, "corner 3"]) -> Float[Array, "3"]:
    after = np.roll(loop, -1, axis=0)
    length = np.linalg.norm(after - loop, axis=1)
    return ((loop + after) / 2 * length[:, None]).sum(axis=0) / length.sum()
