"""The line through a sleeve from a file, and where it begins and ends along that line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize
from scipy.spatial import ConvexHull

from fabrication.foreign_brace import Mesh, parts_of
from fabrication.halving import refined
from hilbrace.errors import GeometryError

Array = np.ndarray

HOLLOW = 0.2
"""Least distance of a sleeve from its axis over the mean one; below, a line through it is no axis [-]."""
OPEN_MM = 0.02
"""How far the upper edge reaches into the gutter, so that it opens onto it."""
_RIM_MM = 15.0
_BIN_MM = 4.0
_CREST_MM = 3.0
_UPWARD = 0.6
_NOTCH = 3
_FEW = 8000
_FINENESS = 30
_WAYS = 600


def tube_axis(brace: Mesh, where: str) -> Float[Array, "3"]:
    """Unit axis of a sleeve: the line through it that keeps furthest off its walls; upwards or forwards.

    Raises:
        GeometryError: The brace is no sleeve.
    """
    size = float(np.ptp(brace.vertices, axis=0).max())
    dense, _, _ = refined(brace.vertices, brace.vertices, brace.triangles, size / _FINENESS)
    away = dense - surface_centre(brace)
    few = away[:: max(1, len(away) // _FEW)]
    squared = (few**2).sum(axis=1)[:, None]
    ways = _half_sphere()
    radius = np.sqrt(np.maximum(squared - (few @ ways.T) ** 2, 0.0))
    freedom = radius.min(axis=0) / radius.mean(axis=0)
    best, free = ways[int(np.argmax(freedom))], float(freedom.max())
    if free < HOLLOW:
        raise GeometryError(
            "the brace is neither flat nor a sleeve around a limb: no straight line runs through its middle "
            "without coming near to it",
            where=where,
            hint="design it with hilbrace, which knows bent limbs, or cast its parts one by one",
        )
    axis = _shortest(away, best)
    return axis * np.sign(axis[np.argmax(np.abs(axis))])


def surface_centre(mesh: Mesh) -> Float[Array, "3"]:
    """Centroid of a surface [mm]."""
    p = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return (p.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum()


def _half_sphere() -> Float[Array, "way 3"]:
    """Directions evenly spread over a half sphere (golden spiral), and the axes."""
    number = np.arange(_WAYS)
    z = (number + 0.5) / _WAYS
    turn = number * np.pi * (3 - np.sqrt(5))
    wide = np.sqrt(1 - z**2)
    return np.concatenate([np.eye(3), np.stack([wide * np.cos(turn), wide * np.sin(turn), z], axis=1)])


def _shortest(points: Float[Array, "point 3"], axis: Float[Array, "3"]) -> Float[Array, "3"]:
    """The unit direction near an axis in which points reach least far: across both edges of a sleeve."""
    corners = points[ConvexHull(points).vertices]
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    sides = np.stack([first, np.cross(axis, first)])

    def turned(tilt: Float[Array, "2"]) -> Float[Array, "3"]:
        way = axis + tilt @ sides
        return way / np.linalg.norm(way)

    found = minimize(
        lambda tilt: float(np.ptp(corners @ turned(tilt))),
        np.zeros(2),
        method="Nelder-Mead",
        options={"initial_simplex": [[0, 0], [0.2, 0], [0, 0.2]], "xatol": 1e-4, "fatol": 1e-4},
    )
    return turned(found.x)


@dataclass(frozen=True)
class Span:
    """Where a sleeve begins and ends along its axis.

    Attributes:
        centre: A point of the axis [mm].
        axes: Two unit directions across it, and itself.
        low: Height of the lower edge [mm], from the centre.
        high: Heights of the upper edge, evenly spaced around [mm].
    """

    centre: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    low: float
    high: Float[Array, " bin"]

    def local(self, points: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """Coordinates of points across and along the axis [mm]."""
        return (points - self.centre) @ self.axes.T

    def upper(self, local: Float[Array, "point any"]) -> Float[Array, " point"]:
        """Height of the upper edge at the angles of points [mm]."""
        count = len(self.high)
        turn = np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) * count % count
        return np.interp(turn, np.arange(count + 1), np.append(self.high, self.high[0]))


def span_of(brace: Mesh, up: Float[Array, "3"]) -> Span:
    """Where a sleeve begins and ends.

    The upper edge is the lower one of the two around the rim's top, at the inner or the outer face: there the
    gutter opens onto the whole rim, also onto one that waves or leans. Notches in the rim are passed over.

    Args:
        brace: The sleeve [mm].
        up: Unit axis.
    """
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(up, first), up])
    centre = surface_centre(brace)
    local = (brace.vertices - centre) @ axes.T
    corners = local[brace.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    upward = normal[:, 2] > _UPWARD * np.linalg.norm(normal, axis=1)
    near = upward & (corners[..., 2].max(axis=1) > local[:, 2].max() - _RIM_MM)
    used, triangles = np.unique(brace.triangles[near], return_inverse=True)
    rim, _, triangles = refined(local[used], local[used], triangles.reshape(-1, 3), _BIN_MM / 2)
    count = int(np.ceil(2 * np.pi * np.median(np.linalg.norm(rim[:, :2], axis=1)) / _BIN_MM))
    place = np.floor(np.arctan2(rim[:, 1], rim[:, 0]) / (2 * np.pi) * count + 0.5).astype(int) % count
    crest = _most(place, rim[:, 2], count)
    # of all faces that look up only those of the rim itself, not the windows' lower edges
    tops = np.zeros(len(rim), dtype=bool)
    for part in parts_of(triangles):
        own = np.unique(triangles[part])
        tops[own] = np.median(crest[place[own]] - rim[own, 2]) < _CREST_MM / 2
    tops &= rim[:, 2] > crest[place] - _CREST_MM
    lower = -_most(place[tops], -rim[tops, 2], count)
    known = np.flatnonzero(np.isfinite(lower))
    lower = np.interp(np.arange(count), known, lower[known], period=count)
    around = np.stack([np.roll(lower, k) for k in range(-_NOTCH, _NOTCH + 1)]).max(axis=0)
    high = np.where(lower > around - _CREST_MM, lower, around)
    return Span(centre, axes, float(local[:, 2].min()), high - OPEN_MM)


def _most(place: Int[Array, " point"], value: Float[Array, " point"], count: int) -> Float[Array, " bin"]:
    out = np.full(count, -np.inf)
    np.maximum.at(out, place, value)
    return out
