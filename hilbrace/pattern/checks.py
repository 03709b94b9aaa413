"""Whether a body can be made: closed, in one piece, thick enough everywhere."""

from __future__ import annotations

import manifold3d
import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray


def is_watertight(triangles: Int[Array, "triangle 3"]) -> bool:
    """Every edge belongs to two triangles that run along it in opposite directions."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    size = int(triangles.max(initial=0)) + 1
    forward = np.sort(edges[:, 0] * size + edges[:, 1])
    backward = np.sort(edges[:, 1] * size + edges[:, 0])
    return bool(len(forward)) and bool((np.diff(forward) > 0).all()) and np.array_equal(forward, backward)


def part_count(body: manifold3d.Manifold) -> int:
    """Connected pieces of a body."""
    return len(body.decompose())


def measured_thickness(
    body: manifold3d.Manifold,
    points: Float[Array, "point 3"],
    normals: Float[Array, "point 3"],
    reach_mm: float,
) -> Float[Array, " point"]:
    """Thickness along rays that enter the body through its inner face [mm].

    Args:
        body: The body.
        points: Places on its inner face [mm].
        normals: Outward directions of the rays.
        reach_mm: Length of the rays [mm].

    Returns:
        Distance between entry and exit; 0 where a ray misses the body.
    """
    start, end = points - 0.5 * normals, points + reach_mm * normals
    thickness = np.zeros(len(points))
    for k in range(len(points)):
        hits = body.ray_cast(tuple(start[k]), tuple(end[k]))
        if len(hits) >= 2:
            thickness[k] = np.linalg.norm(np.subtract(hits[1].position, hits[0].position))
    return thickness


def spread_sample(count: int, wanted: int) -> Int[Array, " sample"]:
    """Evenly spaced indices, at most ``wanted`` of ``count``."""
    return np.unique(np.linspace(0, count - 1, min(wanted, count)).round().astype(np.intp))
