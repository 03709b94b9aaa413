"""The seam: a path of mesh edges along the limb, along which the sleeve is opened for its flat map."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import igl
import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import dijkstra

from hilbrace.domain.isoline import mesh_edges
from hilbrace.domain.limb import Limb, Surface
from hilbrace.domain.loops import Loops
from hilbrace.errors import GeometryError

Array = np.ndarray


@dataclass(frozen=True)
class Cut:
    """A sleeve opened along a seam.

    Attributes:
        triangles: Triangles of the cut mesh, in the order of the sleeve's.
        weld: Vertex of the sleeve that each cut vertex is.
        pairs: Cut vertices on the left and right edge of the opened sleeve that are one vertex in the
            closed one, from distal to proximal.
    """

    triangles: Int[Array, "triangle 3"]
    weld: Int[Array, " cut_vertex"]
    pairs: Int[Array, "pair 2"]


def find_seam(
    surface: Surface,
    limb: Limb,
    loops: Loops,
    azimuth_deg: float,
) -> Int[Array, " path"]:
    """Path of edges from the lower to the upper loop near an azimuth, clear of the windows.

    Shortest path on the finished mesh, each edge as long as ``length (1 + (distance to the azimuth /
    mean edge)^2)``. Unlike a line embedded before meshing it cannot spoil the mesh and always exists;
    it follows the azimuth to within about one edge.

    Args:
        surface: The sleeve in limb axes [mm].
        limb: Axes of the leg.
        loops: Open edges of the sleeve.
        azimuth_deg: 0 anterior, 90 lateral, 180 posterior [deg].

    Returns:
        Vertices from the lower to the upper loop; only the ends lie on a loop.

    Raises:
        GeometryError: A window lies at the azimuth, or no path joins the loops.
    """
    _check_windows(surface, limb, loops, azimuth_deg)
    count = len(surface.vertices)
    source, sink = count, count + 1
    upper, lower = loops.upper, loops.lower
    tails, heads, costs = _steps(surface, azimuth_cost(surface, limb, azimuth_deg), loops)
    tails = np.concatenate([tails, np.full(len(lower), source), upper])
    heads = np.concatenate([heads, lower, np.full(len(upper), sink)])
    costs = np.concatenate([costs, np.full(len(lower) + len(upper), 1e-6)])
    graph = sp.csr_array((costs, (tails, heads)), shape=(count + 2, count + 2))
    _, before = dijkstra(graph, indices=source, return_predecessors=True)
    path = []
    node = before[sink]
    while node not in (source, -9999):
        path.append(node)
        node = before[node]
    if len(path) < 3:
        raise GeometryError(
            "no path of edges joins the two edges of the sleeve",
            where="domain.seam_azimuth_deg",
            hint="ask for more triangles",
        )
    return np.array(path[::-1], np.int64)


def _check_windows(surface: Surface, limb: Limb, loops: Loops, azimuth_deg: float) -> None:
    """Refuse an azimuth at which a window lies, within an edge of the mesh."""
    for window in loops.windows:
        points = surface.vertices[window]
        edge = float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean())
        azimuth = limb.azimuth(points)
        middle = float(np.angle(np.exp(1j * azimuth).mean()))
        turn = np.angle(np.exp(1j * (azimuth - middle)))
        margin = edge / float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
        middle = middle if middle > -np.pi / 2.0 else middle + 2.0 * np.pi
        low, high = np.degrees([middle + turn.min() - margin, middle + turn.max() + margin])
        if (azimuth_deg - low) % 360.0 <= high - low:
            raise GeometryError(
                f"the seam at {azimuth_deg:g} deg would run through a window of the sleeve",
                where="domain.seam_azimuth_deg",
                hint=f"choose an azimuth clear of the window, which spans {low:.0f} to {high:.0f} deg",
            )


def azimuth_cost(surface: Surface, limb: Limb, azimuth_deg: float) -> Float[Array, " vertex"]:
    """Squared distance of each vertex to the seam's azimuth along the skin, in mean edges [-]."""
    edges, _ = mesh_edges(surface.triangles)
    mean_edge = np.linalg.norm(np.diff(surface.vertices[edges], axis=1), axis=-1).mean()
    turn = limb.azimuth(surface.vertices) - np.radians(azimuth_deg)
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
    radius = limb.distance(surface.vertices)
    return (turn * radius / mean_edge) ** 2


