"""Cut a surface along the zero line of a function that is linear in its triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.pattern.refine import RefinedSkin

Array = np.ndarray

SNAP_MM = 0.01
"""Depths nearer to zero are moved to this value, so that no vertex lies on the line [mm]."""


@dataclass(frozen=True)
class ZeroLine:
    """The line where the depth is zero: one point on each edge that it crosses, one segment per triangle.

    Attributes:
        depth: Depths of the vertices after snapping [mm].
        inner: Vertex of the crossed edge that lies in the solid.
        outer: The one that lies in the hole.
        t: Place on the edge, 0 at the inner vertex.
        points: Positions of the crossings [mm].
        segments: Crossings that one triangle joins, solid on the left seen from outside.
        triangle: That triangle.
    """

    depth: Float[Array, " vertex"]
    inner: Int[Array, " point"]
    outer: Int[Array, " point"]
    t: Float[Array, " point"]
    points: Float[Array, "point 3"]
    segments: Int[Array, "segment 2"]
    triangle: Int[Array, " segment"]


@dataclass(frozen=True)
class Cutout:
    """The part of the skin where the depth is positive.

    Attributes:
        vertices: Positions [mm].
        normals: Outward unit normals of the skin.
        triangles: Vertex indices, outward.
    """

    vertices: Float[Array, "vertex 3"]
    normals: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]


@dataclass(frozen=True)
class Lands:
    """The part of the skin where the depth is negative: windows between struts.

    Attributes:
        vertices: Positions of those vertices that the cutout lacks [mm].
        triangles: Outward; they index the cutout's vertices first, then these.
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]


def zero_line(skin: RefinedSkin, depth: Float[Array, " vertex"]) -> ZeroLine:
    """Find the zero line of a depth function."""
    depth = np.where(np.abs(depth) < SNAP_MM, np.where(depth > 0, SNAP_MM, -SNAP_MM), depth)
    solid = depth > 0
    inside = solid[skin.triangles].sum(axis=1)
    mixed = np.flatnonzero((inside == 1) | (inside == 2))
    lone = _lone_first(skin.triangles[mixed], solid, inside[mixed] == 1)
    crossed = np.stack([lone[:, [0, 1]], lone[:, [0, 2]]], axis=1).reshape(-1, 2)
    tail_solid = solid[crossed[:, 0]]
    edges = np.where(tail_solid[:, None], crossed, crossed[:, ::-1])
    code, point_of = np.unique(edges[:, 0] * len(depth) + edges[:, 1], return_inverse=True)
    inner, outer = np.divmod(code, len(depth))
    t = depth[inner] / (depth[inner] - depth[outer])
    segments = point_of.reshape(-1, 2)
    segments = np.where((inside[mixed] == 1)[:, None], segments, segments[:, ::-1])
    return ZeroLine(
        depth=depth,
        inner=inner,
        outer=outer,
        t=t,
        points=skin.vertices[inner] * (1 - t)[:, None] + skin.vertices[outer] * t[:, None],
        segments=segments,
        triangle=mixed,
    )


def cut_out(skin: RefinedSkin, line: ZeroLine) -> Cutout:
    """Keep the solid side of the zero line; neighbours share the cut points, so the result is a manifold."""
    triangles = _solid_side(skin, line)
    normals = skin.normals[line.inner] * (1 - line.t)[:, None] + skin.normals[line.outer] * line.t[:, None]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    whole = Cutout(
        np.concatenate([skin.vertices, line.points]), np.concatenate([skin.normals, normals]), triangles
    )
    return compact(whole, np.ones(len(triangles), dtype=bool))


def lands_beside(skin: RefinedSkin, line: ZeroLine) -> Lands:
    """The other side of the zero line, on the same cut points as `cut_out`: both together are the skin."""
    struts, holes = _solid_side(skin, line), _solid_side(skin, _turned(line))
    points = np.concatenate([skin.vertices, line.points])
    number = np.full(len(points), -1)
    shared = np.unique(struts)
    number[shared] = np.arange(len(shared))
    own = np.setdiff1d(holes, shared)
    number[own] = len(shared) + np.arange(len(own))
    return Lands(points[own], number[holes])


def compact(cutout: Cutout, keep: Bool[Array, " triangle"]) -> Cutout:
    """Keep some triangles and only the vertices that they use, in the old order."""
    used, triangles = np.unique(cutout.triangles[keep], return_inverse=True)
    return Cutout(cutout.vertices[used], cutout.normals[used], triangles.reshape(-1, 3))


def solid_fraction(
    skin: RefinedSkin, depth: Float[Array, " vertex"], areas: Float[Array, " triangle"]
) -> float:
    """Share of the skin's area where the depth, linear in each triangle, is positive.

    Args:
        skin: The refined skin.
        depth: Depths at its vertices [mm].
        areas: Areas of its triangles [mm^2].
    """
    a, b, c = np.sort(depth[skin.triangles], axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        one = c**2 / ((c - a) * (c - b))
        two = 1 - a**2 / ((c - a) * (b - a))
    part = np.where(a >= 0, 1.0, np.where(c <= 0, 0.0, np.where(b <= 0, one, two)))
    return float((part * areas).sum() / areas.sum())


def triangle_areas(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, " triangle"]:
    """Areas of triangles [mm^2]."""
    p = vertices[triangles]
    return np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2


def _solid_side(skin: RefinedSkin, line: ZeroLine) -> Int[Array, "triangle 3"]:
    """Triangles where the depth is positive; the cut points are numbered after the skin's vertices."""
    solid = line.depth > 0
    inside = solid[skin.triangles].sum(axis=1)
    mixed = skin.triangles[line.triangle]
    one = inside[line.triangle] == 1
    lone = _lone_first(mixed, solid, one)
    count = len(skin.vertices)
    near = count + np.where(one[:, None], line.segments, line.segments[:, ::-1])
    tip = np.stack([lone[one, 0], near[one, 0], near[one, 1]], axis=1)
    rest, cut = lone[~one], near[~one]
    first = np.stack([rest[:, 1], rest[:, 2], cut[:, 1]], axis=1)
    second = np.stack([rest[:, 1], cut[:, 1], cut[:, 0]], axis=1)
    return np.concatenate([skin.triangles[inside == 3], tip, first, second])


def _turned(line: ZeroLine) -> ZeroLine:
    """The same line with solid and hole exchanged."""
    return replace(
        line,
        depth=-line.depth,
        inner=line.outer,
        outer=line.inner,
        t=1 - line.t,
        segments=line.segments[:, ::-1],
    )


def _lone_first(
    triangles: Int[Array, "mixed 3"], solid: Bool[Array, " vertex"], one: Bool[Array, " mixed"]
) -> Array:
    """Turn each triangle so that the corner which differs from the other two comes first."""
    lone = np.argmax(solid[triangles] == one[:, None], axis=1)
    return np.take_along_axis(triangles, (lone[:, None] + np.arange(3)) % 3, axis=1)
