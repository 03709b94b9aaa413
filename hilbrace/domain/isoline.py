"""Cutting a mesh along a plane or a level line, so that the cut becomes edges of the mesh."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

Array = np.ndarray


def mesh_edges(
    triangles: Int[Array, "triangle 3"],
) -> tuple[Int[Array, "edge 2"], Int[Array, "triangle 3"]]:
    """Undirected edges of a mesh, and the edge from corner j to corner j + 1 of each triangle."""
    after = np.roll(triangles, -1, axis=1)
    size = int(triangles.max(initial=0)) + 1
    codes = np.minimum(triangles, after).astype(np.int64) * size + np.maximum(triangles, after)
    found, index = np.unique(codes.ravel(), return_inverse=True)
    return np.stack(np.divmod(found, size), axis=1), index.reshape(-1, 3)


def split_at_zero(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    levels: Float[Array, " vertex"],
) -> tuple[Float[Array, "new 3"], Int[Array, "new_triangle 3"], Float[Array, " new"]]:
    """Split the triangles along the zero line of a piecewise linear function (marching triangles).

    Args:
        vertices: Positions.
        triangles: Vertex indices.
        levels: Value of the function at the vertices; exact zeros stay vertices.

    Returns:
        Vertices (the old ones first), triangles in the old orientation, levels. No triangle has
        vertices on both sides of zero.
    """
    edges, edge_of = mesh_edges(triangles)
    start, end = levels[edges[:, 0]], levels[edges[:, 1]]
    crossed = start * end < 0.0
    part = (start[crossed] / (start[crossed] - end[crossed]))[:, None]
    added = (1.0 - part) * vertices[edges[crossed, 0]] + part * vertices[edges[crossed, 1]]
    point_of_edge = np.full(len(edges), -1)
    point_of_edge[crossed] = len(vertices) + np.arange(len(added))
    points = point_of_edge[edge_of]
    pieces = _split_corners(triangles, points)
    return np.concatenate([vertices, added]), pieces, np.concatenate([levels, np.zeros(len(added))])


def cut_by_plane(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    normal: Float[Array, " xyz"],
    offset: float,
    snap: float,
) -> tuple[Float[Array, "new 3"], Int[Array, "kept 3"]]:
    """Keep the part of a mesh behind the plane ``normal . x = offset``.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices.
        normal: Unit normal, towards the part that is cut off.
        offset: Distance of the plane from the origin along the normal [mm].
        snap: Vertices nearer to the plane than this are moved onto it, which keeps slivers away [mm].

    Returns:
        Vertices and triangles; vertices that no triangle uses are left out.
    """
    levels = vertices @ normal - offset
    near = np.abs(levels) < snap
    snapped = np.where(near[:, None], vertices - levels[:, None] * normal, vertices)
    split, pieces, levels = split_at_zero(snapped, triangles, np.where(near, 0.0, levels))
    return compact(split, pieces, levels[pieces].sum(axis=1) < 0.0)


def cut_by_levels(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    levels: Float[Array, " vertex"],
    snap: float,
) -> tuple[Float[Array, "new 3"], Int[Array, "kept 3"]]:
    """Keep the part of a mesh where a function of its vertices is negative.

    Args:
        vertices: Positions.
        triangles: Vertex indices.
        levels: Value of the function at the vertices, linear in between.
        snap: Vertices nearer to the zero line than this share of an edge are moved along that edge onto it,
            which keeps slivers away [-].

    Returns:
        Vertices and triangles; vertices that no triangle uses are left out.
    """
    snapped, levels = _snapped(vertices, triangles, levels, snap)
    split, pieces, levels = split_at_zero(snapped, triangles, levels)
    return compact(split, pieces, levels[pieces].sum(axis=1) < 0.0)


def _snapped(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    levels: Float[Array, " vertex"],
    snap: float,
) -> tuple[Float[Array, "vertex 3"], Float[Array, " vertex"]]:
    """Vertices moved onto the zero line along the edge whose crossing is nearest, and their levels."""
    edges, _ = mesh_edges(triangles)
    both = np.concatenate([edges, edges[:, ::-1]])
    here, there = levels[both[:, 0]], levels[both[:, 1]]
    crossing = here * there < 0.0
    both, part = both[crossing], here[crossing] / (here[crossing] - there[crossing])
    order = np.argsort(-part, kind="stable")
    order = order[part[order] < snap]
    moved, flat = vertices.copy(), levels.copy()
    # The nearest crossing is written last.
    start, step = vertices[both[order, 0]], vertices[both[order, 1]] - vertices[both[order, 0]]
    moved[both[order, 0]] = start + part[order, None] * step
    flat[both[order, 0]] = 0.0
    return moved, flat


def compact(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    keep: Bool[Array, " triangle"],
) -> tuple[Float[Array, "used 3"], Int[Array, "kept 3"]]:
    """The kept triangles and the vertices that they use, in their old order."""
    kept = triangles[keep]
    used = np.zeros(len(vertices), bool)
    used[kept] = True
    number = np.cumsum(used) - 1
    return vertices[used], number[kept].reshape(-1, 3)


def _split_corners(
    triangles: Int[Array, "triangle 3"], points: Int[Array, "triangle 3"]
) -> Int[Array, "piece 3"]:
    """Pieces of triangles with a new point on none, one or two of their edges (-1 where there is none)."""
    count = (points >= 0).sum(axis=1)
    pieces = [triangles[count == 0]]
    corner, point = _turn(
        triangles[count == 1], points[count == 1], np.argmax(points[count == 1] >= 0, axis=1)
    )
    a, b, c, p = corner[:, 0], corner[:, 1], corner[:, 2], point[:, 0]
    pieces += [np.stack([a, p, c], 1), np.stack([p, b, c], 1)]
    corner, point = _turn(
        triangles[count == 2], points[count == 2], np.argmin(points[count == 2] >= 0, axis=1)
    )
    a, b, c, p, q = corner[:, 0], corner[:, 1], corner[:, 2], point[:, 1], point[:, 2]
    pieces += [np.stack([c, q, p], 1), np.stack([a, b, p], 1), np.stack([a, p, q], 1)]
    return np.concatenate(pieces)


def _turn(
    triangles: Int[Array, "triangle 3"], points: Int[Array, "triangle 3"], first: Int[Array, " triangle"]
) -> tuple[Int[Array, "triangle 3"], Int[Array, "triangle 3"]]:
    order = (first[:, None] + np.arange(3)) % 3
    return np.take_along_axis(triangles, order, 1), np.take_along_axis(points, order, 1)