def cut_along(surface: Surface, path: Int[Array, " path"]) -> Cut:
    """Open a sleeve along a path of edges from its lower to its upper loop.

    Seen from outside with the proximal end up, what lies to the right of the seam becomes the left edge
    of the opened sleeve.

    Raises:
        GeometryError: The cut does not leave a disc.
    """
    triangles = surface.triangles
    step = set(pairwise(path.tolist()))
    on_path = np.isin(triangles, path)
    flags = np.zeros(triangles.shape, bool)
    left_of, right_of = {}, {}
    for face, corner in np.argwhere(on_path & np.roll(on_path, -1, axis=1)).tolist():
        tail, head = int(triangles[face, corner]), int(triangles[face, (corner + 1) % 3])
        if (tail, head) in step:
            left_of[tail, head] = face, corner
        elif (head, tail) in step:
            right_of[head, tail] = face, corner
        else:
            continue
        flags[face, corner] = True
    _, opened, weld = igl.cut_mesh(np.ascontiguousarray(surface.vertices), triangles, flags)
    opened, weld = np.asarray(opened, np.int64), np.asarray(weld, np.int64).ravel()
    pairs = _pairs(path, opened, left_of, right_of)
    whole = igl.euler_characteristic(opened) == igl.euler_characteristic(triangles) + 1
    whole &= len(weld) == len(surface.vertices) + len(path)
    if not whole or (pairs[:, 0] == pairs[:, 1]).any():
        raise GeometryError(
            "the cut along the seam does not open the sleeve into one flat piece",
            where="domain.seam_azimuth_deg",
            hint="move the seam by a few degrees",
        )
    return Cut(opened, weld, pairs)


def _steps(
    surface: Surface,
    cost: Float[Array, " vertex"],
    loops: Loops,
) -> tuple[Int[Array, " step"], Int[Array, " step"], Float[Array, " step"]]:
    """Directed edges that leave the lower loop, run inside, and end on the upper loop."""
    edges, _ = mesh_edges(surface.triangles)
    tails, heads = np.concatenate([edges, edges[:, ::-1]]).T
    place = np.zeros(len(surface.vertices), int)
    place[loops.lower], place[loops.upper] = -1, 1
    free = np.ones(len(place), bool)
    free[np.concatenate([np.zeros(0, np.int64), *loops.windows])] = False
    allowed = (
        free[heads]
        & free[tails]
        & (place[heads] >= 0)
        & (place[tails] <= 0)
        & ((place[tails] == 0) | (place[heads] == 0))
    )
    tails, heads = tails[allowed], heads[allowed]
    length = np.linalg.norm(surface.vertices[heads] - surface.vertices[tails], axis=1)
    return tails, heads, length * (1.0 + (cost[tails] + cost[heads]) / 2.0)


Side = dict[tuple[int, int], tuple[int, int]]


def _pairs(
    path: Int[Array, " path"], opened: Int[Array, "triangle 3"], left_of: Side, right_of: Side
) -> Int[Array, "pair 2"]:
    """Copies of the path's vertices: those right of the path first, they are the map's left edge."""
    pairs = np.empty((len(path), 2), np.int64)
    for place, (tail, head) in enumerate(pairwise(path.tolist())):
        face, corner = right_of[tail, head]
        pairs[place, 0], pairs[place + 1, 0] = opened[face, (corner + 1) % 3], opened[face, corner]
        face, corner = left_of[tail, head]
        pairs[place, 1], pairs[place + 1, 1] = opened[face, corner], opened[face, (corner + 1) % 3]
    return pairs
