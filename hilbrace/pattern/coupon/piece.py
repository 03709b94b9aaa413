"""Flat test pieces of a microstructure: a plate of whole cells between two solid grips.

A laboratory casts the plate from its own rubber and pulls it; `hilbrace.pattern.coupon.stiffness` says what
force that takes, and `hilbrace.pattern.coupon.calibration` reads the modulus of the rubber out of the
measurement.

The plate lies in the plane of x and y and is pulled along y. Its free edges and the edges of its grips run
along mirror lines of the cells, where nothing that the sheet carries is cut obliquely. Each grip has a hole
for a pin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hilbrace.domain.isoline import compact, split_at_zero
from hilbrace.errors import ConfigError, GeometryError
from hilbrace.material.cells import cell_distance, fold
from hilbrace.material.curves import load_curves
from hilbrace.pattern.thicken import border_edges, manifold, surface, thicken

Array = np.ndarray

SNAP = 0.25
"""Vertices nearer to the border than this share of a step of the grid are moved onto it."""
LEAST_STRUT_STEPS = 5.0
"""Steps of the grid across the thinnest strut, at least."""
COARSEST, FINEST = 24, 96
"""Least and most steps of the grid in a cell."""


@dataclass(frozen=True)
class CouponPlan:
    """What a test piece is made of.

    Attributes:
        cell: Name of the microstructure, or path of its skeleton file.
        d: Design variable [-], 0 for the thinnest and 1 for the widest struts that designs use.
        along: Axis of the map that lies along the pull.
        cell_mm: Side of a cell [mm]; two of them make a period.
        across: Cells from one free edge to the other.
        length: Cells from one grip to the other.
        thickness_mm: Thickness of the plate [mm].
        grip_mm: Length of each grip [mm].
        pin_mm: Diameter of the holes in the grips [mm].
    """

    cell: str
    d: float
    along: Literal["u", "v"] = "v"
    cell_mm: float = 10.0
    across: int = 6
    length: int = 12
    thickness_mm: float = 4.0
    grip_mm: float = 25.0
    pin_mm: float = 6.0

    @property
    def width_mm(self) -> float:
        """Distance of the free edges [mm]."""
        return self.across * self.cell_mm

    @property
    def gauge_mm(self) -> float:
        """Distance of the grips [mm]."""
        return self.length * self.cell_mm

    @property
    def strut_mm(self) -> float:
        """Width of the struts [mm]."""
        return 2.0 * load_curves(self.cell).width(self.d) * self.cell_mm


@dataclass(frozen=True)
class Sheet:
    """The plate as a flat mesh, front side up.

    Attributes:
        vertices: Positions [mm]; the middle between the grips is the origin, all z are 0.
        triangles: Vertex indices, counterclockwise.
        grip: True in the grips.
        upper_pin: Vertices of the hole in the upper grip.
        lower_pin: Vertices of the hole in the lower grip.
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    grip: Bool[Array, " triangle"]
    upper_pin: Int[Array, " upper"]
    lower_pin: Int[Array, " lower"]


def check_plan(plan: CouponPlan) -> None:
    """Refuse a plan that makes no test piece.

    Raises:
        ConfigError: A figure is out of its range; it is named.
    """
    ranges = (
        ("d", plan.d, 0.0, 1.0, "the design variable runs from 0 to 1"),
        ("cell-mm", plan.cell_mm, 2.0, 100.0, "cells of braces have sides of 8 to 20 mm"),
        ("across", plan.across, 2, 40, "take 6 or more: free edges make narrow plates too soft or too stiff"),
        ("length", plan.length, 2, 80, "take twice as many cells along as across"),
        ("thickness-mm", plan.thickness_mm, 0.5, 20.0, "braces are 3 to 5 mm thick"),
        ("grip-mm", plan.grip_mm, 2.0 * plan.pin_mm, 200.0, "a grip is at least two pins long"),
        ("pin-mm", plan.pin_mm, 1.0, 0.5 * plan.width_mm, "a pin is at most half as wide as the plate"),
    )
    for name, value, low, high, hint in ranges:
        if not low <= value <= high:
            raise ConfigError(
                f"{value:g} is not between {low:g} and {high:g}", where=f"coupon: {name}", hint=hint
            )
    for name, cells in (("across", plan.across), ("length", plan.length)):
        if cells % 2:
            raise ConfigError(
                f"{cells} cells are no whole periods of two",
                where=f"coupon: {name}",
                hint="take an even number",
            )


