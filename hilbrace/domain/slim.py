"""Flat maps that keep lengths as well as they can, from a conformal start.

Scalable locally injective mappings (Rabinovich, Poranne, Panozzo and Sorkine-Hornung 2017) lower the
symmetric Dirichlet energy, the area mean of ``|J|^2 + |J^-1|^2`` for the gradient J of the map: 4 where the
map keeps all lengths, and without bound where a triangle is about to turn over, so that no step can turn one.
Cells drawn on such a map have nearly one size everywhere; their angles give way instead.
"""

from __future__ import annotations

import igl
import numpy as np
from jaxtyping import Float, Int

from hilbrace.domain.deformation import local_edges
from hilbrace.errors import GeometryError

Array = np.ndarray

ITERATIONS = 60
"""Most steps; the braces of a knee are done after some 20."""
SETTLED = 1e-3
"""Share of the energy above its least possible value 4 below which a step is the last [-]."""
STRAINED = 0.01
"""Energy above 4 at which a start that cannot be left is no map to keep [-]."""


def slim(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    start: Float[Array, "vertex 2"],
) -> Float[Array, "vertex 2"]:
    """Lower the symmetric Dirichlet energy of a flat map of an open surface, windows allowed.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices.
        start: A flat map without turned triangles, of any scale.

    Returns:
        The map in units of the square root of the surface's area, not turned against the start.

    Raises:
        GeometryError: No step leaves the start, as needle triangles can have it.
    """
    surface = vertices / np.sqrt(np.linalg.det(local_edges(vertices, triangles)).sum() / 2.0)
    flat = start / np.sqrt(np.abs(_doubled_areas(start, triangles)).sum() / 2.0)
    data = igl.slim_precompute(
        np.asfortranarray(surface),
        np.asfortranarray(triangles.astype(np.int32)),
        np.asfortranarray(flat),
        igl.SYMMETRIC_DIRICHLET,
        np.zeros(0, np.int32),
        np.zeros((0, 2), order="F"),
        0.0,
    )
    first = energy = dirichlet_energy(surface, triangles, flat)
    solution = flat
    for _ in range(ITERATIONS):
        solution = np.array(igl.slim_solve(data, 1))
        before, energy = energy, dirichlet_energy(surface, triangles, solution)
        if before - energy <= SETTLED * (energy - 4.0):
            break
    if first > 4.0 + STRAINED and energy >= first:
        raise GeometryError(
            f"no step lowers the strain of the flat map (energy {first:.3f}, 4 is none)",
            where="domain.flatten = 'slim'",
            hint="mesh the surface without needle triangles, or take 'lscm' or 'periodic'",
        )
    return _turned_back(solution, flat)


def dirichlet_energy(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], uv: Float[Array, "vertex 2"]
) -> float:
    """Symmetric Dirichlet energy of a flat map [-]: 4 if it keeps all lengths, more otherwise."""
    edges = local_edges(vertices, triangles)
    corner = uv[triangles]
    gradient = np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], axis=-1) @ np.linalg.inv(
        edges
    )
    squares = (gradient**2).sum(axis=(1, 2))
    each = squares * (1.0 + 1.0 / np.linalg.det(gradient) ** 2)
    return float(np.average(each, weights=np.linalg.det(edges)))


def _doubled_areas(uv: Float[Array, "vertex 2"], triangles: Int[Array, "triangle 3"]) -> Array:
    corner = uv[triangles]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _turned_back(uv: Float[Array, "vertex 2"], start: Float[Array, "vertex 2"]) -> Float[Array, "vertex 2"]:
    """A map turned onto another one: the energy does not care how the map lies in the plane (Kabsch 1976)."""
    moved, held = uv - uv.mean(axis=0), start - start.mean(axis=0)
    left, _, right = np.linalg.svd(moved.T @ held)
    turn = left @ np.diag([1.0, np.linalg.det(left @ right)]) @ right
    return moved @ turn
