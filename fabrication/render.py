"""Draw bodies as a technical illustration: exact visibility, soft light, dark outlines; no graphics driver.

Triangles are laid into a depth buffer in numpy, all at once. Hollows are darkened by the difference between
the depth and its blurred self (depth darkening; Luft, Colditz & Deussen 2006), lines are drawn where depth,
direction or body change between neighbouring pixels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter, map_coordinates

Array = np.ndarray

FINER = 2
"""Pixels computed per pixel shown, each way, so that edges are smooth."""

FRAGMENTS = 1_000_000
"""Pixels of triangles handled at a time."""

EDGE = 1e-9
"""Pixels this close outside of a triangle belong to it: no gaps between neighbours [-]."""

CREASE = 0.95
"""Cosine between a triangle and the mean direction around its corner from which the edge looks sharp."""


@dataclass(frozen=True)
class Drawn:
    """A body to draw.

    Attributes:
        vertices: Positions [mm].
        triangles: Outward triangles; those that look away are not drawn.
        colours: Red, green and blue, one colour for all or one per triangle, 0 to 1.
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    colours: Float[Array, "*triangle 3"]


@dataclass(frozen=True)
class View:
    """Where one looks from, in parallel projection.

    Attributes:
        right: Unit direction to the right on paper.
        up: Unit direction up on paper.
        near: Unit direction towards the eye.
    """

    right: Float[Array, "3"]
    up: Float[Array, "3"]
    near: Float[Array, "3"]

    def flat(self, points: Float[Array, "point 3"]) -> Float[Array, "point 2"]:
        """Points on paper, right and up [mm]."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


def view_from(near: Float[Array, "3"], up: Float[Array, "3"]) -> View:
    """The view with a direction towards the eye and another as upright as can be.

    Args:
        near: Towards the eye, of any length.
        up: What shall be up, not parallel to ``near``.
    """
    near = near / np.linalg.norm(near)
    right = np.cross(up, near)
    right /= np.linalg.norm(right)
    return View(right, np.cross(near, right), near)


def draw(
    bodies: Sequence[Drawn],
    view: View,
    window: tuple[float, float, float, float],
    pixels_per_mm: float,
) -> Float[Array, "row column 4"]:
    """Draw bodies; what is empty is transparent.

    Args:
        bodies: What to draw.
        view: Where from.
        window: Left, right, bottom and top on paper [mm].
        pixels_per_mm: Resolution.

    Returns:
        Red, green, blue and opacity of each pixel, the top row first.
    """
    scale = FINER * pixels_per_mm
    left, right, bottom, top = window
    columns = FINER * max(1, round((right - left) * pixels_per_mm))
    rows = FINER * max(1, round((top - bottom) * pixels_per_mm))
    scene = _Scene.of(bodies, view)
    corners = scene.places.copy()
    corners[..., 0] = (corners[..., 0] - left) * scale - 0.5
    corners[..., 1] = (top - corners[..., 1]) * scale - 0.5
    depth, winner, weights = _visible(corners, rows, columns)
    seen = winner >= 0
    normals = np.zeros((rows, columns, 3), np.float32)
    normals[seen] = np.einsum("pc,pcx->px", weights[seen], scene.normals[winner[seen]])
    normals[seen] /= np.maximum(np.linalg.norm(normals[seen], axis=1, keepdims=True), 1e-12)
    image = np.zeros((rows, columns, 4), np.float32)
    light = _light(normals[seen]) * _hollow(depth, seen, scale)[seen]
    image[seen, :3] = np.clip(scene.colours[winner[seen]] * light[:, None], 0.0, 1.0)
    image[seen, 3] = 1.0
    body = np.where(seen, scene.bodies[winner], -1)
    _ink(image, _lines(depth, normals, body, scale))
    return _shrunk(image)


@dataclass(frozen=True)
class _Scene:
    """Triangles that look at the eye: places (right, up, near), normals at the corners, colours, bodies."""

    places: Array
    normals: Array
    colours: Array
    bodies: Array

    @classmethod
    def of(cls, bodies: Sequence[Drawn], view: View) -> _Scene:
        turn = np.stack([view.right, view.up, view.near], axis=1)
        parts = []
        for number, body in enumerate(bodies):
            points = body.vertices @ turn
            corners = points[body.triangles]
            flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            facing = flat[:, 2] > 0
            smooth = _corner_normals(points, body.triangles, flat)[facing]
            tones = np.broadcast_to(body.colours, (len(body.triangles), 3))[facing]
            parts.append((corners[facing], smooth, tones, np.full(int(facing.sum()), number)))
        places, normals, colours, numbers = (np.concatenate(each) for each in zip(*parts, strict=True))
        return cls(places, normals.astype(np.float32), colours.astype(np.float32), numbers)


def _corner_normals(points: Array, triangles: Array, flat: Array) -> Array:
    """Normal at each corner of each triangle: mean around the vertex, or the triangle's own at creases."""
    own = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
    total = np.zeros_like(points)
    for corner in range(3):
        np.add.at(total, triangles[:, corner], own)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    around = total[triangles]
    sharp = np.einsum("tcx,tx->tc", around, own) < CREASE
    return np.where(sharp[..., None], own[:, None], around)