def lattice(plan: CouponPlan, steps: int | None = None) -> Sheet:
    """The plate with every strut.

    Args:
        plan: The test piece.
        steps: Steps of the grid in a cell; enough for the struts if left out.

    Raises:
        ConfigError: The plan makes no test piece.
        GeometryError: The struts do not hang together between the grips.
    """
    check_plan(plan)
    width = float(load_curves(plan.cell).width(plan.d))
    return _sheet(plan, width, strut_steps(plan) if steps is None else steps)


def strut_steps(plan: CouponPlan) -> int:
    """Steps of the grid in a cell that lay `LEAST_STRUT_STEPS` across a strut, within reason."""
    strut = plan.strut_mm / plan.cell_mm
    return int(np.clip(np.ceil(LEAST_STRUT_STEPS / strut), COARSEST, FINEST))


def plate(plan: CouponPlan, steps: int = 6) -> Sheet:
    """The plate without holes between the grips, for a sheet that stands for the struts.

    Args:
        plan: The test piece.
        steps: Steps of the grid in a cell.
    """
    check_plan(plan)
    return _sheet(plan, np.inf, steps)


def coupon_body(plan: CouponPlan, sheet: Sheet) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """The test piece as a closed body [mm], outward triangles.

    Raises:
        GeometryError: The body is not closed.
    """
    upwards = np.broadcast_to([0.0, 0.0, 1.0], sheet.vertices.shape)
    body = manifold(*thicken(sheet.vertices, upwards, sheet.triangles, plan.thickness_mm))
    return surface(body)


def volume_fraction(sheet: Sheet, plan: CouponPlan) -> float:
    """Share of the plate between the grips that is rubber [-]."""
    corner = sheet.vertices[sheet.triangles[~sheet.grip], :2]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum() / 2
    return float(area / (plan.width_mm * plan.gauge_mm))


def _sheet(plan: CouponPlan, width: float, steps: int) -> Sheet:
    grid, triangles, step = _grid(plan, steps)
    depth = _depth(plan, width, grid)
    grid, depth = _snapped(grid, triangles, depth, step)
    flat = np.concatenate([grid, np.zeros((len(grid), 1))], axis=1)
    flat, triangles, level = split_at_zero(flat, triangles, depth)
    flat, triangles = compact(flat, triangles, level[triangles].sum(axis=1) > 0)
    flat, triangles = _largest_piece(flat, triangles)
    inside = np.abs(flat[triangles, 1]).max(axis=1) <= plan.gauge_mm / 2 + 1e-9
    pins = [_pin(plan, flat, triangles, side) for side in (1.0, -1.0)]
    return Sheet(flat, triangles, ~inside, pins[0], pins[1])


def _grid(plan: CouponPlan, steps: int) -> tuple[Float[Array, "node 2"], Int[Array, "triangle 3"], float]:
    """Squares of one step over grips and gauge, each cut along a diagonal, their directions alternating."""
    step = plan.cell_mm / steps
    columns, rows = plan.across * steps, plan.length * steps
    grip = int(np.ceil(plan.grip_mm / step))
    x = (np.arange(columns + 1) - columns / 2) * step
    y = (np.arange(rows + 2 * grip + 1) - rows / 2 - grip) * step
    nodes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(columns), np.arange(len(y) - 1), indexing="ij"))
    a = i * len(y) + j
    square = np.stack([a, a + len(y), a + len(y) + 1, a + 1], axis=1)
    even = ((i + j) % 2 == 0)[:, None, None]
    halves = np.where(even, square[:, [[0, 1, 2], [0, 2, 3]]], square[:, [[0, 1, 3], [1, 2, 3]]])
    return nodes, halves.reshape(-1, 3), step


