"""How far, and which way, the outer face may lie from the skin without turning over or running into itself.

Where skin bends inwards (the front of the ankle, the hollow of the knee) the normals of the two flanks meet.
First the normals there are smoothed, so that they fan out evenly; where that is not enough the thickness is
lowered, gently towards the place. Both are decided on the domain's own mesh: inside one of its triangles the
outer face is a linear image of the inner one.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.domain.domain import Domain
from hilbrace.errors import GeometryError
from hilbrace.pattern.refine import vertex_normals

Array = np.ndarray

LEAST_SHARE = 0.4
"""Share of the wanted thickness that must be left everywhere [-]."""
SQUEEZE = 0.3
"""An outer triangle keeps at least this share of the area of its inner one [-]."""
SLOPE = 0.25
"""Largest change of thickness over the length where it was lowered [mm/mm]."""
_LEAN = 0.5
"""Cosine of the angle by which a smoothed normal may lean away from that of a triangle."""
_CLEAR = 0.95
"""Distance that outer points keep from the rest of the skin, as a share of their thickness [-]."""
_SMOOTHINGS = 30
_ROUNDS = 60
_STEP = 0.9


@dataclass(frozen=True)
class Offset:
    """The outer face over the vertices of the domain.

    Attributes:
        direction: Unit directions [-].
        thickness: Distances along them [mm].
    """

    direction: Float[Array, "vertex 3"]
    thickness: Float[Array, " vertex"]

    @property
    def vector(self) -> Float[Array, "vertex 3"]:
        """From the skin to the outer face [mm]."""
        return self.direction * self.thickness[:, None]


def safe_offset(domain: Domain, thickness_mm: float) -> Offset:
    """Directions and thickness of a brace whose outer face is sound.

    Args:
        domain: The design domain.
        thickness_mm: Wanted thickness [mm].

    Raises:
        GeometryError: Less than `LEAST_SHARE` of the thickness would be left somewhere.
    """
    direction = _smoothed(domain, thickness_mm)
    thickness = np.full(len(direction), float(thickness_mm))
    edges = _edges(domain.triangles)
    length = np.linalg.norm(domain.vertices[edges[:, 0]] - domain.vertices[edges[:, 1]], axis=1)
    for _ in range(_ROUNDS):
        bad = _squeezed(domain, direction * thickness[:, None]) | _colliding(domain, direction, thickness)
        if not bad.any():
            return Offset(direction, thickness)
        thickness[bad] *= _STEP
        _check(domain, thickness, thickness_mm)
        thickness = _sloped(thickness, edges, length)
    return Offset(direction, thickness)


def area_ratio(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    vector: Float[Array, "vertex 3"],
) -> Float[Array, " triangle"]:
    """Area of each outer triangle, seen along the inner one's normal, over the inner area [-].

    Negative where the triangle is turned over. The smaller of the ratios half way and all the way out.
    """
    inner = vertices[triangles]
    normal = np.cross(inner[:, 1] - inner[:, 0], inner[:, 2] - inner[:, 0])
    size = np.einsum("tx,tx->t", normal, normal)
    ratio = np.full(len(triangles), np.inf)
    for part in (0.5, 1.0):
        outer = (vertices + part * vector)[triangles]
        turned = np.cross(outer[:, 1] - outer[:, 0], outer[:, 2] - outer[:, 0])
        ratio = np.minimum(ratio, np.einsum("tx,tx->t", turned, normal) / size)
    return ratio


def _smoothed(domain: Domain, thickness_mm: float) -> Float[Array, "vertex 3"]:
    """Vertex normals, averaged over their neighbours where the offset squeezes triangles."""
    triangles = domain.triangles
    first = vertex_normals(domain)
    corners = domain.vertices[triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    edges = _edges(triangles)
    both = np.concatenate([edges, edges[:, ::-1]])
    direction = first.copy()
    for _ in range(_SMOOTHINGS):
        bad = _squeezed(domain, thickness_mm * direction)
        if not bad.any():
            break
        bad[both[bad[both[:, 1]], 0]] = True
        mean = direction.copy()
        np.add.at(mean, both[:, 0], direction[both[:, 1]])
        mean /= np.linalg.norm(mean, axis=1, keepdims=True)
        trial = np.where(bad[:, None], mean, direction)
        leaning = np.zeros(len(trial), dtype=bool)
        leaning[triangles[(np.einsum("tkx,tx->tk", trial[triangles], face) < _LEAN).any(axis=1)]] = True
        direction = np.where(leaning[:, None], direction, trial)
    return direction


def _squeezed(domain: Domain, vector: Float[Array, "vertex 3"]) -> Bool[Array, " vertex"]:
    """Corners of triangles that the offset squeezes too much."""
    bad = np.zeros(len(vector), dtype=bool)
    bad[domain.triangles[area_ratio(domain.vertices, domain.triangles, vector) < SQUEEZE]] = True
    return bad


def _colliding(
    domain: Domain, direction: Float[Array, "vertex 3"], thickness: Float[Array, " vertex"]
) -> Bool[Array, " vertex"]:
    """Vertices whose outer point comes too near to a part of the skin that is not around them."""
    outer = domain.vertices + thickness[:, None] * direction
    squared, _, foot = igl.point_mesh_squared_distance(outer, domain.vertices, domain.triangles)
    elsewhere = np.linalg.norm(foot - domain.vertices, axis=1) > 1.5 * thickness
    return elsewhere & (np.sqrt(squared) < _CLEAR * thickness)


def _sloped(
    thickness: Float[Array, " vertex"], edges: Int[Array, "edge 2"], length: Float[Array, " edge"]
) -> Float[Array, " vertex"]:
    """Thickness lowered so that it nowhere climbs faster than `SLOPE`."""
    out = thickness.copy()
    while True:
        before = out.copy()
        for a, b in ((0, 1), (1, 0)):
            np.minimum.at(out, edges[:, a], out[edges[:, b]] + SLOPE * length)
        if np.allclose(before, out, atol=1e-9):
            return out


def _check(domain: Domain, thickness: Float[Array, " vertex"], wanted_mm: float) -> None:
    worst = int(thickness.argmin())
    if thickness[worst] >= LEAST_SHARE * wanted_mm:
        return
    place = ", ".join(f"{x:.0f}" for x in domain.vertices[worst])
    raise GeometryError(
        f"a brace {wanted_mm:g} mm thick folds where the skin bends inwards: near ({place}) mm only "
        f"{thickness[worst]:.1f} mm fit",
        where="material.thickness_mm",
        hint=f"lower material.thickness_mm to about {thickness[worst] / LEAST_SHARE / 1.2:.1f}, or move the "
        "edges or windows of the brace so that they leave the fold out",
    )


def offset_volume(domain: Domain, offset: Offset, share: Float[Array, " triangle"]) -> float:
    """Volume between the skin and the outer face, each triangle weighed by a share of it [mm^3].

    Area of the mid-surface times thickness across it.

    Args:
        domain: The design domain.
        offset: The outer face.
        share: Filled share of each triangle [-].
    """
    corners = (domain.vertices + offset.vector / 2)[domain.triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    across = offset.vector[domain.triangles].mean(axis=1)
    return float((np.einsum("tx,tx->t", area, across) * share).sum())


def _edges(triangles: Int[Array, "triangle 3"]) -> Int[Array, "edge 2"]:
    return np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
