"""Where a triangle mesh passes through itself.

The vertices are rounded to a grid of 2^20 steps over the mesh (half a micrometre on half a metre). On that
grid every orientation is a whole number below 2^63, so that each answer about two triangles is exact: nothing
depends on a tolerance. Pairs to compare come from a uniform grid of boxes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

Array = np.ndarray

STEPS = 2**20
"""Steps of the grid over the longest side of the mesh: the largest for which orientations fit 64 bits."""

_EDGES = ((0, 1), (1, 2), (2, 0))


class _Boxes(NamedTuple):
    """Corners of the boxes around triangles [steps]."""

    low: Int[Array, "triangle 3"]
    high: Int[Array, "triangle 3"]


def crossing_pairs(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Int[Array, "pair 2"]:
    """Pairs of triangles that cut or touch each other other than at the corners and edges they share.

    Two triangles in one plane count where they overlap, be they neighbours folded onto each other or not.
    Two in different planes count where they have a point in common that is no shared corner or edge.

    Args:
        vertices: Positions, of any unit.
        triangles: Vertex indices.

    Returns:
        Triangle numbers, the lower one first, in ascending order.
    """
    points = _on_grid(vertices)
    corners = points[triangles]
    pairs = _near(_Boxes(corners.min(axis=1), corners.max(axis=1)))
    found = _meet(points, triangles[pairs[:, 0]], triangles[pairs[:, 1]])
    return pairs[found]


def crossing_triangles(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Bool[Array, " triangle"]:
    """Triangles that take part in a self-intersection, see `crossing_pairs`."""
    hit = np.zeros(len(triangles), bool)
    hit[crossing_pairs(vertices, triangles)] = True
    return hit


def _on_grid(vertices: Float[Array, "vertex 3"]) -> Int[Array, "vertex 3"]:
    low = vertices.min(axis=0)
    extent = float((vertices.max(axis=0) - low).max())
    step = extent / STEPS if extent > 0.0 else 1.0
    return np.rint((vertices - low) / step).astype(np.int64)


def _near(boxes: _Boxes) -> Int[Array, "pair 2"]:
    """Pairs of triangles whose boxes touch.

    Each box is entered in all cells that it covers; a pair is taken in the one cell that holds the lower
    corner of what the two boxes have in common.
    """
    size = (boxes.high - boxes.low).max(axis=1)
    cell = max(int(1.2 * np.median(size)), int(size.max()) // 32, 1)
    owner, place = _entries(boxes.low // cell, boxes.high // cell)
    count = STEPS // cell + 1
    key = (place[:, 0] * count + place[:, 1]) * count + place[:, 2]
    order = np.lexsort((owner, key))
    owner, place, key = owner[order], place[order], key[order]
    kept = []
    first = np.arange(len(key))
    for lag in range(1, len(key)):
        first = first[first + lag < len(key)]
        first = first[key[first] == key[first + lag]]
        if not len(first):
            break
        one, two = owner[first], owner[first + lag]
        low = np.maximum(boxes.low[one], boxes.low[two])
        touch = _all(low <= np.minimum(boxes.high[one], boxes.high[two]))
        one, two, low, cells = one[touch], two[touch], low[touch], place[first[touch]]
        kept.append(np.column_stack([one, two])[_all(low // cell == cells)])
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *kept])
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _entries(
    low: Int[Array, "triangle 3"], high: Int[Array, "triangle 3"]
) -> tuple[Int[Array, " entry"], Int[Array, "entry 3"]]:
    """One row for each triangle and each cell that its box covers."""
    span = high - low + 1
    number = span.prod(axis=1)
    owner = np.repeat(np.arange(len(low)), number)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
    ny, nz = span[owner, 1], span[owner, 2]
    offset = np.column_stack([rank // (ny * nz), rank // nz % ny, rank % nz])
    return owner, low[owner] + offset


def _meet(
    points: Int[Array, "vertex 3"], one: Int[Array, "pair 3"], two: Int[Array, "pair 3"]
) -> Bool[Array, " pair"]:
    """Do the triangles of each pair have more in common than shared corners and edges?

    Pairs of which one lies on one side of the other's plane are left out at once.
    """
    met = np.zeros(len(one), bool)
    left = np.arange(len(one))
    sides: list[Array] = []
    for mine, other in ((one, two), (two, one)):
        corners = points[mine[left]]
        across = [_orient(*(corners[:, k] for k in range(3)), points[other[left, j]]) for j in range(3)]
        x, y, z = across
        reach = ~((x == y) & (y == z) & (x != 0))
        left = left[reach]
        sides = [side[reach] for side in (*sides, np.stack(across, axis=1))]
    side_two, side_one = sides
    one, two = one[left], two[left]
    a, b = points[one], points[two]
    flat = _all(side_one == 0) | _all(side_two == 0)
    met[left[flat]] = _overlap_in_plane(a[flat], b[flat])
    same = one[:, :, None] == two[:, None, :]
    apart = same.sum(axis=(1, 2)) < 2
    for mine, other, side, common in ((a, b, side_one, same.any(axis=2)), (b, a, side_two, same.any(axis=1))):
        for start, end in _EDGES:
            asked = apart & ~flat & ~common[:, start] & ~common[:, end]
            at = np.flatnonzero(asked & (side[:, start] * side[:, end] <= 0))
            met[left[at]] |= _pierces(mine[at, start], mine[at, end], other[at])
    return met


def _all(columns: Bool[Array, "pair 3"]) -> Bool[Array, " pair"]:
    """``columns.all(axis=1)``, which numpy does slowly on short rows."""
    return columns[:, 0] & columns[:, 1] & columns[:, 2]


def _pierces(
    start: Int[Array, "pair 3"], end: Int[Array, "pair 3"], triangle: Int[Array, "pair 3 3"]
) -> Bool[Array, " pair"]:
    """Does a segment that reaches the plane of a triangle pass through the triangle or its border?"""
    turns = np.stack([_orient(start, end, triangle[:, i], triangle[:, j]) for i, j in _EDGES], axis=1)
    return ((turns >= 0).all(axis=1) | (turns <= 0).all(axis=1)) & (turns != 0).any(axis=1)


def _overlap_in_plane(a: Int[Array, "pair 3 3"], b: Int[Array, "pair 3 3"]) -> Bool[Array, " pair"]:
    """Do triangles of one plane have inner points in common? Separating lines along their edges."""
    normal = np.abs(np.cross(a[:, 1] - a[:, 0], a[:, 2] - a[:, 0]))
    spare = np.abs(np.cross(b[:, 1] - b[:, 0], b[:, 2] - b[:, 0]))
    drop = np.where((normal == 0).all(axis=1, keepdims=True), spare, normal).argmax(axis=1)
    kept = np.array([[1, 2], [2, 0], [0, 1]])[drop]
    a, b = (np.take_along_axis(t, kept[:, None, :], axis=2) for t in (a, b))
    apart = np.zeros(len(a), bool)
    for mine, other in ((a, b), (b, a)):
        whole = np.sign(_turn(mine[:, 0], mine[:, 1], mine[:, 2]))
        for start, end in _EDGES:
            sides = [whole * _turn(mine[:, start], mine[:, end], other[:, k]) for k in range(3)]
            apart |= (np.stack(sides, axis=1) <= 0).all(axis=1)
    return ~apart


def _turn(p: Int[Array, "pair 2"], q: Int[Array, "pair 2"], r: Int[Array, "pair 2"]) -> Int[Array, " pair"]:
    return (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])


def _orient(
    p: Int[Array, "pair 3"], q: Int[Array, "pair 3"], r: Int[Array, "pair 3"], s: Int[Array, "pair 3"]
) -> Int[Array, " pair"]:
    """Sign of the volume of the tetrahedron p q r s: at most 3 * 2^61, hence exact in 64 bits."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (p - s).T, (q - s).T, (r - s).T
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return np.sign(volume)
