"""Make a pattern castable: no strut too narrow, no dead end, no slit too narrow, one piece.

Opening a pattern by a disc would break every strut that is a little too narrow. Here such struts are widened
instead. The axis of the struts that carry load is where two *different* holes are equally near: a dead end
reaches into one hole only and has no part of it. Discs of at least the wanted width along that axis are
added to the struts, and what no disc reaches is a dead end and goes. Slits are closed by rolling a disc
along the inside of the holes. All distances are taken to the border's segments, not to mesh vertices, so
widths are accurate well below the length of a mesh edge.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from hilbrace.errors import GeometryError
from hilbrace.pattern.axis import StrutAxis, strut_axis
from hilbrace.pattern.border import border, hole_numbers
from hilbrace.pattern.clip import ZeroLine, zero_line
from hilbrace.pattern.refine import RefinedSkin
from hilbrace.pattern.zone import EVERYWHERE, Zone

Array = np.ndarray

STUB_MM = 0.15
"""A bump that sticks out of a strut by less than this may stay [mm]."""
BUMP = 0.8
"""Diameter of the disc that smooths the struts, as a share of their least width [-]."""
SMOOTHING = 4
"""Passes that smooth the border where the clean-up moved it [-]."""
MOVED_MM = 0.3
"""Distance from the border above which a vertex that changes sides is a sign of more than widening [mm]."""
ROLL_TOLERANCE_MM = 0.05
"""How far the border may reach into the disc that closes slits [mm]."""


def clean(
    skin: RefinedSkin,
    depth: Float[Array, " vertex"],
    rim_depth: Float[Array, " vertex"],
    areas: Float[Array, " triangle"],
    strut_mm: float,
    slit_mm: float,
) -> Float[Array, " vertex"]:
    """Widen narrow struts, cut dead ends, close slits, and smooth what this leaves.

    Args:
        skin: The refined skin.
        depth: Depth inside the pattern at its vertices [mm].
        rim_depth: Depth inside the solid bands, which stay [mm].
        areas: Areas of the skin's triangles [mm^2].
        strut_mm: Least width of a strut [mm].
        slit_mm: Least width of a slit [mm].

    Returns:
        The new depth [mm].
    """
    given = depth
    depth = fill_specks(skin, zero_line(skin, depth), areas, slit_mm)
    depth = widen_and_prune(skin, zero_line(skin, depth), rim_depth, strut_mm)
    depth = close_slits(skin, zero_line(skin, depth), slit_mm)
    axis = strut_axis(skin, zero_line(skin, depth))
    depth = shave_bumps(skin, zero_line(skin, depth), rim_depth, BUMP * strut_mm)
    changed = ((depth > 0) != (given > 0)) & (np.abs(given) > MOVED_MM)
    depth = smooth_border(skin, zero_line(skin, depth), rim_depth, changed)
    depth = widen(skin, depth, axis, strut_mm)
    depth = widen_and_prune(skin, zero_line(skin, depth), rim_depth, strut_mm)
    return fill_specks(skin, zero_line(skin, depth), areas, slit_mm)


def widen_and_prune(
    skin: RefinedSkin, line: ZeroLine, rim_depth: Float[Array, " vertex"], strut_mm: float
) -> Float[Array, " vertex"]:
    """Give every strut its least width and remove dead ends.

    Args:
        skin: The refined skin.
        line: Zero line of the pattern.
        rim_depth: Depth inside the solid bands, which stay [mm].
        strut_mm: Least width of a strut [mm].

    Returns:
        The new depth at the vertices [mm].
    """
    axis = strut_axis(skin, line)
    if not len(axis.points):
        return line.depth
    radius = np.maximum(axis.radius, strut_mm / 2) + STUB_MM
    depth = widen(skin, line.depth, axis, strut_mm)
    solid = depth > 0
    distance, near = KDTree(axis.points).query(skin.vertices[solid], workers=-1)
    reached = np.full(len(depth), np.inf)
    reached[solid] = radius[near] - distance
    doubtful = solid & (reached < 2 * skin.edge_mm)
    reached[doubtful] = depth_in_balls(skin.vertices[doubtful], axis.points, radius)
    return np.maximum(np.minimum(depth, reached), rim_depth)


def widen(
    skin: RefinedSkin, depth: Float[Array, " vertex"], axis: StrutAxis, strut_mm: float
) -> Float[Array, " vertex"]:
    """Add discs of diameter ``strut_mm`` along the axis of the struts.

    Returns:
        The new depth at the vertices [mm].
    """
    if not len(axis.points):
        return depth
    distance = KDTree(axis.points).query(skin.vertices, distance_upper_bound=strut_mm, workers=-1)[0]
    return np.maximum(depth, strut_mm / 2 - distance)


def close_slits(
    skin: RefinedSkin, line: ZeroLine, slit_mm: float, zone: Zone = EVERYWHERE
) -> Float[Array, " vertex"]:
    """Fill what a disc of diameter ``slit_mm`` rolling inside the holes does not reach.

    Args:
        skin: The refined skin.
        line: Zero line of the pattern.
        slit_mm: Least width of a slit [mm].
        zone: Where slits are closed.

    Returns:
        The new depth at the vertices [mm].
    """
    depth = line.depth.copy()
    vertices, unreached = _out_of_reach(skin, line, slit_mm / 2, -1.0, zone)
    depth[vertices] = np.maximum(depth[vertices], unreached)
    return depth


def shave_bumps(
    skin: RefinedSkin,
    line: ZeroLine,
    rim_depth: Float[Array, " vertex"],
    disc_mm: float,
    zone: Zone = EVERYWHERE,
) -> Float[Array, " vertex"]:
    """Cut off what a disc of diameter ``disc_mm`` rolling inside the struts does not reach.

    Args:
        skin: The refined skin.
        line: Zero line of the pattern.
        rim_depth: Depth inside the solid bands, which stay [mm].
        disc_mm: Diameter of the disc [mm].
        zone: Where bumps are cut off.

    Returns:
        The new depth at the vertices [mm]; the solid bands stay.
    """
    depth = line.depth.copy()
    vertices, unreached = _out_of_reach(skin, line, disc_mm / 2, 1.0, zone)
    depth[vertices] = np.minimum(depth[vertices], -unreached)
    return np.maximum(depth, rim_depth)


def smooth_border(
    skin: RefinedSkin, line: ZeroLine, rim_depth: Float[Array, " vertex"], changed: Bool[Array, " vertex"]
) -> Float[Array, " vertex"]:
    """Smooth the border where the clean-up moved it.

    Cutting and filling leave depths that jump from vertex to vertex, and with them a border that is ragged
    on the scale of a mesh edge. Near such places the depth is replaced by the distance to the border and
    averaged over neighbours.

    Args:
        skin: The refined skin.
        line: Zero line of the cleaned pattern.
        rim_depth: Depth inside the solid bands, which stay [mm].
        changed: Vertices that the clean-up turned from solid to hole or back.

    Returns:
        The new depth at the vertices [mm].
    """
    if not changed.any():
        return line.depth
    edge = border(skin, line, hole_numbers(skin, line))
    tail, head = np.concatenate([skin.edges, skin.edges[:, ::-1]]).T
    count = len(line.depth)
    neighbours = np.bincount(tail, minlength=count)
    weight = changed.astype(float)
    for _ in range(SMOOTHING):
        weight = np.maximum(weight, np.bincount(tail, weight[head], minlength=count) / neighbours)
    weight = np.minimum(1.0, 3 * weight)
    near = np.flatnonzero(weight > 0)
    depth = line.depth.copy()
    distance = np.minimum(edge.nearest(skin.vertices[near])[0], 3 * skin.edge_mm)
    depth[near] = np.where(depth[near] > 0, distance, -distance)
    for _ in range(SMOOTHING):
        mean = np.bincount(tail, depth[head], minlength=count) / neighbours
        depth += weight / 2 * (mean - depth)
    return np.maximum(depth, rim_depth)


def fill_specks(
    skin: RefinedSkin, line: ZeroLine, areas: Float[Array, " triangle"], slit_mm: float
) -> Float[Array, " vertex"]:
    """Fill holes smaller than a disc of diameter ``slit_mm``.

    Returns:
        The new depth at the vertices [mm].
    """
    hole = hole_numbers(skin, line)
    share = np.bincount(skin.triangles.ravel(), np.repeat(areas / 3, 3), minlength=len(hole))
    size = np.bincount(hole + 1, share)
    speck = (hole >= 0) & (size[hole + 1] < np.pi / 4 * slit_mm**2)
    return np.where(speck, -line.depth, line.depth)


def depth_in_balls(
    points: Float[Array, "point 3"], centres: Float[Array, "ball 3"], radius: Float[Array, " ball"]
) -> Float[Array, " point"]:
    """Depth of points inside a union of balls, exact near its surface, negative outside [mm].

    The ball of least power ``|x - c|^2 - r^2`` is the nearest one in four dimensions, ``c`` lifted by
    ``sqrt(R^2 - r^2)`` with the largest radius ``R`` (Aurenhammer 1987).

    Args:
        points: Points [mm].
        centres: Centres of the balls [mm].
        radius: Their radii [mm].
    """
    lift = np.sqrt((radius.max() - radius) * (radius.max() + radius))
    lifted = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
    _, ball = KDTree(np.concatenate([centres, lift[:, None]], axis=1)).query(lifted, workers=-1)
    return radius[ball] - np.linalg.norm(points - centres[ball], axis=1)


def drop_islands(
    skin: RefinedSkin, depth: Float[Array, " vertex"], areas: Float[Array, " triangle"]
) -> tuple[Float[Array, " vertex"], int]:
    """Turn every piece but the largest into hole.

    Args:
        skin: The refined skin.
        depth: Depth at its vertices [mm].
        areas: Areas of its triangles [mm^2].

    Returns:
        The new depth and the number of pieces dropped.

    Raises:
        GeometryError: The pattern falls into pieces of similar size.
    """
    solid = depth > 0
    count = len(depth)
    within = skin.edges[solid[skin.edges].all(axis=1)]
    graph = coo_array((np.ones(len(within), dtype=bool), within.T), shape=(count, count))
    _, piece = connected_components(graph, directed=False)
    share = np.bincount(skin.triangles.ravel(), np.repeat(areas / 3, 3), minlength=count) * solid
    size = np.bincount(piece, share)
    largest = int(size.argmax())
    pieces = len(np.unique(piece[solid]))
    if size[largest] < 0.9 * size.sum():
        raise GeometryError(
            f"the struts fall into {pieces} pieces, the largest with {size[largest] / size.sum():.0%} of all",
            where="pattern",
            hint="raise optimize.volume_fraction or lower pattern.scale",
        )
    return np.where(solid & (piece != largest), -np.abs(depth), depth), pieces - 1


def _out_of_reach(
    skin: RefinedSkin, line: ZeroLine, radius: float, side: float, zone: Zone
) -> tuple[Int[Array, " near"], Float[Array, " near"]]:
    """Vertices near the border that no disc rolling along one side of it may cover.

    A disc touching the border at a place is free if the border does not reach into it, and if its centre is
    still on the side where it rolls and not beyond what lies opposite. Free discs and what
    lies deeper than they do make up what rolling reaches.

    Args:
        skin: The refined skin.
        line: Zero line of the pattern.
        radius: Radius of the disc [mm].
        side: 1 to roll inside the struts, -1 inside the holes.
        zone: Where vertices are looked at.

    Returns:
        Vertices on that side whose nearest disc is not free, and how far each lies from the nearest free
        disc, negative inside it, at most one radius [mm].
    """
    if radius == 0:
        return np.zeros(0, dtype=np.intp), np.zeros(0)
    edge = border(skin, line, hole_numbers(skin, line))
    there = np.flatnonzero(line.depth * side > 0)
    there = there[zone.holds(skin.vertices[there])]
    used = np.flatnonzero(zone.grown(4 * radius).holds(edge.middle))
    if not len(used):
        return np.zeros(0, dtype=np.intp), np.zeros(0)
    start, along = edge.start[used], edge.end[used] - edge.start[used]
    places = np.concatenate([start + t * along for t in (0.25, 0.75)])
    centres = places + side * radius * np.tile(edge.inward[used], (2, 1))
    distance, segment, foot = edge.nearest(centres)
    free = distance >= radius - ROLL_TOLERANCE_MM
    free &= side * np.einsum("px,px->p", centres - foot, edge.inward[segment]) > 0
    free &= (side > 0) | ~np.tile(edge.outside[used], 2)
    distance, place = KDTree(places).query(skin.vertices[there], distance_upper_bound=4 * radius, workers=-1)
    doubtful = np.isfinite(distance)
    doubtful[doubtful] = ~free[np.asarray(place)[doubtful]]
    near = there[doubtful]
    if not len(near) or not free.any():
        return near, np.full(len(near), radius)
    unreached = KDTree(centres[free]).query(skin.vertices[near], workers=-1)[0] - radius
    return near, np.minimum(unreached, radius)
