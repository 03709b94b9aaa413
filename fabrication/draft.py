"""Draft: groove walls that lean, so that the casting peels out of the core.

Each wall turns about its line half way up: at the limb the groove gets narrower and at the outer face wider,
both by half the thickness times the tangent of the draft. The groove keeps its cross-section to first order,
and the cavity its volume. What lies beside a wall moves along with it, less the further away it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from fabrication.mold import Casting
from fabrication.sheet import rim_of
from hilbrace.pattern.offset import area_ratio
from hilbrace.pattern.thicken import border_edges

Array = np.ndarray

SQUEEZE = 0.1
"""A triangle beside a wall keeps at least this share of its area; else the draft is lowered there [-]."""
FADE = 8.0
"""Length over which a wall's motion fades beside it, in such motions [-]."""
_ROUNDS = 40
_PATIENT = 4
"""Attempts after which the draft is lowered in one more row of vertices around a squeezed triangle."""
_LOWERED = 0.7
_SMOOTHINGS = 4
CREASE = 1e-7
"""Spread of the normals around a vertex, squared, above which it lies on a crease [-]."""


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
    half = casting.thickness * np.tan(np.radians(draft_deg)) / 2
    slant = np.ones(len(casting.vertices))
    if not len(outline) or draft_deg == 0:
        return Levels(casting.vertices, casting.outer, slant)
    fade = FADE * float(half.max())
    step = half[:, None] * across
    ends = rim_of(casting.triangles).vertices
    floor = _Side(casting.vertices, casting.triangles[groove], outline, ends, fade)
    top = _Side(casting.outer, casting.triangles[~groove], outline, ends, fade)
    for attempt in range(_ROUNDS):
        rows = 1 + attempt // _PATIENT
        bad = floor.squeezed(-slant[:, None] * step, rows) | top.squeezed(slant[:, None] * step, rows)
        if not bad.any():
            break
        slant[bad] *= _LOWERED
    return Levels(floor.moved(-slant[:, None] * step), top.moved(slant[:, None] * step), slant)


def walls_of(
    casting: Casting, groove: Bool[Array, " triangle"]
) -> tuple[Int[Array, " outline"], Float[Array, "vertex 3"]]:
    """Vertices where walls stand, and at each vertex the unit direction out of the groove, 0 elsewhere."""
    edges = wall_edges(casting.triangles, groove)
    along = casting.vertices[edges[:, 1]] - casting.vertices[edges[:, 0]]
    across = np.zeros_like(casting.vertices)
    for k in range(2):
        np.add.at(across, edges[:, k], np.cross(along, casting.direction[edges[:, k]]))
    outline = np.unique(edges)
    near = neighbour_mean(casting.vertices, edges)
    for _ in range(_SMOOTHINGS):
        across += _unit(near @ _unit(across)) * np.linalg.norm(across, axis=1, keepdims=True)
    return outline, _unit(across)


def wall_edges(triangles: Int[Array, "triangle 3"], groove: Bool[Array, " triangle"]) -> Int[Array, "edge 2"]:
    """Directed edges between grooves and lands, groove on the left."""
    edges, open_edges = border_edges(triangles[groove]), border_edges(triangles)
    count = int(triangles.max()) + 1
    code, outside = (e[:, 0].astype(np.int64) * count + e[:, 1] for e in (edges, open_edges))
    return edges[~np.isin(code, outside)]


def _unit(vectors: Float[Array, "vertex 3"]) -> Float[Array, "vertex 3"]:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)


def neighbour_mean(
    points: Float[Array, "vertex 3"], edges: Int[Array, "edge 2"], fade_mm: float = np.inf
) -> csr_array:
    """Mean over neighbours and, over the length given, nothing, as a matrix.

    Near neighbours count more, so that needles move as a whole.
    """
    ends = np.concatenate([edges, edges[:, ::-1]])
    weight = 1.0 / np.maximum(np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1), 1e-6)
    total = np.bincount(ends[:, 0], weight, minlength=len(points)) + 1.0 / fade_mm
    return csr_array((weight / total[ends[:, 0]], (ends[:, 0], ends[:, 1])), shape=(len(points),) * 2)


def _sides(triangles: Int[Array, "triangle 3"]) -> Int[Array, "edge 2"]:
    return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


class _Side:
    """One level of a casting, of which only what lies near its outline moves."""

    def __init__(
        self,
        points: Float[Array, "vertex 3"],
        triangles: Int[Array, "triangle 3"],
        outline: Int[Array, " outline"],
        ends: Int[Array, " end"],
        fade_mm: float,
    ) -> None:
        self.points, self.triangles = points, triangles
        edges = _sides(triangles)
        length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        self.rows = 2 + int(np.ceil(2 * fade_mm / np.median(length)))
        reached = np.zeros(len(points), dtype=bool)
        reached[outline] = True
        for _ in range(self.rows):
            reached[triangles[reached[triangles].any(axis=1)]] = True
        self.used = np.flatnonzero(reached)
        near = triangles[reached[triangles].all(axis=1)]
        self.near = np.searchsorted(self.used, near)
        self.held = np.isin(self.used, outline)
        self.pull = neighbour_mean(points[self.used], _sides(self.near), fade_mm)
        self.free = _free_directions(points, triangles, self.used)
        self.free[np.isin(self.used, ends)] = 0.0

    def spread(self, step: Float[Array, "vertex 3"]) -> Float[Array, "used 3"]:
        """Motion of the outline, fading into what lies beside it, within the surface."""
        wall = step[self.used]
        out = wall
        for _ in range(2 * self.rows):
            out = np.where(self.held[:, None], wall, self.pull @ out)
        return np.einsum("vxy,vy->vx", self.free, out)

    def squeezed(self, step: Float[Array, "vertex 3"], rows: int) -> Bool[Array, " vertex"]:
        """Vertices around triangles that a motion squeezes too much, some rows about them included."""
        ratio = area_ratio(self.points[self.used], self.near, self.spread(step))
        bad = np.zeros(len(self.used), dtype=bool)
        bad[self.near[ratio < SQUEEZE]] = True
        for _ in range(rows if bad.any() else 0):
            bad |= (self.pull @ bad.astype(float)) > 0
        out = np.zeros(len(self.points), dtype=bool)
        out[self.used[bad]] = True
        return out

    def moved(self, step: Float[Array, "vertex 3"]) -> Float[Array, "vertex 3"]:
        """All points after a motion."""
        out = self.points.copy()
        out[self.used] += self.spread(step)
        return out


def _free_directions(
    points: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], used: Int[Array, " used"]
) -> Float[Array, "used 3 3"]:
    """Projections of motions that keep vertices in the planes of all their triangles.

    In the plane of a flat part, along a crease, and not at all at a corner: what moves so stays on the
    surface that the shells are cut with.
    """
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    spread = np.zeros((len(used), 9))
    count = np.zeros(len(used))
    for k in range(3):
        at = number[triangles[:, k]]
        own = at >= 0
        outer = (normal[own, :, None] * normal[own, None, :]).reshape(-1, 9)
        for column in range(9):
            spread[:, column] += np.bincount(at[own], outer[:, column], minlength=len(used))
        count += np.bincount(at[own], minlength=len(used))
    values, axes = np.linalg.eigh((spread / count[:, None]).reshape(-1, 3, 3))
    axes = axes * (values < CREASE)[:, None, :]
    return np.einsum("vxk,vyk->vxy", axes, axes)
