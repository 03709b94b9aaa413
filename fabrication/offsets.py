"""Bodies of all points within a distance of a surface: walls of even thickness, free of folds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold
from scipy.spatial import KDTree

from fabrication.bodies import body_of, mesh_of
from fabrication.faces import vertex_normals
from fabrication.level_set import level_surface

Array = np.ndarray

CELL_MM = 3.0
"""Spacing of the grid on which distances are held [mm]."""

COARSE = 4
"""Cells of the fine grid along the edge of a coarse one, which tells where the fine one is needed."""

SMOOTH_MM = 0.03
"""How far the surface may move when flat neighbourhoods are given larger triangles [mm]."""


@dataclass(frozen=True)
class Surroundings:
    """The space around a surface, by its distance.

    Attributes:
        points: Dense points of the surface: their spacing must be small beside the distances asked for [mm].
        normals: Outward unit normals there.
        tree: Search tree of the points.
    """

    points: Float[Array, "point 3"]
    normals: Float[Array, "point 3"]
    tree: KDTree

    def distance(self, places: Float[Array, "place 3"]) -> Float[Array, " place"]:
        """Distance of places to the surface, negative on its inner side [mm]."""
        distance, nearest = self.tree.query(places)
        side = ((places - self.points[nearest]) * self.normals[nearest]).sum(axis=1)
        return np.where(side < 0, -distance, distance)


def surroundings(solid: Manifold, spacing_mm: float) -> Surroundings:
    """The space around a body.

    Args:
        solid: The body.
        spacing_mm: Largest distance between the points that stand for its surface [mm].
    """
    points, triangles = mesh_of(solid.refine_to_length(spacing_mm))
    return Surroundings(points, vertex_normals(points, triangles), KDTree(points))


def thick_body(around: Surroundings, radius_mm: float, cell_mm: float = CELL_MM) -> Manifold:
    """All that lies in a body or within a distance of it: the level set of its distance.

    A level set of a distance has no folds wherever the surface bends, unlike vertices moved along normals.

    Args:
        around: The space around the body.
        radius_mm: The distance [mm].
        cell_mm: Spacing of the grid [mm]. The body's surface lies within a few hundredths of a millimetre of
            the true one where that is flat over a cell.
    """
    pad = radius_mm + 2.0 * cell_mm
    low = around.points.min(axis=0) - pad
    blocks = np.ceil((around.points.max(axis=0) + pad - low) / (cell_mm * COARSE)).astype(int)
    distance = _distances(around, low, blocks, radius_mm, cell_mm)
    body = body_of(*level_surface(distance, radius_mm, low, cell_mm), "shell")
    return body.simplify(SMOOTH_MM)


def _distances(
    around: Surroundings, low: Array, blocks: Array, radius_mm: float, cell_mm: float
) -> Float[Array, "x y z"]:
    """Distance at each place of the grid: exact near the level, that of the coarse grid elsewhere [mm]."""
    coarse_mm = cell_mm * COARSE
    corners = np.stack(np.meshgrid(*(np.arange(n + 1) for n in blocks), indexing="ij"), axis=-1)
    coarse = around.distance(low + coarse_mm * corners.reshape(-1, 3)).reshape(tuple(blocks + 1))
    shape = tuple(blocks * COARSE + 1)
    nearest = [
        np.minimum((np.arange(n) + COARSE // 2) // COARSE, b) for n, b in zip(shape, blocks, strict=True)
    ]
    distance = coarse[np.ix_(*nearest)]
    reach = coarse_mm * np.sqrt(3.0) / 2.0 + 2.0 * cell_mm
    near = np.argwhere(np.abs(distance - radius_mm) < reach)
    distance[tuple(near.T)] = around.distance(low + cell_mm * near)
    return distance
