"""How thin a body is anywhere: rays from its faces through it to the face on the other side."""

from __future__ import annotations

from collections.abc import Sequence

import igl
import numpy as np
from jaxtyping import Bool, Float
from manifold3d import Manifold

from fabrication.bodies import mesh_of

Array = np.ndarray

RAYS = 20000
"""Rays shot through one body."""

OPPOSITE = -0.9
"""Cosine between two faces that bound one wall; two faces that meet in an edge are no wall."""

START_MM = 1e-4
"""How far inside the face a ray starts [mm]."""


SPECK_MM2, AROUND_MM = 30.0, 8.0
"""Thin places that show less area than this within so many mm are specks: the edge of a mark, a corner."""


GLUED_MM = 2.0
"""What lies this close to the part that a piece is glued to is no free wall [mm]."""


def thinnest_wall(
    solid: Manifold, reach_mm: float, rays: int = RAYS, glued_to: Sequence[Manifold] = ()
) -> float:
    """Thickness of the thinnest wall that is more than a speck [mm]; the reach where all are thicker.

    Args:
        solid: The body.
        reach_mm: Walls thicker than this are left out [mm].
        rays: How many places are looked at.
        glued_to: Other parts of the same piece. Where the cut between them runs close to a groove it leaves
            an edge that tapers to nothing, which the other part holds once they are glued.
    """
    walls, places = wall_thickness(solid, reach_mm, rays)
    share = solid.surface_area() / rays
    free = _far_from(places, glued_to)
    walls, places = walls[free], places[free]
    for index in range(len(walls)):
        near = np.linalg.norm(places[: index + 1] - places[index], axis=1) < AROUND_MM
        if near.sum() * share >= SPECK_MM2:
            return float(walls[index])
    return reach_mm


def wall_thickness(
    solid: Manifold, reach_mm: float, rays: int = RAYS
) -> tuple[Float[Array, " wall"], Float[Array, "wall 3"]]:
    """Thickness of a body's walls where they are thinner than a reach [mm], thinnest first, and where.

    Rays start from evenly spaced places of the surface, against the normal. What counts is a face on the
    other side that looks the other way; the slope of the far face is taken off.

    Args:
        solid: The body.
        reach_mm: Walls thicker than this are left out [mm].
        rays: How many places are looked at.
    """
    vertices, triangles = mesh_of(solid)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(areas, 1e-300)[:, None]
    edges = np.linspace(0.0, areas.sum(), rays, endpoint=False) + 0.5 * areas.sum() / rays
    chosen = np.minimum(np.searchsorted(np.cumsum(areas), edges), len(areas) - 1)
    starts = corners[chosen].mean(axis=1) - START_MM * normals[chosen]
    ends = starts - reach_mm * normals[chosen]
    found, places = [], []
    for start, end, normal in zip(starts, ends, normals[chosen], strict=True):
        hits = solid.ray_cast(tuple(start), tuple(end))
        if hits:
            facing = float(np.dot(hits[0].normal, normal))
            if facing < OPPOSITE:
                found.append(np.linalg.norm(np.asarray(hits[0].position) - start) * -facing + START_MM)
                places.append(start)
    order = np.argsort(found, kind="stable")
    return np.array(found, dtype=float)[order], np.array(places, dtype=float).reshape(-1, 3)[order]


def _far_from(places: Array, bodies: Sequence[Manifold]) -> Bool[Array, " place"]:
    far = np.ones(len(places), bool)
    for body in bodies if len(places) else ():
        vertices, triangles = mesh_of(body)
        far &= np.asarray(igl.point_mesh_squared_distance(places, vertices, triangles)[0]) > GLUED_MM**2
    return far
