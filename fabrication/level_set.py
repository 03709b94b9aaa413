"""The body in which a function on a grid stays below a level, closed whatever the function.

Marching cubes leave holes where two of their faces disagree. Here each cube is cut into six tetrahedra along
its diagonal (Freudenthal 1942; Kuhn 1960), neighbours alike, and a tetrahedron is cut by a level in one way
only.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray

OFF_CORNER = 1e-6
"""Least part of an edge between its ends and the surface, so that no triangle loses its area [-]."""


def _paths() -> tuple[Int[Array, "six 4"], list[bool]]:
    """Corners of the six tetrahedra as bits x + 2 y + 4 z, and whether each is right-handed."""
    paths, right = [], []
    for order in permutations(range(3)):
        bits = np.cumsum([0, *(1 << axis for axis in order)])
        paths.append(bits)
        right.append(int(np.linalg.det(np.eye(3)[list(order)])) > 0)
    return np.array(paths), right


def _triangles_of(pattern: int, right: bool) -> list[list[tuple[int, int]]]:
    """Triangles of a tetrahedron of which some corners lie inside, as pairs (inside, outside) of corners."""
    inside = [corner for corner in range(4) if pattern >> corner & 1]
    outside = [corner for corner in range(4) if not pattern >> corner & 1]
    if not inside or not outside:
        return []
    if len(inside) == 2:
        (p, q), (r, s) = inside, outside
        found = [[(p, r), (q, s), (q, r)], [(p, r), (p, s), (q, s)]]
    else:
        found = [[(p, q) for p in inside for q in outside]]
    order = [*inside, *outside]
    even = np.linalg.det(np.eye(4)[order]) > 0
    return found if even == right else [triangle[::-1] for triangle in found]


def level_surface(
    values: Float[Array, "x y z"], level: float, low: Float[Array, "3"], cell: float
) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """The surface around all that is below a level; closed if nothing on the grid's border is.

    Args:
        values: The function at the places of the grid.
        level: The level.
        low: Position of the first place [mm].
        cell: Spacing of the grid [mm].

    Returns:
        Vertices [mm] and outward triangles.
    """
    shape = np.array(values.shape)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    flat, below = values.reshape(-1), (values < level).reshape(-1)
    offsets = np.array([[bit & 1, bit >> 1 & 1, bit >> 2 & 1] for bit in range(8)]) @ strides
    first = _crossed_cubes(below.reshape(values.shape)) @ strides
    keys = []
    for path, right in zip(*_paths(), strict=True):
        corners = first[:, None] + offsets[path]
        pattern = below[corners] @ np.array([1, 2, 4, 8])
        for number in range(1, 15):
            chosen = corners[pattern == number]
            for triangle in _triangles_of(number, right):
                ends = np.stack([np.sort(chosen[:, list(pair)], axis=1) for pair in triangle], axis=1)
                keys.append(ends[..., 0] * len(flat) + ends[..., 1])
    edges, triangles = np.unique(np.concatenate(keys), return_inverse=True)
    start, stop = edges // len(flat), edges % len(flat)
    part = np.clip((level - flat[start]) / (flat[stop] - flat[start]), OFF_CORNER, 1.0 - OFF_CORNER)
    ends = [np.stack(np.unravel_index(end, values.shape), axis=1) for end in (start, stop)]
    places = ends[0] + part[:, None] * (ends[1] - ends[0])
    return low + cell * places, triangles.reshape(-1, 3)


def _crossed_cubes(below: Array) -> Int[Array, "cube 3"]:
    """Cubes with corners on both sides of the level, by their first corner."""
    count = np.zeros(np.array(below.shape) - 1, int)
    for x in (0, 1):
        for y in (0, 1):
            for z in (0, 1):
                nx, ny, nz = (n - 1 for n in below.shape)
                count += below[x : x + nx, y : y + ny, z : z + nz]
    return np.argwhere((count > 0) & (count < 8))
