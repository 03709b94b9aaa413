"""The smooth passage from firm to soft: a band of a given width in mm along their border.

The border of whole triangles is jagged; it is ironed before the band is measured from it. The jagged map is
smoothed over about one edge of the mesh, and the line where the smooth map is one half is the border. Across
it the firm fraction climbs by the smoothstep ``3 x^2 - 2 x^3`` of the distance and is exactly 0 and 1 beyond
half the width to both sides, so that the pure microstructures, whose stiffness is known, begin there.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

Array = np.ndarray

IRON = 1.0
"""Length over which the border is ironed, in mean edges [-]."""
_NEAR = 8
"""Pieces of the border that may be nearest to a vertex, by their middles."""


def blend_map(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    firm: Bool[Array, " triangle"],
    width_mm: float,
) -> tuple[Float[Array, " vertex"], Float[Array, " triangle"]]:
    """Firm fraction across a band along the border (paper, Sec. 4.3: the blending map ``f_seg``).

    Distances are straight. On a limb of radius r that is short of the way along the skin by ``w^3 / (192
    r^2)`` at the band's edge: 0.06 mm for a band of 30 mm around a radius of 50 mm.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices of the closed mesh.
        firm: True where firm.
        width_mm: Width of the band in which the fraction is neither 0 nor 1 [mm].

    Returns:
        Firm fraction per vertex, and its mean per triangle [-].
    """
    smooth = ironed(vertices, triangles, firm, min(IRON * _mean_edge(vertices, triangles), width_mm / 2))
    start, end = _half_line(vertices, triangles, smooth)
    if not len(start):
        fraction = np.full(len(vertices), float(firm.mean() > 0.5))
        return fraction, fraction[triangles].mean(axis=1)
    distance = _distance_to_pieces(vertices, start, end)
    x = np.clip(0.5 + np.where(smooth >= 0.5, distance, -distance) / width_mm, 0.0, 1.0)
    fraction = x**2 * (3.0 - 2.0 * x)
    return fraction, fraction[triangles].mean(axis=1)


def ironed(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    firm: Bool[Array, " triangle"],
    length_mm: float,
) -> Float[Array, " vertex"]:
    """Firm share of each vertex, smoothed over a length.

    Solves ``(M + length^2 L) f = M chi`` with the lumped mass and the cotangent Laplacian, negative
    cotangents left out so that the values stay in [0, 1].

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices of the closed mesh.
        firm: True where firm.
        length_mm: Length over which a step decays to 1/e [mm].
    """
    count = len(vertices)
    p = vertices[triangles]
    double_area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    mass = np.bincount(triangles.ravel(), np.repeat(double_area / 6, 3), minlength=count)
    share = np.bincount(triangles.ravel(), np.repeat(firm * double_area / 6, 3), minlength=count)
    system = diags_array(mass) + length_mm**2 * _laplacian(vertices, triangles, double_area)
    factor = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return np.clip(factor.solve(share), 0.0, 1.0)


def _laplacian(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    double_area: Float[Array, " triangle"],
) -> csr_array:
    count = len(vertices)
    total = csr_array((count, count))
    for k in range(3):
        i, j = triangles[:, (k + 1) % 3], triangles[:, (k + 2) % 3]
        a, b = vertices[i] - vertices[triangles[:, k]], vertices[j] - vertices[triangles[:, k]]
        half_cotangent = np.maximum((a * b).sum(axis=1) / double_area, 0.0) / 2
        weights = coo_array((half_cotangent, (i, j)), shape=(count, count)).tocsr()
        weights = weights + weights.T
        total = total + diags_array(weights.sum(axis=1)) - weights
    return csr_array(total)


def _mean_edge(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> float:
    p = vertices[triangles]
    return float(np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).mean())


def _half_line(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], values: Float[Array, " vertex"]
) -> tuple[Float[Array, "piece 3"], Float[Array, "piece 3"]]:
    """Pieces of the line where a function that is linear in the triangles is one half."""
    high = values >= 0.5
    mixed = triangles[(high[triangles].sum(axis=1) % 3) > 0]
    lone = np.argmax(high[mixed] == (high[mixed].sum(axis=1) == 1)[:, None], axis=1)
    corner = np.take_along_axis(mixed, (lone[:, None] + np.arange(3)) % 3, axis=1)
    ends = []
    for other in (1, 2):
        a, b = corner[:, 0], corner[:, other]
        t = ((0.5 - values[a]) / (values[b] - values[a]))[:, None]
        ends.append((1.0 - t) * vertices[a] + t * vertices[b])
    return ends[0], ends[1]


def _distance_to_pieces(
    points: Float[Array, "point 3"], start: Float[Array, "piece 3"], end: Float[Array, "piece 3"]
) -> Float[Array, " point"]:
    """Distance of points to the nearest of some short straight pieces [mm]."""
    _, near = KDTree((start + end) / 2).query(points, k=min(_NEAR, len(start)))
    near = near.reshape(len(points), -1)
    origin, along = start[near], (end - start)[near]
    square = np.maximum((along**2).sum(axis=2), 1e-300)
    t = np.clip(((points[:, None] - origin) * along).sum(axis=2) / square, 0.0, 1.0)
    return np.linalg.norm(points[:, None] - origin - t[..., None] * along, axis=2).min(axis=1)
