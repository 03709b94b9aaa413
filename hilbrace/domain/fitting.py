"""How the brace departs from the skin: reliefs that stand off it, and compression that is narrower than it.

Reliefs belong to the brace at rest and worn. Compression belongs to the brace at rest alone: worn, it lies on
the skin, stretched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu

from hilbrace.config.domain import ReliefSettings
from hilbrace.domain.landmarks import find_landmark
from hilbrace.domain.limb import Limb, Surface
from hilbrace.domain.loops import Loops
from hilbrace.domain.paint import read_paint, smoothed_paint
from hilbrace.errors import ConfigError, GeometryError

Array = np.ndarray

_STEEPEST = 0.5
"""Least cosine of the angle by which a triangle may be turned when the surface is moved [-]."""

_REACHED = 0.7
"""Share of its height that a relief must reach somewhere on the sleeve [-]."""

_LEVELS = 64
"""Level lines whose centres make up the axis of a sleeve."""


@dataclass(frozen=True)
class Fit:
    """A sleeve at rest and as it is worn, triangle by triangle.

    Attributes:
        rest: The sleeve that is made [mm].
        worn: Its vertices on the limb [mm].
    """

    rest: Surface
    worn: Float[Array, "vertex 3"]

    def to_rest(self, points: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """Where points of the worn sleeve are at rest [mm]."""
        shift = self.rest.vertices - self.worn
        return points + _carried(Surface(self.worn, self.rest.triangles), shift, points)

    def to_worn(self, points: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """Where points of the sleeve at rest are when it is worn [mm]."""
        return points + _carried(self.rest, self.worn - self.rest.vertices, points)


@dataclass(frozen=True)
class Relief:
    """An offset of the brace from the skin.

    Attributes:
        key: Configuration key that asks for it.
        height_mm: Offset in its middle, outwards [mm].
        share: Share of it at each vertex of the sleeve [-].
    """

    key: str
    height_mm: float
    share: Float[Array, " vertex"]


def find_reliefs(
    region: Surface,
    skin: Surface,
    limb: Limb,
    order: Int[Array, " vertex"],
    wanted: Sequence[ReliefSettings],
) -> tuple[Relief, ...]:
    """The reliefs that a configuration asks for.

    Around a landmark the offset falls as ``(1 - (r / radius)^2)^2``, without a kink anywhere.

    Args:
        region: The sleeve, refined [mm].
        skin: Skin in limb axes [mm].
        limb: Axes of the limb.
        order: Vertex of the body that each vertex of the skin is.
        wanted: ``domain.reliefs``.

    Raises:
        ConfigError: A relief is given by no place or by two, or by an unknown landmark.
        InputError: Its paint cannot be read.
        GeometryError: There is no skin at its landmark.
    """
    found = []
    for number, relief in enumerate(wanted):
        key = f"domain.reliefs[{number}]"
        if (relief.at is None) == (relief.painted is None):
            raise ConfigError(
                "a relief is given by a landmark or by paint",
                where=key,
                hint=f"set {key}.at or {key}.painted",
            )
        if relief.painted is not None:
            on_skin = _paint_share(skin, order, relief.painted, relief.radius_mm, key)
            share = _carried(skin, on_skin[:, None], region.vertices)[:, 0]
        else:
            middle = find_landmark(skin, limb, str(relief.at), f"{key}.at").position
            away = np.linalg.norm(region.vertices - middle, axis=1) / relief.radius_mm
            share = np.clip(1.0 - away**2, 0.0, None) ** 2
        found.append(Relief(key, relief.height_mm, share))
    return tuple(found)


def relieve(region: Surface, reliefs: Sequence[Relief]) -> Surface:
    """Move a sleeve off the skin along its normals.

    Args:
        region: The sleeve, refined [mm].
        reliefs: The reliefs; where several meet, they add up.

    Raises:
        GeometryError: The surface would fold.
    """
    for relief in reliefs:
        if relief.share.max() < _REACHED:
            raise GeometryError(
                "the relief lies outside the sleeve, or is too small for its mesh",
                where=relief.key,
                hint="move it, raise its radius_mm, or ask for more triangles (domain.triangles)",
            )
        normals = np.asarray(igl.per_vertex_normals(region.vertices, region.triangles))
        moved = Surface(
            region.vertices + relief.height_mm * relief.share[:, None] * normals, region.triangles
        )
        _check_folds(
            region, moved, relief.key, "lower height_mm, or raise radius_mm, until its slope is below 60 deg"
        )
        region = moved
    return region


def compress(region: Surface, loops: Loops, percent: float) -> Fit:
    """Make a sleeve narrower than the limb: every line around it by the same percentage.

    The lines are the levels of the harmonic function between the two ends; each is scaled about its own
    centre, so that its length changes by exactly the percentage however the limb bends.

    Args:
        region: The sleeve as it is worn [mm].
        loops: Its ends.
        percent: Circumference taken away [%].

    Raises:
        GeometryError: The surface would fold.
    """
    if percent == 0.0:
        return Fit(region, region.vertices)
    height = harmonic_height(region, loops)
    centres = level_centres(region, loops, height)
    at = np.linspace(0.0, 1.0, len(centres))
    axis = np.stack([np.interp(height, at, centres[:, k]) for k in range(3)], axis=1)
    narrow = Surface(region.vertices - percent / 100.0 * (region.vertices - axis), region.triangles)
    _check_folds(region, narrow, "domain.compression_percent", "lower domain.compression_percent")
    return Fit(narrow, region.vertices)


def harmonic_height(region: Surface, loops: Loops) -> Float[Array, " vertex"]:
    """The harmonic function on a sleeve that is 0 at its lower and 1 at its upper end [-]."""
    laplacian = sparse.csr_array(igl.cotmatrix(region.vertices, region.triangles))
    height = np.zeros(len(region.vertices))
    height[loops.upper] = 1.0
    free = np.setdiff1d(np.arange(len(height)), np.concatenate([loops.upper, loops.lower]))
    rows = laplacian[free]
    height[free] = splu(sparse.csc_matrix(rows[:, free])).solve(-(rows @ height))
    return np.clip(height, 0.0, 1.0)


def level_centres(region: Surface, loops: Loops, height: Float[Array, " vertex"]) -> Float[Array, "level 3"]:
    """Centres of lines around a sleeve at even levels of a function, from its lower to its upper end [mm]."""
    ends = []
    for loop in (loops.lower, loops.upper):
        start = region.vertices[loop]
        ends.append(_centre(start, np.roll(start, -1, axis=0)))
    between = [_level_centre(region, height, k / _LEVELS) for k in range(1, _LEVELS)]
    return np.stack([ends[0], *between, ends[1]])


def _level_centre(region: Surface, height: Float[Array, " vertex"], level: float) -> Float[Array, " xyz"]:
    """Centre of the line on which a function has one value."""
    crossing = []
    over = height[region.triangles] > level
    mixed = region.triangles[over.any(axis=1) & ~over.all(axis=1)]
    for k in range(3):
        tail, head = mixed[:, k], mixed[:, (k + 1) % 3]
        low, high = height[tail] - level, height[head] - level
        met = (low > 0.0) != (high > 0.0)
        part = np.where(met, low / np.where(met, low - high, 1.0), np.nan)[:, None]
        crossing.append(region.vertices[tail] + part * (region.vertices[head] - region.vertices[tail]))
    points = np.stack(crossing, axis=1)
    known = np.isfinite(points[..., 0])
    pairs = points[known].reshape(-1, 2, 3)
    return _centre(pairs[:, 0], pairs[:, 1])


def _centre(start: Float[Array, "piece 3"], end: Float[Array, "piece 3"]) -> Float[Array, " xyz"]:
    """Centre of a line of pieces, each counting by its length."""
    length = np.linalg.norm(end - start, axis=1)
    return length @ ((start + end) / 2.0) / length.sum()


def _paint_share(
    skin: Surface, order: Int[Array, " vertex"], path: Path, radius_mm: float, key: str
) -> Float[Array, " vertex"]:
    painted = read_paint(path, len(order), f"{key}.painted")[order]
    share = np.clip(smoothed_paint(skin, painted, radius_mm / 2.0), 0.0, None)
    return share / share.max()


def _carried(
    surface: Surface, values: Float[Array, "vertex value"], points: Float[Array, "point 3"]
) -> Float[Array, "point value"]:
    """Values of a surface's vertices at the places of the surface nearest to points."""
    vertices = np.ascontiguousarray(surface.vertices)
    _, found, foot = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points), vertices, surface.triangles
    )
    face = np.asarray(found, np.int64)
    corner = [np.ascontiguousarray(vertices[surface.triangles[face, k]]) for k in range(3)]
    share = np.asarray(igl.barycentric_coordinates(np.ascontiguousarray(foot), *corner))
    return np.einsum("pk,pkv->pv", share, values[surface.triangles[face]])


def _check_folds(before: Surface, after: Surface, key: str, hint: str) -> None:
    one, two = (
        np.asarray(igl.per_face_normals(s.vertices, s.triangles, np.zeros(3))) for s in (before, after)
    )
    folded = int(((one * two).sum(axis=1) < _STEEPEST).sum())
    if folded:
        raise GeometryError(f"the surface would fold in {folded} triangles", where=key, hint=hint)
