"""Draft: groove walls that lean, so that the casting peels out of the core.

Each wall turns about its line half way up: at the limb the groove gets narrower and at the outer face wider,
both by half the thickness times the tangent of the draft. The groove keeps its cross-section to first order,
and the cavity its volume. What lies beside a wall moves along with it, less the further away it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from fabrication.mold import Casting
from hilbrace.pattern.offset import area_ratio
from hilbrace.pattern.thicken import border_edges

Array = np.ndarray

SQUEEZE = 0.3
"""A triangle beside a wall keeps at least this share of its area; else the draft is lowered there [-]."""
_FADE = 0.8
"""What each row of triangles passes on of a wall's motion [-]."""
_SWEEPS = 24
_ROUNDS = 16
_LOWERED = 0.7
_AROUND = 3
"""Rows of vertices around a squeezed triangle where the draft is lowered."""
_STILL_MM = 1e-7


@dataclass(frozen=True)
class Levels:
    """Where the vertices of a casting lie on the core.

    Attributes:
        floor: Bottom of the grooves [mm].
        top: Lands [mm].
        slant: Draft that each vertex of an outline got, of the one asked for [-]; 1 off the outlines.
    """

    floor: Float[Array, "vertex 3"]
    top: Float[Array, "vertex 3"]
    slant: Float[Array, " vertex"]


def drafted(casting: Casting, draft_deg: float) -> Levels:
    """Bottom of the grooves and lands of a casting with draft.

    Lands narrower than the draft, and struts, would shrink to nothing: there the walls stand steeper.

    Args:
        casting: A casting that knows its outline.
        draft_deg: Angle of the walls to the direction in which the brace is thick [deg].
    """
    groove = casting.covered | (casting.beyond == 1)
    outline, across = walls_of(casting, groove)
    half = casting.thickness[:, None] * np.tan(np.radians(draft_deg)) / 2
    slant = np.ones(len(casting.vertices))
    if not len(outline) or draft_deg == 0:
        return Levels(casting.vertices, casting.outer, slant)
    sides = (
        (casting.vertices, casting.triangles[groove], -1.0),
        (casting.outer, casting.triangles[~groove], 1.0),
    )
    neighbours = [_neighbours(points, triangles) for points, triangles, _ in sides]
    held = np.zeros(len(slant), dtype=bool)
    held[outline] = True
    moved: list[Array] = []
    for _ in range(_ROUNDS):
        moved, bad = [], np.zeros(len(slant), dtype=bool)
        for (points, triangles, sign), near in zip(sides, neighbours, strict=True):
            step = _spread(sign * slant[:, None] * half * across, held, near)
            moved.append(step)
            squeezed = area_ratio(points, triangles, step) < SQUEEZE
            bad[triangles[squeezed]] = True
        if not bad.any():
            break
        for near in neighbours * _AROUND:
            bad |= (near @ bad.astype(float)) > 0
        slant[bad & held] *= _LOWERED
    top = _on_surface(casting.outer, casting.triangles, moved[1])
    return Levels(casting.vertices + moved[0], top, slant)


def walls_of(
    casting: Casting, groove: Bool[Array, " triangle"]
) -> tuple[Int[Array, " outline"], Float[Array, "vertex 3"]]:
    """Vertices where walls stand, and at each vertex the unit direction out of the groove, 0 elsewhere."""
    edges = wall_edges(casting.triangles, groove)
    along = casting.vertices[edges[:, 1]] - casting.vertices[edges[:, 0]]
    across = np.zeros_like(casting.vertices)
    for k in range(2):
        np.add.at(across, edges[:, k], np.cross(along, casting.direction[edges[:, k]]))
    size = np.linalg.norm(across, axis=1, keepdims=True)
    outline = np.unique(edges)
    return outline, np.divide(across, size, out=np.zeros_like(across), where=size > 0)


def wall_edges(triangles: Int[Array, "triangle 3"], groove: Bool[Array, " triangle"]) -> Int[Array, "edge 2"]:
    """Directed edges between grooves and lands, groove on the left."""
    edges, open_edges = border_edges(triangles[groove]), border_edges(triangles)
    count = int(triangles.max()) + 1
    code, outside = (e[:, 0].astype(np.int64) * count + e[:, 1] for e in (edges, open_edges))
    return edges[~np.isin(code, outside)]


def _neighbours(points: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> csr_array:
    """Mean over neighbours as a matrix: near ones count more, so that needles move as a whole."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ends = np.concatenate([edges, edges[:, ::-1]])
    weight = 1.0 / np.maximum(np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1), 1e-6)
    total = np.bincount(ends[:, 0], weight, minlength=len(points))
    return csr_array((weight / total[ends[:, 0]], (ends[:, 0], ends[:, 1])), shape=(len(points),) * 2)


def _spread(
    step: Float[Array, "vertex 3"], held: Bool[Array, " vertex"], neighbours: csr_array
) -> Float[Array, "vertex 3"]:
    """Motion of the walls, fading into what lies beside them."""
    out = step.copy()
    for _ in range(_SWEEPS):
        out = np.where(held[:, None], step, _FADE * (neighbours @ out))
    return out


def _on_surface(
    points: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], step: Float[Array, "vertex 3"]
) -> Float[Array, "vertex 3"]:
    """Moved points, each on the surface itself: shells are cut with it."""
    moving = np.linalg.norm(step, axis=1) > _STILL_MM
    out = points.copy()
    if moving.any():
        found = igl.point_mesh_squared_distance(points[moving] + step[moving], points, triangles)
        out[moving] = np.asarray(found[2])
    return out
