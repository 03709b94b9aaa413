"""Small castings for the tests of molds: a bent tube and a flat coupon, both with a lattice of diamonds."""

from __future__ import annotations

import numpy as np

from fabrication.bodies import body_of
from fabrication.mold import Casting
from hilbrace.pattern.clip import cut_out, zero_line
from hilbrace.pattern.refine import RefinedSkin
from hilbrace.pattern.thicken import thicken

FOOT_MM = 16.0
GUTTER_MM = 10.0


def bent_tube(
    around: int = 56,
    along: int = 30,
    radius_mm: float = 30.0,
    height_mm: float = 84.0,
    bend_mm: float = 8.0,
    thickness_mm: float = 4.0,
    strut_mm: float = 5.0,
    cells: tuple[int, int] = (6, 3),
) -> Casting:
    """A sleeve with a bent axis (towards +x in the middle), y up, and diamonds between two rims.

    Args:
        around: Vertices around.
        along: Rows between the edges.
        radius_mm: Radius of the limb.
        height_mm: Height of the brace.
        bend_mm: How far its axis lies off a straight line in the middle.
        thickness_mm: Thickness of the brace.
        strut_mm: Width of the struts.
        cells: Diamonds around and along.
    """
    turn, y = np.meshgrid(
        np.arange(around) / around * 2 * np.pi,
        np.linspace(-height_mm / 2, height_mm / 2, along + 1),
        indexing="ij",
    )
    h = y / height_mm + 0.5
    radius = radius_mm * (1 + 0.08 * np.cos(2 * np.pi * h))
    centre = bend_mm * 4 * h * (1 - h)
    points = np.stack([radius * np.sin(turn) + centre, y, radius * np.cos(turn)], axis=-1)
    slope = np.gradient(points, axis=1, edge_order=2)
    step = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    direction = np.cross(step, slope)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    width = 2 * np.pi * radius_mm / cells[0], height_mm / cells[1]
    depth = np.maximum(
        _diamonds(turn * cells[0] / (2 * np.pi), h * cells[1], width, strut_mm),
        strut_mm - np.minimum(y + height_mm / 2, height_mm / 2 - y),
    )
    line = np.stack([centre[0], y[0], np.zeros(along + 1)], axis=1)
    return _casting("tube", points, direction, depth, thickness_mm, line, closed=True)


def flat_coupon(
    width_mm: float = 50.0,
    height_mm: float = 70.0,
    thickness_mm: float = 4.0,
    strut_mm: float = 5.0,
    edge_mm: float = 2.5,
    margin_mm: float = 10.0,
) -> Casting:
    """A flat plate with diamonds and a solid frame, thick towards +z, y up, ground beyond it on all sides.

    Args:
        width_mm: Width of the coupon along x.
        height_mm: Height along y.
        thickness_mm: Thickness along z.
        strut_mm: Width of struts and frame.
        edge_mm: Edge of the ground's mesh.
        margin_mm: Ground left and right of the coupon.
    """
    columns = round((width_mm + 2 * margin_mm) / edge_mm) + 1
    rows = round(height_mm / edge_mm) + 1
    x, y = np.meshgrid(
        np.linspace(-width_mm / 2 - margin_mm, width_mm / 2 + margin_mm, columns),
        np.linspace(0, height_mm, rows),
        indexing="ij",
    )
    side = width_mm / 2 - np.abs(x)
    frame = np.minimum(side, np.minimum(y, height_mm - y))
    depth = np.maximum(
        _diamonds(x / 25.0 + 0.5, y / 35.0, (25.0, 35.0), strut_mm), strut_mm - np.maximum(frame, 0.0)
    )
    depth = np.minimum(depth, side)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    direction = np.broadcast_to([0.0, 0.0, 1.0], points.shape).copy()
    line = np.array([[0.0, 0.0, 0.0], [0.0, height_mm, 0.0]])
    return _casting("coupon", points, direction, depth, thickness_mm, line, closed=False)


def _diamonds(u: np.ndarray, v: np.ndarray, cell: tuple[float, float], strut_mm: float) -> np.ndarray:
    """Depth inside the struts of a lattice of diamonds, in cells (u, v) of the given size [mm]."""
    scale = cell[0] * cell[1] / np.hypot(*cell)
    lines = [np.abs((w + 0.5) % 1 - 0.5) for w in (u + v, u - v)]
    return strut_mm / 2 - np.minimum(*lines) * scale


