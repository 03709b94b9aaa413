"""Finer meshes: edges halved until none is longer than wanted, neighbours alike."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from hilbrace.domain.isoline import mesh_edges

Array = np.ndarray


def refined(
    points: Float[Array, "vertex 3"],
    vectors: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    length_mm: float,
) -> tuple[Float[Array, "new 3"], Float[Array, "new 3"], Int[Array, "piece 3"]]:
    """A mesh whose edges are halved until none is longer than wanted, and vectors linear on its triangles."""
    while True:
        edges, edge_of = mesh_edges(triangles)
        long = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) > length_mm
        if not long.any():
            return points, vectors, triangles
        new = np.full(len(edges), -1)
        new[long] = len(points) + np.arange(int(long.sum()))
        points, vectors = (
            np.concatenate([values, values[edges[long]].mean(axis=1)]) for values in (points, vectors)
        )
        triangles = _split(triangles, new[edge_of])


def _split(triangles: Int[Array, "triangle 3"], middles: Int[Array, "triangle 3"]) -> Int[Array, "piece 3"]:
    """Pieces of triangles with new points on some of their edges (-1 where there is none)."""
    count = (middles >= 0).sum(axis=1)
    pieces = [triangles[count == 0]]
    for times in (1, 2, 3):
        own, point = triangles[count == times], middles[count == times]
        lone = np.argmax(point >= 0, axis=1) if times == 1 else np.argmin(point >= 0, axis=1)
        turn = (lone[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(own, turn, axis=1).T
        ab, bc, ca = np.take_along_axis(point, turn, axis=1).T
        if times == 1:
            parts = [(a, ab, c), (ab, b, c)]
        elif times == 2:
            parts = [(c, ca, bc), (a, b, bc), (a, bc, ca)]
        else:
            parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        pieces += [np.stack(part, axis=1) for part in parts]
    return np.concatenate(pieces)