def _visible(corners: Array, rows: int, columns: int) -> tuple[Array, Array, Array]:
    """Depth, nearest triangle and barycentric weights at each pixel; triangle -1 where there is none."""
    depth = np.full(rows * columns, -np.inf, np.float32)
    winner = np.full(rows * columns, -1, np.int32)
    slopes = _slopes(corners)
    for triangle, row, column in _fragments(corners, rows, columns):
        second, third = _weights(slopes[triangle], row, column)
        inside = (second >= -EDGE) & (third >= -EDGE) & (second + third <= 1 + EDGE)
        triangle, second, third = triangle[inside], second[inside], third[inside]
        pixel = row[inside] * columns + column[inside]
        height = corners[triangle, :, 2]
        near = height[:, 0] + second * (height[:, 1] - height[:, 0]) + third * (height[:, 2] - height[:, 0])
        near = near.astype(np.float32)
        np.maximum.at(depth, pixel, near)
        front = near == depth[pixel]
        winner[pixel[front]] = triangle[front]
    weights = np.zeros((rows * columns, 3), np.float32)
    seen = np.flatnonzero(winner >= 0)
    second, third = _weights(slopes[winner[seen]], seen // columns, seen % columns)
    weights[seen] = np.stack([1.0 - second - third, second, third], axis=1)
    shape = (rows, columns)
    return depth.reshape(shape), winner.reshape(shape), weights.reshape(*shape, 3)


def _slopes(corners: Array) -> Float[Array, "triangle 6"]:
    """Coefficients of the second and the third barycentric weight: of column, of row, and constant."""
    (x, y), (u, v), (s, t) = (corners[:, k, :2].T for k in range(3))
    area = (u - x) * (t - y) - (v - y) * (s - x)
    with np.errstate(divide="ignore", invalid="ignore"):
        second = np.stack([t - y, x - s, y * (s - x) - x * (t - y)]) / area
        third = np.stack([y - v, u - x, x * (v - y) - y * (u - x)]) / area
    return np.nan_to_num(np.concatenate([second, third]).T, nan=-1e9, posinf=-1e9, neginf=-1e9)


def _weights(slopes: Array, row: Array, column: Array) -> tuple[Array, Array]:
    second = slopes[:, 0] * column + slopes[:, 1] * row + slopes[:, 2]
    return second, slopes[:, 3] * column + slopes[:, 4] * row + slopes[:, 5]


def _fragments(corners: Array, rows: int, columns: int) -> Iterator[tuple[Array, Array, Array]]:
    """Triangles with the row and the column of a pixel in their bounding boxes, a million at a time."""
    low = np.maximum(np.ceil(corners[..., :2].min(axis=1)), 0).astype(np.int32)
    high = np.minimum(np.floor(corners[..., :2].max(axis=1)), (columns - 1, rows - 1)).astype(np.int32)
    width, height = np.maximum(high - low + 1, 0).T
    count = width.astype(np.int64) * height
    drawn = np.flatnonzero(count)
    ends = np.cumsum(count[drawn])
    first = 0
    while first < len(drawn):
        done = ends[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(ends, done + FRAGMENTS, side="right")))
        some = drawn[first:last]
        triangle = np.repeat(some, count[some])
        start = ends[first:last] - count[some] - done
        offset = (np.arange(len(triangle)) - np.repeat(start, count[some])).astype(np.int32)
        row, column = np.divmod(offset, width[triangle])
        yield triangle, low[triangle, 1] + row, low[triangle, 0] + column
        first = last


