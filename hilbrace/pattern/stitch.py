"""Joining the two sides of a free seam.

A map with a free seam (LSCM, SLIM) has two copies of it, which differ by a slowly varying similarity and not
by whole periods of the cells: the pattern left of the seam does not continue the one right of it. They are
joined as cloth is, by a solid strip to which both sides hold. The seam itself is a path of mesh edges and
zigzags by half an edge; the strip runs along its smoothed course, and what lies between the two takes its
values from the map of the other side, continued beyond its edge by the similarity of the two copies nearby.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from hilbrace.domain.domain import Domain
from hilbrace.pattern.refine import RefinedSkin

Array = np.ndarray

SMOOTHING_MM = 25.0
"""Length over which the course of the seam is smoothed [mm]."""
SIMILAR_MM = 20.0
"""Length of seam over which the similarity of its two copies is fitted [mm]."""
_BAND = 4.0
"""Half width of the band in which sides may change, in mean edges of the seam [-]."""


@dataclass(frozen=True)
class FlatValues:
    """What the refined skin takes from the cut map.

    Attributes:
        uv: Flat coordinates [-].
        value: A quantity given at the cut vertices.
        strip_depth: Depth inside the strip along a free seam, negative outside of it [mm]; minus infinity
            where there is no seam near.
    """

    uv: Float[Array, "vertex 2"]
    value: Float[Array, " vertex"]
    strip_depth: Float[Array, " vertex"]


def flat_values(
    domain: Domain, skin: RefinedSkin, value: Float[Array, " cut_vertex"], strip_mm: float
) -> FlatValues:
    """Bring flat coordinates and a quantity of the cut mesh to the refined skin, stitched at a free seam.

    Args:
        domain: The design domain.
        skin: Its refined mesh.
        value: The quantity at the cut vertices.
        strip_mm: Width of the strip along a free seam [mm].
    """
    uv = np.stack([skin.from_vertices(domain.cut_triangles, domain.uv[:, k]) for k in range(2)], axis=1)
    fine = skin.from_vertices(domain.cut_triangles, value)
    strip = np.full(len(uv), -np.inf)
    if domain.period_u > 0:
        return FlatValues(uv, fine, strip)
    path = domain.vertices[domain.weld[domain.seam_pairs[:, 0]]]
    edge = float(np.linalg.norm(np.diff(path, axis=0), axis=1).mean())
    near = np.flatnonzero(KDTree(path).query(skin.vertices, distance_upper_bound=_BAND * edge)[0] < np.inf)
    own = _on_left_copy(domain, skin, near)
    away = _signed_distance(skin, near, _smoothed(path, edge), own)
    strip[near] = strip_mm / 2 - np.abs(away)
    for left in (True, False):
        moved = near[(own == left) & ((away > 0) != left)]
        uv[moved], fine[moved] = _other_side(
            domain, path, value, skin.vertices[moved], uv[moved], fine[moved], left
        )
    return FlatValues(uv, fine, strip)


def _on_left_copy(domain: Domain, skin: RefinedSkin, near: Int[Array, " near"]) -> Bool[Array, " near"]:
    """Whether vertices belong to triangles beside the seam's left copy rather than its right one."""
    edges = domain.cut_triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    points = domain.vertices[domain.weld]
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    graph = coo_array((length, edges.T), shape=(len(points), len(points))).tocsr()
    left, right = (
        dijkstra(graph, directed=False, indices=domain.seam_pairs[:, k], min_only=True) for k in range(2)
    )
    corners = domain.cut_triangles[skin.parent[near]]
    return (left - right)[corners].sum(axis=1) < 0


def _smoothed(path: Float[Array, "point 3"], edge_mm: float) -> Float[Array, "point 3"]:
    """The polyline averaged over `SMOOTHING_MM`; its ends stay."""
    smooth = path.copy()
    for _ in range(max(1, round(2 * (SMOOTHING_MM / edge_mm) ** 2))):
        smooth[1:-1] = (smooth[:-2] + 2 * smooth[1:-1] + smooth[2:]) / 4
    return smooth


def _signed_distance(
    skin: RefinedSkin, near: Int[Array, " near"], line: Float[Array, "point 3"], own: Bool[Array, " near"]
) -> Float[Array, " near"]:
    """Distance to a line within the skin [mm], positive on the side where the left copy mostly is."""
    points, normals = skin.vertices[near], skin.normals[near]
    piece, t = _nearest(line, points)
    along = line[piece + 1] - line[piece]
    away = points - line[piece] - t[:, None] * along
    away -= np.einsum("px,px->p", away, normals)[:, None] * normals
    across = np.einsum("px,px->p", away, np.cross(along, normals))
    signed = np.sign(across) * np.linalg.norm(away, axis=1)
    return signed if (np.where(own, signed, -signed)).sum() > 0 else -signed


def _other_side(
    domain: Domain,
    path: Float[Array, "point 3"],
    value: Float[Array, " cut_vertex"],
    points: Float[Array, "moved 3"],
    uv: Float[Array, "moved 2"],
    fine: Float[Array, " moved"],
    left: bool,
) -> tuple[Float[Array, "moved 2"], Float[Array, " moved"]]:
    """Coordinates and values of points in the map of the other side, continued beyond the seam."""
    own, other = domain.seam_pairs[:, :: 1 if left else -1].T
    at, to = _complex(domain.uv[own]), _complex(domain.uv[other])
    place = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    weight = np.exp(-((place[:, None] - place) ** 2) / (2 * SIMILAR_MM**2))
    weight /= weight.sum(axis=1, keepdims=True)
    at_mean, to_mean = weight @ at, weight @ to
    from_here, there = at - at_mean[:, None], to - to_mean[:, None]
    turn = (weight * from_here.conj() * there).sum(axis=1) / (weight * np.abs(from_here) ** 2).sum(axis=1)
    miss = to - (to_mean + turn * (at - at_mean))
    step = value[other] - value[own]

    piece, t = _nearest(path, points)
    z = _complex(uv)

    def seen_from(k: Int[Array, " moved"]) -> Array:
        return to_mean[k] + turn[k] * (z - at_mean[k]) + miss[k]

    moved = (1 - t) * seen_from(piece) + t * seen_from(piece + 1)
    return np.stack([np.real(moved), np.imag(moved)], axis=1), fine + (1 - t) * step[piece] + t * step[
        piece + 1
    ]


def _nearest(
    line: Float[Array, "point 3"], points: Float[Array, "place 3"]
) -> tuple[Int[Array, " place"], Float[Array, " place"]]:
    """Nearest piece of a polyline, and where on it, from 0 to 1."""
    start, along = line[:-1], np.diff(line, axis=0)
    count = min(4, len(start))
    near = np.asarray(KDTree(start + along / 2).query(points, k=count)[1]).reshape(len(points), count)
    away = points[:, None] - start[near]
    t = np.clip((away * along[near]).sum(axis=2) / (along[near] ** 2).sum(axis=2), 0, 1)
    best = np.linalg.norm(away - t[..., None] * along[near], axis=2).argmin(axis=1)
    rows = np.arange(len(points))
    return near[rows, best], t[rows, best]


def _complex(uv: Float[Array, "point 2"]) -> Array:
    return uv[:, 0] + 1j * uv[:, 1]
