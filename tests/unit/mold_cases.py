"""Small castings for the tests of molds: a bent tube and a flat coupon, both with a lattice of diamonds."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from fabrication.bodies import body_of
from fabrication.mold import Casting
from fabrication.sheet import Rim, Sheet, prolonged, rim_of
from hilbrace.pattern.clip import cut_out, lands_beside, zero_line
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
    strut_mm: float = 5.3,
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
    """A casting on a grid of points, the second index up."""
    columns, rows = points.shape[:2]
    i, j = np.meshgrid(np.arange(columns if closed else columns - 1), np.arange(rows - 1), indexing="ij")
    right = (i + 1) % columns
    a, b, c, d = i * rows + j, right * rows + j, right * rows + j + 1, i * rows + j + 1
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    none, pairs = np.zeros(0, dtype=np.intp), np.zeros((0, 2), dtype=np.intp)
    vertices, way = points.reshape(-1, 3), direction.reshape(-1, 3)
    unrefined = np.zeros(len(vertices), dtype=np.intp), np.zeros((len(vertices), 3))
    skin = RefinedSkin(vertices, way, triangles, pairs, *unrefined, pairs, none, 1.0)
    cut = zero_line(skin, depth.ravel())
    brace, lands = cut_out(skin, cut), lands_beside(skin, cut)
    vertices = np.concatenate([brace.vertices, lands.vertices])
    triangles = np.concatenate([brace.triangles, lands.triangles])
    grid = KDTree(points.reshape(-1, 3))
    near = grid.query(vertices, k=2)
    weight = near[0][:, ::-1] / near[0].sum(axis=1, keepdims=True)
    vector = thickness_mm * (weight[..., None] * way[near[1]]).sum(axis=1)
    covered = np.arange(len(triangles)) < len(brace.triangles)
    sheet = Sheet(vertices, vector, triangles, covered, np.zeros(len(triangles), dtype=np.int64))
    rim = rim_of(triangles)
    for end in (-1, 1):
        sheet = _prolonged(sheet, rim, end, closed)
    thickness = np.linalg.norm(sheet.vector, axis=1)
    direction = sheet.vector / thickness[:, None]
    body = thicken(sheet.vertices, direction, sheet.triangles[sheet.covered], thickness)
    return Casting(
        name=name,
        joint="",
        side="",
        brace=body_of(*body, name),
        thickness_mm=thickness_mm,
        vertices=sheet.vertices,
        direction=direction,
        thickness=thickness,
        triangles=sheet.triangles,
        covered=sheet.covered,
        beyond=sheet.beyond,
        down=np.array([0.0, -1.0, 0.0]),
        up=np.array([0.0, 1.0, 0.0]),
        centreline=line,
        shrinkage=0.0,
        flat=not closed,
    )


def _prolonged(sheet: Sheet, rim: Rim, end: int, closed: bool) -> Sheet:
    """The sheet with its foot (-1) or gutter (1); a flat one keeps lands beside the gutter."""
    level = end * sheet.vertices[rim.vertices, 1]
    edge = rim.vertices[level > level.max() - 1e-9]
    start = edge[np.argmax(end * sheet.vertices[edge, 0])]
    line = rim.walk(int(start), int(start) if closed else int(edge[np.argmin(end * sheet.vertices[edge, 0])]))
    beyond: int | np.ndarray = end
    if not closed and end == 1:
        middle = (sheet.vertices[line[1:]] + sheet.vertices[line[:-1]]) / 2
        brace = sheet.vertices[np.unique(sheet.triangles[sheet.covered]), 0]
        beyond = np.where(np.abs(middle[:, 0]) < brace.max(), 1, 2)
    length = FOOT_MM if end == -1 else GUTTER_MM
    return prolonged(sheet, line, np.array([0.0, float(end), 0.0]), length, beyond)