def _light(normals: Float[Array, "pixel 3"]) -> Float[Array, " pixel"]:
    """Brightness by direction: a lamp above the left shoulder, a weaker one from the right, daylight."""
    lamp, fill = np.array([-0.45, 0.65, 0.62]), np.array([0.7, -0.1, 0.7])
    lamp, fill = ((way / np.linalg.norm(way)).astype(np.float32) for way in (lamp, fill))
    return 0.42 + 0.50 * np.clip(normals @ lamp, 0, 1) + 0.18 * np.clip(normals @ fill, 0, 1)


def _hollow(depth: Array, seen: Bool[Array, "row column"], scale: float) -> Float[Array, "row column"]:
    """Darkening of what lies behind its surroundings, at two sizes."""
    shade = np.ones_like(depth)
    for radius_mm, strength, reach_mm in ((2.0, 0.30, 2.5), (9.0, 0.35, 14.0)):
        mean = _blurred(depth, seen, radius_mm * scale)
        shade -= strength * np.clip((mean - np.where(seen, depth, 0.0)) / reach_mm, 0.0, 1.0)
    return shade


def _blurred(depth: Array, seen: Array, radius: float) -> Float[Array, "row column"]:
    """Gaussian mean of the depth over what is seen, computed on a raster as coarse as the radius allows."""
    step = max(1, int(radius / 4))
    rows, columns = (-(-length // step) for length in depth.shape)
    pad = ((0, rows * step - depth.shape[0]), (0, columns * step - depth.shape[1]))
    weight = np.pad(seen.astype(np.float32), pad)
    value = np.pad(np.where(seen, depth, 0.0), pad)
    coarse = [part.reshape(rows, step, columns, step).mean(axis=(1, 3)) for part in (value, weight)]
    value, weight = (gaussian_filter(part, radius / step) for part in coarse)
    mean = value / np.maximum(weight, 1e-6)
    y, x = np.ogrid[: depth.shape[0], : depth.shape[1]]
    return map_coordinates(
        mean,
        np.broadcast_arrays((y + 0.5) / step - 0.5, (x + 0.5) / step - 0.5),
        order=1,
        mode="nearest",
    )


def _lines(depth: Array, normals: Array, body: Array, scale: float) -> Float[Array, "row column"]:
    """Darkness of the outlines: strong at the edge of a body, fine at creases and steps."""
    ink = np.zeros(depth.shape, np.float32)
    level = np.where(np.isfinite(depth), depth, -1e6)
    for axis in (0, 1):
        one, other = _neighbours(body, axis)
        outline = one != other
        above, below = _neighbours(level, axis)
        step = np.abs(above - below) > 1.2 + 3.0 / scale
        first, second = _neighbours(normals, axis)
        crease = (np.einsum("rcx,rcx->rc", first, second) < 0.72) & (one >= 0) & (other >= 0)
        strength = np.maximum.reduce([0.85 * outline, 0.65 * (step & ~outline), 0.40 * (crease & ~outline)])
        for shift in (0, 1):
            part = (
                ink[shift : shift + strength.shape[0]]
                if axis == 0
                else ink[:, shift : shift + strength.shape[1]]
            )
            np.maximum(part, strength, out=part)
    return ink


def _neighbours(values: Array, axis: int) -> tuple[Array, Array]:
    return (values[:-1], values[1:]) if axis == 0 else (values[:, :-1], values[:, 1:])


def _ink(image: Array, ink: Array) -> None:
    """Draw dark lines over an image, also just outside of the bodies."""
    dark = np.array([0.13, 0.17, 0.21], np.float32)
    share = ink[..., None]
    image[..., :3] = np.where(image[..., 3:] > 0, image[..., :3] * (1 - share) + dark * share, dark)
    image[..., 3] = np.maximum(image[..., 3], ink)


def _shrunk(image: Array) -> Float[Array, "row column 4"]:
    """Mean over the finer pixels, colours weighed by opacity."""
    rows, columns = image.shape[0] // FINER, image.shape[1] // FINER
    blocks = image.reshape(rows, FINER, columns, FINER, 4)
    opacity = blocks[..., 3:].mean(axis=(1, 3))
    colour = (blocks[..., :3] * blocks[..., 3:]).mean(axis=(1, 3)) / np.maximum(opacity, 1e-9)
    return np.concatenate([colour, opacity], axis=2)
