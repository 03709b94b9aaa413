"""How the silicone gets in and the air out: places where bubbles would stay, vents there, and the port.

Air in a mold climbs along the ceiling of the cavity until it stands in a local maximum of height. Whether
such a maximum matters is told by its persistence: how far the air would have to be pushed down before it
found a way to a higher place (0-dimensional persistence of the height function; Edelsbrunner, Letscher &
Zomorodian 2002).
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float, Int
from manifold3d import Manifold
from scipy.spatial import KDTree

from fabrication.bodies import mesh_of, vertex_normals
from fabrication.mold import Casting, Core, Filling, Piece
from hilbrace.config.mold import MoldSettings
from hilbrace.errors import GeometryError

Array = np.ndarray

PERSISTENCE_MM = 0.4
"""Depth of a pocket of air that is a flaw in the casting [mm]."""

VENT_MM = 1.6
"""Diameter of a vent [mm]: air passes, and silicone seals it with a thread that is cut off."""

VENT_CLIMB_DEG = 40.0
"""How steeply vents climb on their way out [deg]: printable without support, and air rises in them."""

VENT_TURNS_DEG = (0.0, 25.0, -25.0, 50.0, -50.0)
"""Turns to the side by which a vent may avoid the flanges [deg]."""

VENT_ROOM_MM = 3.5
"""A vent keeps so far from the next shell [mm]."""

PORT_HEIGHT_MM = 4.0
"""How far above the lower rim the syringe goes in [mm]."""

PORT_RADIUS_MM = 10.0
"""Room around the port's boss [mm]."""

MOST_SLOPE = 0.6
"""Cosine between the surface's normal and up from which on a level port leaves the wall too slantwise."""

PORT_CLEARANCE_MM = 2.0
"""Material this much thicker than a shell's wall is a flange [mm]."""

FAR_MM = 400.0
"""Longer than any way through a shell [mm]."""

OPEN_MM = 1.0
"""A point of the brace this close to the gutter is open to the air [mm]."""


@dataclass(frozen=True)
class Maximum:
    """A place where air gathers.

    Attributes:
        vertex: Vertex of the surface.
        point: Its position [mm].
        persistence: How far down the air must go to get away from there [mm]; infinite at the very top.
    """

    vertex: int
    point: Float[Array, "3"]
    persistence: float


def find_maxima(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    up: Float[Array, "3"],
    opened: Bool[Array, " vertex"] | None = None,
    persistence_mm: float = PERSISTENCE_MM,
) -> tuple[Maximum, ...]:
    """Maxima of height on the ceiling of a cavity, the highest first.

    Args:
        vertices: Surface of the cavity, closed [mm].
        triangles: Its triangles, outward.
        up: Unit direction that is up.
        opened: Vertices that are open to the air: what climbs to one of them is free.
        persistence_mm: Shallower pockets are left out [mm].
    """
    height = vertices @ up
    free = np.zeros(len(vertices), bool) if opened is None else opened
    level = np.where(free, height.max() + (height.max() - height.min()) + 1.0, height)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    summit = _summits(level, edges)
    depth = _persistence(level, edges, summit)
    upward = vertex_normals(vertices, triangles) @ up > 0
    found = [
        Maximum(vertex, vertices[vertex], value)
        for vertex, value in depth.items()
        if value > persistence_mm and upward[vertex] and not free[vertex]
    ]
    return tuple(sorted(found, key=lambda maximum: (-height[maximum.vertex], maximum.vertex)))


def trapped_maxima(brace: Manifold, core: Core, up: Float[Array, "3"]) -> tuple[Maximum, ...]:
    """Places of the brace's cavity where air stays: maxima from which nothing leads up into the gutter.

    Args:
        brace: The body to cast, which is the cavity.
        core: The core with the open gutter.
        up: Unit direction that is up.
    """
    vertices, triangles = mesh_of(brace)
    return find_maxima(vertices, triangles, up, opened=_near_points(vertices, core.gutter))


def plan(
    casting: Casting, core: Core, shells: tuple[Piece, ...], settings: MoldSettings
) -> tuple[Filling, tuple[Manifold, ...]]:
    """Where the syringe goes in, and the drills that make the vents.

    The mold is filled as the core stands, from the lowest place of the cavity that no flange covers, up into
    the open gutter.

    Args:
        casting: What is cast.
        core: Its core.
        shells: The shells before they are drilled.
        settings: Wall of the shells.

    Returns:
        The filling, and one drill per vent, to be taken from the core and from the shells.

    Raises:
        GeometryError: No place of the lower rim is free for the port.
    """
    up = core.axis / np.linalg.norm(core.axis)
    port, outward = _port(casting, core, shells, settings)
    trapped = trapped_maxima(casting.brace, core, up)
    points = np.array([maximum.point for maximum in trapped]).reshape(-1, 3)
    _, nearest = KDTree(casting.outer).query(points)
    drills = tuple(
        _vent(point, _level(casting.direction[index], up), up, shells)
        for point, index in zip(points, np.atleast_1d(nearest), strict=True)
    )
    return Filling(up=up, port=port, vents=points, inlet=outward), drills


