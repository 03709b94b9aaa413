"""Values of the design and of the struts at the vertices of what is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from hilbrace.domain.domain import Domain
from hilbrace.pattern.axis import StrutAxis

Array = np.ndarray

_NEAREST = 16
"""Points of the axis that are tried for each vertex; they lie about half an edge apart."""
_TOUCH_MM = 0.05
"""How far outside of a disc a vertex still counts as touched by it [mm]."""


@dataclass(frozen=True)
class Places:
    """Where points lie on the domain.

    Attributes:
        triangle: Nearest triangle of each point.
        weight: Weights of its corners [-].
    """

    triangle: Int[Array, " point"]
    weight: Float[Array, "point 3"]

    def value(
        self, triangles: Int[Array, "triangle 3"], at_vertex: Float[Array, "vertex *more"]
    ) -> Float[Array, "point *more"]:
        """Values at the points, linear in the triangles.

        Args:
            triangles: ``triangles`` or ``cut_triangles`` of the domain.
            at_vertex: Values at the vertices that these index.
        """
        return np.einsum("pk,pk...->p...", self.weight, at_vertex[triangles[self.triangle]])


def places_on(domain: Domain, points: Float[Array, "point 3"]) -> Places:
    """Nearest place on the domain of each point."""
    found = igl.point_mesh_squared_distance(points, domain.vertices, domain.triangles)
    triangle, foot = np.asarray(found[1]).astype(np.int64), np.asarray(found[2])
    a, b, c = np.moveaxis(domain.vertices[domain.triangles[triangle]], 1, 0)
    first, second, away = b - a, c - a, foot - a
    g11, g12, g22 = (
        np.einsum("px,px->p", *pair) for pair in ((first, first), (first, second), (second, second))
    )
    h1, h2 = np.einsum("px,px->p", away, first), np.einsum("px,px->p", away, second)
    determinant = g11 * g22 - g12**2
    v, w = (g22 * h1 - g12 * h2) / determinant, (g11 * h2 - g12 * h1) / determinant
    weight = np.clip(np.stack([1 - v - w, v, w], axis=1), 0.0, 1.0)
    return Places(triangle, weight / weight.sum(axis=1, keepdims=True))


def local_widths(axis: StrutAxis, points: Float[Array, "point 3"]) -> Float[Array, " point"]:
    """Width of the strut at points in it: the largest disc inside the strut that holds the point [mm].

    Local thickness after Hildebrand and Rueegsegger (1997), with discs about the axis of the struts only. A
    point in a corner that no disc reaches takes the width of the nearest one.

    Args:
        axis: Axis of the struts, with its distance to the border.
        points: Points in the struts [mm].
    """
    count = min(_NEAREST, len(axis.points))
    distance, near = KDTree(axis.points).query(points, k=count, workers=-1)
    distance, near = (np.reshape(found, (len(points), count)) for found in (distance, near))
    radius = axis.radius[near]
    holding = np.where(distance <= radius + _TOUCH_MM, radius, 0.0).max(axis=1)
    return 2 * np.where(holding > 0, holding, radius[:, 0])


def nearest_values(points: Float[Array, "point 3"], known: Float[Array, "known 3"]) -> Int[Array, " point"]:
    """Index of the nearest known place of each point."""
    return np.asarray(KDTree(known).query(points, workers=-1)[1])
