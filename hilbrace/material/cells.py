"""Unit cells of the microstructures: skeletons, and the distance field to them over the flat map.

A cell is drawn in the unit square; the map is tiled with its mirror images, so that one period ``s`` of
the map holds two by two of them and every pattern has the symmetry of a rectangle (paper, Sec. 4.1). The
solid is ``{f_cell <= width}``: more width, more material. (The paper prints ``f_M = d - f_cell`` with the
solid at ``f_M <= 0``, which is the complement of what its figures show.)

Folding never lengthens a path, so the distance inside the folded cell is the true distance to the unfolded
skeleton, and nothing kinks at a mirror line unless the skeleton itself does.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.spatial import Voronoi, cKDTree

from hilbrace.errors import ConfigError

Array = np.ndarray

LUT_INTERVALS = 512
"""Intervals per side of the look-up table of a distance field."""


def voronoi_open() -> Float[Array, "segment 2 2"]:
    """Voronoi edges of five seeds and their mirror images, three of them on the border of the cell.

    A seed strictly inside the cell would make the mirror line itself a Voronoi edge, and a straight square
    grid would show through the pattern; seeds on the border leave the mirror lines open.
    """
    return _mirrored_voronoi(np.array([(0.0, 0.0), (1.0, 0.5), (0.45, 1.0), (0.0, 0.62), (0.55, 0.38)]))


def sinusoidal() -> Float[Array, "segment 2 2"]:
    """Two crossing waves, ``y = 1/2 + 0.17 cos(2 pi x)`` and its transpose: a full wave per cell.

    The cosine meets both mirror lines at right angles, so the unfolded struts are smooth waves. The half
    wave ``cos(pi x)`` is soft along its struts only: averaged over directions it is stiffer than the open
    Voronoi cell above a volume fraction of 0.35, whereas this one stays several times softer throughout.
    """
    x = np.linspace(0.0, 1.0, 65)
    wave = np.stack([x, 0.5 + 0.17 * np.cos(2 * np.pi * x)], axis=1)
    return np.concatenate([_polyline(wave), _polyline(wave[:, ::-1])])


SKELETONS: dict[str, Callable[[], Float[Array, "segment 2 2"]]] = {
    "voronoi_open": voronoi_open,
    "sinusoidal": sinusoidal,
}
"""Skeleton of each cell by name; a further cell is a further entry and a `hilbrace.material.tables` file."""


def skeleton(name: str) -> Float[Array, "segment 2 2"]:
    """Segments of a cell's skeleton in the unit square.

    Raises:
        ConfigError: No cell has this name.
    """
    if name not in SKELETONS:
        raise ConfigError(
            f"no microstructure named '{name}'",
            where="material",
            hint=f"choose one of {', '.join(SKELETONS)}",
        )
    return SKELETONS[name]()


def fold(coordinate: Float[Array, "*shape"], scale: float) -> Float[Array, "*shape"]:
    """Fold a coordinate of the flat map into the mirrored unit cell.

    The triangle wave equals the paper's ``arccos(cos(2 pi u / s)) / pi`` (below Eq. 5) without its loss of
    digits at the mirror lines.

    Args:
        coordinate: ``u`` or ``v`` of the flat map.
        scale: Period ``s`` in the flat map; two cells long.

    Returns:
        Coordinate inside the cell, in [0, 1].
    """
    return 1.0 - np.abs(1.0 - np.mod(2.0 * coordinate / scale, 2.0))


def skeleton_distance(name: str, points: Float[Array, "point 2"]) -> Float[Array, " point"]:
    """Distance of points in the unit cell to the skeleton [cell sides].

    The nearest of densely laid points picks the segments, the distance to them is exact.
    """
    segments = skeleton(name)
    samples, owner = _sample(segments, spacing=2e-3)
    near = owner[cKDTree(samples).query(points, k=2)[1]]
    candidates = segments[near]
    return np.asarray(
        _segment_distance(points[:, None], candidates[:, :, 0], candidates[:, :, 1]).min(axis=1)
    )


def cell_distance(name: str, u: Float[Array, " point"], v: Float[Array, " point"]) -> Float[Array, " point"]:
    """Distance field ``f_cell`` at folded coordinates, bilinear in a table (error below 1e-3 cell sides).

    Args:
        name: Name of the cell.
        u: First folded coordinate, in [0, 1].
        v: Second folded coordinate.

    Returns:
        Distance to the skeleton [cell sides].
    """
    table = distance_table(name)
    x, y = np.clip(u, 0, 1) * LUT_INTERVALS, np.clip(v, 0, 1) * LUT_INTERVALS
    i = np.minimum(x.astype(np.intp), LUT_INTERVALS - 1)
    j = np.minimum(y.astype(np.intp), LUT_INTERVALS - 1)
    a, b = x - i, y - j
    low = (1 - b) * table[i, j] + b * table[i, j + 1]
    high = (1 - b) * table[i + 1, j] + b * table[i + 1, j + 1]
    return (1 - a) * low + a * high


@cache
def distance_table(name: str) -> Float[Array, "row column"]:
    """Distance field at the nodes of a square grid over the unit cell, computed once per process."""
    ticks = np.linspace(0.0, 1.0, LUT_INTERVALS + 1)
    nodes = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)
    table = skeleton_distance(name, nodes).reshape(len(ticks), len(ticks))
    table.setflags(write=False)
    return table


def _polyline(points: Float[Array, "point 2"]) -> Float[Array, "segment 2 2"]:
    return np.stack([points[:-1], points[1:]], axis=1)


def _sample(segments: Float[Array, "segment 2 2"], spacing: float) -> tuple[Array, Array]:
    samples, owner = [], []
    for index, (start, end) in enumerate(segments):
        count = int(np.ceil(np.linalg.norm(end - start) / spacing)) + 1
        t = np.linspace(0.0, 1.0, count)[:, None]
        samples.append((1 - t) * start + t * end)
        owner.append(np.full(count, index))
    return np.concatenate(samples), np.concatenate(owner)


def _segment_distance(point: Array, start: Array, end: Array) -> Array:
    along = end - start
    t = ((point - start) * along).sum(-1) / (along**2).sum(-1)
    return np.linalg.norm(point - start - np.clip(t, 0, 1)[..., None] * along, axis=-1)


def _mirrored_voronoi(seeds: Float[Array, "seed 2"]) -> Float[Array, "segment 2 2"]:
    images = [
        np.stack([x, y], axis=1)
        for x in (-seeds[:, 0], seeds[:, 0], 2 - seeds[:, 0])
        for y in (-seeds[:, 1], seeds[:, 1], 2 - seeds[:, 1])
    ]
    diagram = Voronoi(np.unique(np.round(np.concatenate(images), 9), axis=0))
    ridges = [ridge for ridge in diagram.ridge_vertices if min(ridge) >= 0]
    pieces = [_clip_to_cell(*diagram.vertices[ridge]) for ridge in ridges]
    return np.array([piece for piece in pieces if piece is not None])


def _clip_to_cell(start: Array, end: Array) -> Array | None:
    """Part of a segment inside the unit square (Liang & Barsky 1984), ``None`` where it lies outside."""
    along = end - start
    enter, leave = 0.0, 1.0
    for axis in range(2):
        for step, room in ((-along[axis], start[axis]), (along[axis], 1.0 - start[axis])):
            if abs(step) < 1e-14:
                if room < -1e-9:
                    return None
            elif step < 0:
                enter = max(enter, room / step)
            else:
                leave = min(leave, room / step)
    if leave - enter < 1e-9:
        return None
    return np.array([start + enter * along, start + leave * along])
