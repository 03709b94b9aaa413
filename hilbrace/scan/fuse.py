"""One mesh from all views: signed distances on a grid, averaged (Curless & Levoy 1996), cut at zero.

A grid point projects into each view; its distance from the view's tangent plane there counts with a weight
that falls with the slope and the expected error. Only cubes whose corners are all known are cut, so that what
no view saw stays open.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import cv2
import igl
import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError
from hilbrace.scan.calibration import Lens
from hilbrace.scan.merge import Move
from hilbrace.scan.point_cloud import UPRIGHT, SmoothView

Array = np.ndarray

BAND = 3
"""Grid steps on either side of the surface that are computed."""
MOST_GRID_POINTS = 30_000_000
_CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
_CHUNK = 1_000_000


def fuse_views(
    views: Sequence[SmoothView], moves: Sequence[Move], camera: Lens, step_mm: float
) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """The mesh of several views in the axes of the files [mm], facing outward.

    Args:
        views: The views.
        moves: What lays each on the first.
        camera: The camera of all.
        step_mm: Distance of grid points [mm].

    Raises:
        GeometryError: The grid is too fine for the size of what was seen, or nothing is left.
    """
    frames = [(move.rotation @ UPRIGHT, move.shift) for move in moves]
    cells = _cells_near(views, frames, step_mm)
    total, weight = np.zeros(len(cells)), np.zeros(len(cells))
    for begin in range(0, len(cells), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        points = cells[part] * step_mm
        for view, frame in zip(views, frames, strict=True):
            distance, counts = _signed_distance(view, frame, camera, points, BAND * step_mm)
            total[part] += counts * distance
            weight[part] += counts
    known = np.flatnonzero(weight > 0.0)
    cubes = _whole_cubes(cells[known])
    if not len(cubes):
        raise GeometryError(
            "no surface is left to mesh",
            where="views",
            hint="look at the pictures of the views; more light, or a coarser --voxel",
        )
    vertices, triangles, _ = igl.marching_cubes(
        total[known] / weight[known], cells[known] * step_mm, cubes.astype(np.int64), 0.0
    )
    return np.asarray(vertices, dtype=float), np.asarray(triangles, dtype=np.int64)


def _cells_near(
    views: Sequence[SmoothView], frames: Sequence[tuple[Array, Array]], step_mm: float
) -> Int[Array, "cell 3"]:
    """Grid points within the band around the points of all views, sorted."""
    occupied = np.zeros((0, 3), dtype=np.int64)
    for view, (rotation, shift) in zip(views, frames, strict=True):
        points = view.points[view.valid] @ rotation.T + shift
        cells = np.unique(np.rint(points / step_mm).astype(np.int64), axis=0)
        occupied = np.unique(np.concatenate([occupied, cells]), axis=0)
    if not len(occupied):
        return occupied
    low = occupied.min(axis=0) - BAND - 1
    size = occupied.max(axis=0) + BAND + 2 - low
    if np.prod(size.astype(float)) > 40.0 * MOST_GRID_POINTS or len(occupied) > MOST_GRID_POINTS / 20:
        raise GeometryError(
            f"a grid of {step_mm:g} mm is too fine for surfaces in a box of "
            + " x ".join(f"{side * step_mm:.0f}" for side in size)
            + " mm",
            where="--voxel",
            hint="take a coarser grid, or leave out the background with --depth NEAR:FAR",
        )
    key = _keys(occupied - low, size)
    reach = range(-BAND, BAND + 1)
    ball = [
        (a, b, c) for a, b, c in product(reach, reach, reach) if a * a + b * b + c * c <= (BAND + 0.5) ** 2
    ]
    filled = np.zeros(int(np.prod(size)), dtype=bool)
    for a, b, c in ball:
        filled[key + (a * size[1] + b) * size[2] + c] = True
    return np.stack(np.unravel_index(np.flatnonzero(filled), size), axis=1) + low


def _keys(cells: Int[Array, "cell 3"], size: Int[Array, " 3"]) -> Int[Array, " cell"]:
    return (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]


def _signed_distance(
    view: SmoothView, frame: tuple[Array, Array], camera: Lens, points: Float[Array, "point 3"], band: float
) -> tuple[Float[Array, " point"], Float[Array, " point"]]:
    """Distance of points in front of a view's surface [mm], at most the band, and its weight."""
    rotation, shift = frame
    seen = (points - shift) @ rotation
    pixel = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0]
    column, row = np.rint(np.asarray(pixel).reshape(-1, 2)).astype(np.int64).T
    height, width = view.valid.shape
    inside = (seen[:, 2] > 0.0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    inside &= view.valid[row, column]
    gap = np.einsum("ij,ij->i", view.normals[row, column], seen - view.points[row, column])
    inside &= gap > -band
    weight = (view.cosine[row, column] / np.maximum(view.error[row, column], 0.02)) ** 2
    return np.where(inside, np.minimum(gap, band), 0.0), np.where(inside, weight, 0.0)


def _whole_cubes(cells: Int[Array, "cell 3"]) -> Int[Array, "cube 8"]:
    """Cubes whose eight corners are all among the cells, by the cells' numbers."""
    if not len(cells):
        return np.zeros((0, 8), dtype=np.int64)
    low = cells.min(axis=0)
    size = cells.max(axis=0) - low + 2
    number = np.full(int(np.prod(size)), -1, dtype=np.int32)
    number[_keys(cells - low, size)] = np.arange(len(cells))
    corners = np.stack([number[_keys(cells - low + corner, size)] for corner in _CORNERS], axis=1)
    return corners[(corners >= 0).all(axis=1)]