def _casting(
    name: str,
    points: np.ndarray,
    direction: np.ndarray,
    depth: np.ndarray,
    thickness_mm: float,
    line: np.ndarray,
    closed: bool,
) -> Casting:
    """A casting on a grid of points, the second index up; its end rows are prolonged straight down and up."""
    down = np.arange(FOOT_MM, 0, -4.0)[:, None] * [0.0, -1.0, 0.0]
    up = np.arange(2.0, GUTTER_MM + 1, 2.0)[:, None] * [0.0, 1.0, 0.0]
    outer = points + thickness_mm * direction
    level = outer[:, -1, 1].max() - outer[:, -1, 1], outer[:, 0, 1] - outer[:, 0, 1].min()
    flatten = [np.stack([0 * one, one, 0 * one], axis=-1) for one in level]
    above = points[:, -1:] + up + flatten[0][:, None] * (np.arange(1, 6) / 5)[None, :, None]
    below = points[:, :1] + down - flatten[1][:, None] * (np.arange(4, 0, -1) / 4)[None, :, None]
    grid = np.concatenate([below, points, above], axis=1)
    way = np.concatenate(
        [np.repeat(direction[:, :1], 4, axis=1), direction, np.repeat(direction[:, -1:], 5, axis=1)], axis=1
    )
    columns, rows = grid.shape[:2]
    depth = np.pad(depth, ((0, 0), (4, 5)), mode="edge")
    band = np.clip(np.arange(rows - 1) - 3, 0, points.shape[1])
    beyond = np.where(band == 0, -1, np.where(band == points.shape[1], 1, 0))
    i, j = np.meshgrid(np.arange(columns if closed else columns - 1), np.arange(rows - 1), indexing="ij")
    right = (i + 1) % columns
    a, b, c, d = i * rows + j, right * rows + j, right * rows + j + 1, i * rows + j + 1
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    beyond = np.repeat(np.broadcast_to(beyond, i.shape).ravel(), 2)
    vertices, way, depth = grid.reshape(-1, 3), way.reshape(-1, 3), depth.ravel()
    inside = beyond == 0
    brace = _cut(vertices, way, triangles[inside], depth)
    land = _cut(vertices, way, triangles[inside], -depth)
    rest = (vertices, way, triangles[~inside])
    vertices, way, triangles = _merged(brace, land, rest)
    count = np.cumsum([len(brace[2]), len(land[2]), len(rest[2])])
    covered = np.arange(count[-1]) < count[0]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    thickness = np.full(len(vertices), thickness_mm)
    return Casting(
        name=name,
        joint="",
        side="",
        brace=body_of(*thicken(vertices, way, triangles[covered], thickness_mm), name),
        thickness_mm=thickness_mm,
        vertices=vertices,
        direction=way,
        thickness=thickness,
        triangles=triangles,
        covered=covered,
        beyond=np.concatenate([np.zeros(count[1], dtype=np.int64), beyond[~inside]]),
        centreline=line,
        shrinkage=0.0,
        flat=not closed,
    )


def _cut(
    vertices: np.ndarray, way: np.ndarray, triangles: np.ndarray, depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    none, pairs = np.zeros(0, dtype=np.intp), np.zeros((0, 2), dtype=np.intp)
    skin = RefinedSkin(
        vertices,
        way,
        triangles,
        pairs,
        none,
        np.zeros((0, 3)),
        pairs,
        none,
        1.0,
    )
    out = cut_out(skin, zero_line(skin, depth))
    return out.vertices, out.normals, out.triangles


def _merged(*parts: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Several surfaces in one, equal points welded."""
    start = np.cumsum([0, *(len(part[0]) for part in parts)])
    points = np.concatenate([part[0] for part in parts])
    triangles = np.concatenate([part[2] + first for part, first in zip(parts, start, strict=False)])
    used, triangles = np.unique(triangles, return_inverse=True)
    points, way = points[used], np.concatenate([part[1] for part in parts])[used]
    _, first, number = np.unique(np.round(points, 7) + 0.0, axis=0, return_index=True, return_inverse=True)
    return points[first], way[first], number.ravel()[triangles].reshape(-1, 3)
