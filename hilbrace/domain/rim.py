"""The solid bands along the edges of the sleeve and around its windows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.domain.domain import Domain, RimBand
from hilbrace.errors import GeometryError

Array = np.ndarray


def rim_band(domain: Domain, width_mm: float) -> RimBand:
    """Triangles that become solid bands along both ends of the sleeve and around its windows.

    Args:
        domain: The design domain.
        width_mm: Width of the bands that the domain gives no width of their own (``Domain.rims``) [mm].

    Returns:
        The band; distances are straight lines to the loops' polylines.

    Raises:
        GeometryError: The bands leave no room for a pattern.
    """
    loops = (domain.upper_loop, domain.lower_loop, *domain.window_loops)
    own = domain.rims if len(domain.rims) else np.full(len(loops), np.nan)
    widths = np.where(np.isnan(own), width_mm, own)
    centres = domain.vertices[domain.triangles].mean(axis=1)
    centre_distance = np.stack([loop_distance(centres, domain.vertices[loop]) for loop in loops])
    vertex_distance = np.min(
        [loop_distance(domain.vertices, domain.vertices[loop]) for loop in loops], axis=0
    )
    band = np.any(centre_distance <= widths[:, None], axis=0)
    if band.all():
        raise GeometryError(
            f"solid bands of {widths.max():g} mm cover the whole brace",
            where="pattern.rim_mm",
            hint="lower pattern.rim_mm (or domain.upper_rim_mm, ...), or make the brace longer",
        )
    return RimBand(triangles=band, vertex_distance=vertex_distance, width_mm=float(width_mm))


def loop_distance(points: Float[Array, "point 3"], loop: Float[Array, "corner 3"]) -> Float[Array, " point"]:
    """Distance of points to a closed polyline [mm]."""
    nearest = np.full(len(points), np.inf)
    for start, step in zip(loop, np.roll(loop, -1, axis=0) - loop, strict=True):
        away = points - start
        part = np.clip(away @ step / (step @ step), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(away - part[:, None] * step, axis=1))
    return nearest