def _depth(plan: CouponPlan, width: float, nodes: Float[Array, "node 2"]) -> Float[Array, " node"]:
    """Signed depth inside the rubber [mm]."""
    beyond = np.abs(nodes[:, 1]) - plan.gauge_mm / 2
    if np.isinf(width):
        struts = np.full(len(nodes), plan.cell_mm)
    else:
        across, along = (
            fold((nodes[:, k] + size / 2) / plan.cell_mm, 2.0)
            for k, size in enumerate((plan.width_mm, plan.gauge_mm))
        )
        u, v = (along, across) if plan.along == "u" else (across, along)
        struts = (width - cell_distance(plan.cell, u, v)) * plan.cell_mm
    pin = np.hypot(nodes[:, 0], np.abs(nodes[:, 1]) - _pin_height(plan)) - plan.pin_mm / 2
    return np.minimum(np.maximum(struts, beyond), pin)


def _pin_height(plan: CouponPlan) -> float:
    return (plan.gauge_mm + plan.grip_mm) / 2


def _snapped(
    nodes: Float[Array, "node 2"],
    triangles: Int[Array, "triangle 3"],
    depth: Float[Array, " node"],
    step: float,
) -> tuple[Float[Array, "node 2"], Float[Array, " node"]]:
    """Move nodes near the border onto it, along an edge that crosses it: no needles are cut off.

    Nodes on the outline of the grid move along the outline only.
    """
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    on_side = np.logical_or(nodes == low, nodes == high)
    both = np.concatenate([edges, edges[:, ::-1]])
    near, far = depth[both[:, 0]], depth[both[:, 1]]
    part = np.where(near * far < 0, near / np.where(near == far, 1.0, near - far), np.inf)
    free = ~(on_side[both[:, 0]] & (nodes[both[:, 0]] != nodes[both[:, 1]])).any(axis=1)
    length = np.linalg.norm(nodes[both[:, 1]] - nodes[both[:, 0]], axis=1)
    usable = np.flatnonzero(free & (part * length < SNAP * step))
    order = usable[np.argsort((part * length)[usable], kind="stable")[::-1]]
    moved, snapped = nodes.copy(), depth.copy()
    tail, head = both[order].T
    moved[tail] = nodes[tail] + part[order, None] * (nodes[head] - nodes[tail])
    snapped[tail] = 0.0
    return moved, snapped


def _largest_piece(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> tuple[Float[Array, "used 3"], Int[Array, "kept 3"]]:
    """The piece that hangs together by edges, with a vertex of its own where two of its corners touch."""
    vertices, triangles = _parted(vertices, triangles)
    links = triangles[:, [[0, 1], [1, 2]]].reshape(-1, 2)
    graph = coo_array((np.ones(len(links)), links.T), shape=(len(vertices), len(vertices)))
    _, piece = connected_components(graph, directed=False)
    owner = piece[triangles[:, 0]]
    return compact(vertices, triangles, owner == np.bincount(owner).argmax())


def _parted(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> tuple[Float[Array, "point 3"], Int[Array, "triangle 3"]]:
    """One vertex for each fan of triangles: where two fans touch in a point, the point is doubled."""
    corner = np.arange(3 * len(triangles)).reshape(-1, 3)
    directed = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    own = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
    key = np.sort(directed, axis=1) @ [len(vertices), 1]
    flipped = directed[:, 0] > directed[:, 1]
    order = np.lexsort((flipped, key))
    shared = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, two = own[order[shared]], own[order[shared + 1]][:, ::-1]
    joined = np.concatenate([np.stack([one[:, k], two[:, k]], axis=1) for k in (0, 1)])
    graph = coo_array((np.ones(len(joined)), joined.T), shape=(corner.size, corner.size))
    _, fan = connected_components(graph, directed=False)
    first = np.unique(fan, return_index=True)[1]
    return vertices[triangles.ravel()[first]], fan[corner].astype(np.int64)


def _pin(
    plan: CouponPlan, vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], side: float
) -> Int[Array, " loop"]:
    """Vertices of the hole in one grip."""
    border = np.unique(border_edges(triangles))
    away = np.hypot(vertices[border, 0], vertices[border, 1] - side * _pin_height(plan))
    loop = border[away < 0.75 * plan.pin_mm]
    if len(loop) < 6:
        raise GeometryError(
            "the struts do not hang together from one grip to the other",
            where=f"coupon of '{plan.cell}' at d = {plan.d:g}",
            hint="raise d, or take more cells across",
        )
    return loop
