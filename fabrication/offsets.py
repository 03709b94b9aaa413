"""Bodies of all points within a distance of a surface: walls of even thickness around a limb, free of folds."""

from __future__ import annotations

import igl
import numpy as np
from jaxtyping import Float
from manifold3d import Manifold
from scipy.spatial import KDTree

from fabrication.bodies import body_of

Array = np.ndarray

CELL_MM = 3.0
"""Spacing of the grid on which distances are held [mm]."""

COARSE = 4
"""Cells of the fine grid along the edge of a coarse one, which tells where the fine one is needed."""

SMOOTH_MM = 0.02
"""How far the surface may move when flat neighbourhoods are given larger triangles [mm]."""


def thick_body(
    points: Float[Array, "point 3"], radius_mm: float, cell_mm: float = CELL_MM, tree: KDTree | None = None
) -> Manifold:
    """All that lies within a distance of a cloud of points: the level set of their distance.

    A level set of a distance has no folds wherever the surface bends, unlike vertices moved along normals.

    Args:
        points: Dense points of a surface: their spacing must be small beside the radius [mm].
        radius_mm: The distance [mm].
        cell_mm: Spacing of the grid [mm]. The body's surface lies within a few hundredths of a millimetre of
            the true one where that is flat over a cell.
        tree: Search tree of the points, where one exists.

    Raises:
        GeometryError: The level set does not close.
    """
    tree = tree or KDTree(points)
    pad = radius_mm + 2.0 * cell_mm
    low = points.min(axis=0) - pad
    blocks = np.ceil((points.max(axis=0) + pad - low) / (cell_mm * COARSE)).astype(int)
    distance = _distances(tree, low, blocks, radius_mm, cell_mm)
    shape = np.array(distance.shape)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape[::-1]), indexing="ij"), axis=-1)
    grid = low + cell_mm * grid.reshape(-1, 3)[:, ::-1]
    order = np.ascontiguousarray(distance.transpose(2, 1, 0).reshape(-1))
    vertices, triangles, _ = igl.marching_cubes(order, np.ascontiguousarray(grid), *map(int, shape), radius_mm)
    return _outward(vertices, triangles).simplify(SMOOTH_MM)


def _distances(
    tree: KDTree, low: Array, blocks: Array, radius_mm: float, cell_mm: float
) -> Float[Array, "x y z"]:
    """Distance at each place of the grid: exact near the level, that of the coarse grid elsewhere [mm]."""
    coarse_mm = cell_mm * COARSE
    corners = np.stack(np.meshgrid(*(np.arange(n + 1) for n in blocks), indexing="ij"), axis=-1)
    coarse, _ = tree.query(low + coarse_mm * corners.reshape(-1, 3))
    coarse = coarse.reshape(tuple(blocks + 1))
    shape = tuple(blocks * COARSE + 1)
    nearest = [np.minimum((np.arange(n) + COARSE // 2) // COARSE, b) for n, b in zip(shape, blocks, strict=True)]
    distance = coarse[np.ix_(*nearest)]
    reach = coarse_mm * np.sqrt(3.0) / 2.0 + 2.0 * cell_mm
    near = np.argwhere(np.abs(distance - radius_mm) < reach)
    distance[tuple(near.T)], _ = tree.query(low + cell_mm * near)
    return distance


def _outward(vertices: Array, triangles: Array) -> Manifold:
    body = body_of(vertices, triangles, "shell")
    return body if body.volume() > 0 else body_of(vertices, triangles[:, ::-1], "shell")