def _port(
    casting: Casting, core: Core, shells: tuple[Piece, ...], settings: MoldSettings
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Lowest point of the lower rim that stays clear of the flanges, and the way out from there."""
    up = core.axis / np.linalg.norm(core.axis)
    outer = KDTree(casting.outer)
    surface = np.concatenate([mesh_of(piece.solid)[0] for piece in shells])
    flanges = surface[outer.query(surface)[0] > settings.wall_mm + PORT_CLEARANCE_MM]
    places = core.lower - PORT_HEIGHT_MM * casting.down
    directions = casting.direction[outer.query(places)[1]]
    clear = np.abs(directions @ up) < MOST_SLOPE
    if len(flanges):
        clear &= KDTree(flanges).query(places)[0] > settings.wall_mm + PORT_RADIUS_MM
    if not clear.any():
        raise GeometryError(
            "the flanges leave no room for the filling port",
            where="mold: lower rim",
            hint="use fewer shells (mold.shells = 2) or narrower flanges (mold.flange_mm)",
        )
    height = np.where(clear, places @ up, np.inf)
    lowest = int(np.argmin(height))
    return places[lowest], _level(directions[lowest], up)


def _level(direction: Float[Array, "3"], up: Float[Array, "3"]) -> Float[Array, "3"]:
    """The horizontal part of a direction, of unit length; of a vertical one, any horizontal direction."""
    flat = direction - (direction @ up) * up
    if np.linalg.norm(flat) < 1e-6:
        flat = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    return flat / np.linalg.norm(flat)


def _vent(
    point: Float[Array, "3"], outward: Float[Array, "3"], up: Float[Array, "3"], shells: tuple[Piece, ...]
) -> Manifold:
    """A drill from inside the cavity, outwards and up, through the wall of one shell.

    Of the ways out, turned to either side, the straightest one is taken that keeps clear of the next shell.
    """
    drills = []
    for turn in VENT_TURNS_DEG:
        way = _climbing(outward, up, turn)
        length = _way_out(point, way, shells) + VENT_MM
        start = point - 0.5 * VENT_MM * way
        room = cylinder(start, way, length, VENT_ROOM_MM)
        met = sorted(((room ^ piece.solid).volume() for piece in shells), reverse=True)
        drills.append((sum(met[1:]), cylinder(start, way, length + 0.5 * VENT_MM, 0.5 * VENT_MM)))
        if sum(met[1:]) == 0:
            break
    return min(drills, key=lambda drill: drill[0])[1]


def _climbing(outward: Float[Array, "3"], up: Float[Array, "3"], turn_deg: float) -> Float[Array, "3"]:
    climb, turn = np.deg2rad((VENT_CLIMB_DEG, turn_deg))
    level = np.cos(turn) * outward + np.sin(turn) * np.cross(up, outward)
    return np.cos(climb) * level + np.sin(climb) * up


def _way_out(point: Float[Array, "3"], way: Float[Array, "3"], shells: tuple[Piece, ...]) -> float:
    """Distance to the outer face of the shells [mm]."""
    far = tuple(point + FAR_MM * way)
    hits = (hit for piece in shells for hit in piece.solid.ray_cast(tuple(point), far))
    return max((float((np.asarray(hit.position) - point) @ way) for hit in hits), default=4 * VENT_MM)


def cylinder(
    start: Float[Array, "3"], way: Float[Array, "3"], length_mm: float, radius_mm: float
) -> Manifold:
    """A cylinder from a point along a unit direction [mm]."""
    side = _level(np.eye(3)[int(np.argmin(np.abs(way)))], way)
    turn = np.column_stack([side, np.cross(way, side), way, start])
    return Manifold.cylinder(length_mm, radius_mm, radius_mm, 24).transform(turn)


def _near_points(vertices: Float[Array, "vertex 3"], gutter: Manifold) -> Bool[Array, " vertex"]:
    """Vertices that touch the gutter."""
    points, triangles = mesh_of(gutter)
    if len(points) == 0:
        return np.zeros(len(vertices), bool)
    low, high = points.min(axis=0) - OPEN_MM, points.max(axis=0) + OPEN_MM
    near = ((vertices > low) & (vertices < high)).all(axis=1)
    touching = np.zeros(len(vertices), bool)
    if near.any():
        squared = igl.point_mesh_squared_distance(vertices[near], points, triangles)[0]
        touching[near] = np.asarray(squared) < OPEN_MM**2
    return touching


def _summits(level: Array, edges: Array) -> Int[Array, " vertex"]:
    """For each vertex the summit that steepest neighbours lead to; equal heights are told apart by index."""
    order = np.lexsort((np.arange(len(level)), level))
    rank = np.empty(len(level), np.int64)
    rank[order] = np.arange(len(level))
    best = rank.copy()
    np.maximum.at(best, edges[:, 0], rank[edges[:, 1]])
    np.maximum.at(best, edges[:, 1], rank[edges[:, 0]])
    uphill = order[best]
    while True:
        further = uphill[uphill]
        if np.array_equal(further, uphill):
            return uphill
        uphill = further


def _persistence(level: Array, edges: Array, summit: Array) -> dict[int, float]:
    """Persistence of each summit: where two basins meet, the lower summit ends (the elder rule)."""
    first, second = summit[edges[:, 0]], summit[edges[:, 1]]
    between = first != second
    saddle = np.minimum(level[edges[between, 0]], level[edges[between, 1]])
    pairs = np.sort(np.stack([first[between], second[between]], axis=1), axis=1)
    order = np.lexsort((pairs[:, 1], pairs[:, 0], -saddle))
    _, once = np.unique(pairs[order], axis=0, return_index=True)
    parent = {int(vertex): int(vertex) for vertex in np.unique(summit)}

    def root(vertex: int) -> int:
        while parent[vertex] != vertex:
            parent[vertex] = parent[parent[vertex]]
            vertex = parent[vertex]
        return vertex

    depth: dict[int, float] = {}
    for index in order[np.sort(once)]:
        low, high = sorted((root(int(v)) for v in pairs[index]), key=lambda v: (level[v], v))
        if low != high:
            depth[low] = float(level[low] - saddle[index])
            parent[low] = high
    return depth | {vertex: np.inf for vertex in parent if root(vertex) == vertex}
