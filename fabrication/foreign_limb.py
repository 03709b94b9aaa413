"""The limb in a brace from a file: cut out of the limb's own file, or guessed from the brace's inner face."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import ConvexHull

from fabrication.foreign_brace import Mesh, distinct, open_edges, parts_of
from fabrication.sheet import rim_of
from hilbrace.body.mesh_file import load_triangles
from hilbrace.domain.isoline import compact, cut_by_levels, cut_by_plane, mesh_edges
from hilbrace.errors import GeometryError

Array = np.ndarray

HOLLOW = 0.2
"""Least distance of a sleeve from its axis over the mean one; below, a line through it is no axis [-]."""
SHORT_MM = 15.0
"""How far a limb may end before its brace does; it is prolonged."""
OPEN_MM = 0.02
"""How far the upper edge reaches into the gutter, so that it opens onto it."""
_SNAP_MM = 0.02
_BACK_MM = 0.5
_LONGER_MM = 5.0
_SNAP = 0.2
_RIM_MM = 15.0
_BIN_MM = 4.0
_CREST_MM = 3.0
_NOTCH = 3
_FACING = 0.7
_FEW = 8000
_FINENESS = 30
_WAYS = 600
_SMOOTHINGS = 20
_GRID = 1.25
"""Spacing of a guessed limb's mesh, in resolutions [-]."""


def tube_axis(brace: Mesh, where: str) -> Float[Array, "3"]:
    """Unit axis of a sleeve: the line through it that keeps furthest off its walls; upwards or forwards.

    Raises:
        GeometryError: The brace is no sleeve.
    """
    size = float(np.ptp(brace.vertices, axis=0).max())
    dense, _, _ = refined(brace.vertices, brace.vertices, brace.triangles, size / _FINENESS)
    away = dense - surface_centre(brace)
    few = away[:: max(1, len(away) // _FEW)]
    squared = (few**2).sum(axis=1)[:, None]
    ways = _half_sphere()
    radius = np.sqrt(np.maximum(squared - (few @ ways.T) ** 2, 0.0))
    freedom = radius.min(axis=0) / radius.mean(axis=0)
    best, free = ways[int(np.argmax(freedom))], float(freedom.max())
    if free < HOLLOW:
        raise GeometryError(
            "the brace is neither flat nor a sleeve around a limb: no straight line runs through its middle "
            "without coming near to it",
            where=where,
            hint="design it with hilbrace, which knows bent limbs, or cast its parts one by one",
        )
    axis = _shortest(away, best)
    return axis * np.sign(axis[np.argmax(np.abs(axis))])


def surface_centre(mesh: Mesh) -> Float[Array, "3"]:
    """Centroid of a surface [mm]."""
    p = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return (p.mean(axis=1) * area[:, None]).sum(axis=0) / area.sum()


def _half_sphere() -> Float[Array, "way 3"]:
    """Directions evenly spread over a half sphere (golden spiral), and the axes."""
    number = np.arange(_WAYS)
    z = (number + 0.5) / _WAYS
    turn = number * np.pi * (3 - np.sqrt(5))
    wide = np.sqrt(1 - z**2)
    return np.concatenate([np.eye(3), np.stack([wide * np.cos(turn), wide * np.sin(turn), z], axis=1)])


def _shortest(points: Float[Array, "point 3"], axis: Float[Array, "3"]) -> Float[Array, "3"]:
    """The unit direction near an axis in which points reach least far: across both edges of a sleeve."""
    corners = points[ConvexHull(points).vertices]
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    sides = np.stack([first, np.cross(axis, first)])

    def turned(tilt: Float[Array, "2"]) -> Float[Array, "3"]:
        way = axis + tilt @ sides
        return way / np.linalg.norm(way)

    found = minimize(
        lambda tilt: float(np.ptp(corners @ turned(tilt))),
        np.zeros(2),
        method="Nelder-Mead",
        options={"initial_simplex": [[0, 0], [0.2, 0], [0, 0.2]], "xatol": 1e-4, "fatol": 1e-4},
    )
    return turned(found.x)


def read_limb(path: Path, factor: float) -> Mesh:
    """The surface of a limb [mm], outward.

    Args:
        path: STL, PLY or OBJ file; a closed body or an open tube.
        factor: Millimetres per unit.

    Raises:
        InputError: The file is missing or no mesh.
        GeometryError: The surface is not manifold.
    """
    points, triangles = load_triangles(path)
    triangles = distinct(triangles)
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, times = np.unique(edges, axis=0, return_counts=True)
    if times.max() > 2:
        place = ", ".join(f"{x:.4g}" for x in points[unique[times > 2][0]].mean(axis=0))
        raise GeometryError(
            f"{int((times > 2).sum())} edges of the limb have more than two triangles, one near ({place})",
            where=str(path),
            hint="repair the limb in a mesh editor",
        )
    turned = np.asarray(igl.bfs_orient(np.ascontiguousarray(triangles))[0]).astype(np.int64)
    return Mesh(points * factor, turned)


@dataclass(frozen=True)
class Span:
    """Where a sleeve begins and ends along its axis.

    Attributes:
        centre: A point of the axis [mm].
        axes: Two unit directions across it, and itself.
        low: Height of the lower edge [mm], from the centre.
        high: Heights of the upper edge, evenly spaced around [mm].
    """

    centre: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    low: float
    high: Float[Array, " bin"]

    def local(self, points: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """Coordinates of points across and along the axis [mm]."""
        return (points - self.centre) @ self.axes.T

    def upper(self, local: Float[Array, "point any"]) -> Float[Array, " point"]:
        """Height of the upper edge at the angles of points [mm]."""
        count = len(self.high)
        turn = np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) * count % count
        return np.interp(turn, np.arange(count + 1), np.append(self.high, self.high[0]))


def span_of(brace: Mesh, up: Float[Array, "3"]) -> Span:
    """Where a sleeve begins and ends.

    The upper edge is that of the outer face or that of the inner one, whichever is lower: there the gutter
    opens onto the whole rim, also onto one that waves or leans. Notches in the rim are passed over.

    Args:
        brace: The sleeve [mm].
        up: Unit axis.
    """
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(up, first), up])
    centre = surface_centre(brace)
    local = (brace.vertices - centre) @ axes.T
    near = local[brace.triangles][..., 2].max(axis=1) > local[:, 2].max() - _RIM_MM
    used, triangles = np.unique(brace.triangles[near], return_inverse=True)
    rim, _, _ = refined(local[used], local[used], triangles.reshape(-1, 3), _BIN_MM / 2)
    radius = np.linalg.norm(rim[:, :2], axis=1)
    count = int(np.ceil(2 * np.pi * np.median(radius) / _BIN_MM))
    place = np.floor(np.arctan2(rim[:, 1], rim[:, 0]) / (2 * np.pi) * count + 0.5).astype(int) % count
    crest = _most(place, rim[:, 2], count)
    tops = rim[:, 2] > crest[place] - _CREST_MM
    middle = (_most(place[tops], radius[tops], count) - _most(place[tops], -radius[tops], count)) / 2
    inside = radius < middle[place]
    both = [_most(place[side], rim[side, 2], count) for side in (inside, ~inside)]
    lower = np.minimum(*both)
    around = np.stack([np.roll(lower, k) for k in range(-_NOTCH, _NOTCH + 1)]).max(axis=0)
    high = np.where(lower > around - _CREST_MM, lower, around)
    return Span(centre, axes, float(local[:, 2].min()), high - OPEN_MM)


def _most(place: Int[Array, " point"], value: Float[Array, " point"], count: int) -> Float[Array, " bin"]:
    out = np.full(count, -np.inf)
    np.maximum.at(out, place, value)
    return out


def cut_tube(limb: Mesh, span: Span, where: str) -> tuple[Mesh, list[str]]:
    """The part of a limb between a sleeve's edges, a tube, outward.

    Args:
        limb: The limb [mm].
        span: Where the sleeve begins and ends.
        where: The limb's file.

    Raises:
        GeometryError: The limb does not go through the brace, or is no tube there.
    """
    long, short = _prolonged(limb, span, where)
    local = span.local(long.vertices)
    points, triangles = cut_by_levels(long.vertices, long.triangles, local[:, 2] - span.upper(local), _SNAP)
    points, triangles = cut_by_plane(
        points, triangles, -span.axes[2], -span.low - float(span.centre @ span.axes[2]), _SNAP_MM
    )
    piece = _largest(Mesh(points, triangles))
    _check_tube(piece, where)
    p = span.local(piece.vertices)[piece.triangles]
    normal, middle = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), p.mean(axis=1)
    outward = np.einsum("tx,tx->", normal[:, :2], middle[:, :2]) > 0
    piece = piece if outward else Mesh(piece.vertices, piece.triangles[:, ::-1].copy())
    said = [f"the limb ends up to {short:.1f} mm before its brace and was prolonged"] if short > 0.5 else []
    return piece, said


def _prolonged(limb: Mesh, span: Span, where: str) -> tuple[Mesh, float]:
    """A limb whose open ends go on along the axis, and how far it ended before its brace [mm]."""
    up, shift, short = span.axes[2], float(span.centre @ span.axes[2]), 0.0
    points, triangles = limb.vertices, limb.triangles
    middle = (span.low + span.high.mean()) / 2
    for numbers in igl.boundary_loop_all(np.ascontiguousarray(limb.triangles)):
        local = span.local(limb.vertices[np.array(numbers)])
        if _turns(local) != 1:
            continue
        above = local[:, 2].mean() > middle
        gap = (span.upper(local) - local[:, 2]).max() if above else (local[:, 2] - span.low).max()
        if gap <= -_BACK_MM:
            continue
        short = max(short, float(gap))
        if short > SHORT_MM:
            raise GeometryError(
                f"the limb ends {short:.0f} mm before its brace does",
                where=where,
                hint="give a limb that reaches beyond the brace, in the brace's unit and place",
            )
        # a scan ends raggedly: it is cut straight first
        level = float(local[:, 2].min() if above else local[:, 2].max()) + shift
        way, offset = (up, level - _BACK_MM) if above else (-up, -level - _BACK_MM)
        points, triangles = _largest(Mesh(*cut_by_plane(points, triangles, way, offset, _SNAP_MM)))
        points, triangles = _ruled(Mesh(points, triangles), way, offset)
    return Mesh(points, triangles), short


def _turns(loop: Float[Array, "corner 3"]) -> int:
    """How often a closed line goes around the axis, either way."""
    turn = np.arctan2(loop[:, 1], loop[:, 0])
    step = (np.diff(turn, append=turn[:1]) + np.pi) % (2 * np.pi) - np.pi
    return abs(round(float(step.sum() / (2 * np.pi))))


def _ruled(limb: Mesh, way: Float[Array, "3"], offset: float) -> Mesh:
    """A limb that goes on straight beyond its end in a plane across the way."""
    edges = open_edges(limb.triangles)
    end = np.abs(limb.vertices[edges] @ way - offset).max(axis=1) < _SNAP_MM
    tail, head = edges[end].T
    rim, number = np.unique(np.concatenate([tail, head]), return_inverse=True)
    far_tail, far_head = len(limb.vertices) + number.reshape(2, -1)
    sides = np.concatenate(
        [np.stack([head, tail, far_tail], axis=1), np.stack([head, far_tail, far_head], axis=1)]
    )
    points = np.concatenate([limb.vertices, limb.vertices[rim] + (SHORT_MM + _LONGER_MM) * way])
    return Mesh(points, np.concatenate([limb.triangles, sides]))


def tube_ends(tube: Mesh, up: Float[Array, "3"]) -> tuple[Int[Array, " low"], Int[Array, " up"]]:
    """Vertices around the lower and the upper end of a tube, in order, tube on the left."""
    rim = rim_of(tube.triangles)
    start = int(rim.vertices[0])
    first = rim.walk(start, start)[:-1]
    start = int(np.setdiff1d(rim.vertices, first)[0])
    second = rim.walk(start, start)[:-1]
    heights = [float((tube.vertices[loop] @ up).mean()) for loop in (first, second)]
    return (first, second) if heights[0] < heights[1] else (second, first)


def _largest(mesh: Mesh) -> Mesh:
    """The largest connected part of a surface."""
    if not len(mesh.triangles):
        return mesh
    parts = parts_of(mesh.triangles)
    p = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    keep = np.zeros(len(area), dtype=bool)
    keep[parts[int(np.argmax([area[part].sum() for part in parts]))]] = True
    return Mesh(*compact(mesh.vertices, mesh.triangles, keep))


def _check_tube(piece: Mesh, where: str) -> None:
    loops = igl.boundary_loop_all(piece.triangles) if len(piece.triangles) else []
    if len(loops) == 2 and igl.euler_characteristic(piece.triangles) == 0:
        return
    what = f"a surface with {len(loops)} open ends" if len(loops) else "nothing"
    raise GeometryError(
        f"the limb is no tube in its brace, but {what}",
        where=where,
        hint="give the limb in the brace's unit and place, without holes where the brace is",
    )


def guessed_limb(brace: Mesh, span: Span, resolution_mm: float, where: str) -> Mesh:
    """A tube along the brace's inner face, stretched over its windows like a skin.

    Args:
        brace: The brace [mm].
        span: Where it begins and ends.
        resolution_mm: Spacing of what is looked at.
        where: The brace's file.

    Raises:
        GeometryError: Seen from its axis the brace hides parts of its own inner face.
    """
    step = _GRID * resolution_mm
    local = span.local(brace.vertices)
    p = local[brace.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    middle = p.mean(axis=1)
    radial = middle[:, :2] / np.linalg.norm(middle[:, :2], axis=1, keepdims=True)
    inner = np.einsum("tx,tx->t", normal[:, :2], radial) < -_FACING
    used, triangles = np.unique(brace.triangles[inner], return_inverse=True)
    samples, _, _ = refined(local[used], local[used], triangles.reshape(-1, 3), step)
    around = int(np.ceil(2 * np.pi * np.median(np.linalg.norm(samples[:, :2], axis=1)) / step))
    along = max(2, int(np.ceil((span.high.max() - span.low) / step)))
    turn = np.arange(around) / around * 2 * np.pi
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    top = span.upper(circle)
    part = (samples[:, 2] - span.low) / (span.upper(samples) - span.low)
    radius = _stretched(samples, part, around, along, where)
    height = span.low + np.arange(along + 1) / along * (top - span.low)[:, None]
    grid = np.concatenate([radius[..., None] * circle[:, None], height[..., None]], axis=-1)
    i, j = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    right = (i + 1) % around
    a, b, c, d = (k * (along + 1) + m for k, m in ((i, j), (right, j), (right, j + 1), (i, j + 1)))
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    return Mesh(grid.reshape(-1, 3) @ span.axes + span.centre, triangles)


def _stretched(
    samples: Float[Array, "sample 3"], part: Float[Array, " sample"], around: int, along: int, where: str
) -> Float[Array, "around row"]:
    """Radius of a skin over samples of the inner face, by angle and part of the height."""
    radius = np.linalg.norm(samples[:, :2], axis=1)
    i = np.round(np.arctan2(samples[:, 1], samples[:, 0]) / (2 * np.pi) * around).astype(int) % around
    j = np.clip(np.round(part * along).astype(int), 0, along)
    cell, size = i * (along + 1) + j, around * (along + 1)
    count, total = np.bincount(cell, minlength=size), np.bincount(cell, radius, minlength=size)
    least, most = np.full(size, np.inf), np.zeros(size)
    np.minimum.at(least, cell, radius)
    np.maximum.at(most, cell, radius)
    known = count > 0
    folded = known & (most > 1.3 * least)
    if folded.mean() > 0.01 or known.mean() < 0.05:
        raise GeometryError(
            "the limb cannot be guessed from the brace: its inner face is no simple tube around a line",
            where=where,
            hint="give the limb with --limb",
        )
    step = np.arange(size).reshape(around, along + 1)
    pairs = np.concatenate(
        [
            np.stack([step, np.roll(step, -1, axis=0)], -1).reshape(-1, 2),
            np.stack([step[:, :-1], step[:, 1:]], -1).reshape(-1, 2),
        ]
    )
    both = np.concatenate([pairs, pairs[:, ::-1]])
    degree = np.bincount(both[:, 0], minlength=size)
    mean = csr_array((1.0 / degree[both[:, 0]], (both[:, 0], both[:, 1])), shape=(size, size))
    value = np.zeros(size)
    value[known] = total[known] / count[known]
    free = np.flatnonzero(~known)
    if len(free):
        rows = mean[free]
        matrix = eye_array(len(free)) - rows[:, free]
        value[free] = np.asarray(spsolve(matrix.tocsc(), rows @ value))
    for _ in range(_SMOOTHINGS):
        value = (value + mean @ value) / 2
    return value.reshape(around, along + 1)


def refined(
    points: Float[Array, "vertex 3"],
    vectors: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    length_mm: float,
) -> tuple[Float[Array, "new 3"], Float[Array, "new 3"], Int[Array, "piece 3"]]:
    """A mesh whose edges are halved until none is longer than wanted, and vectors linear on its triangles."""
    while True:
        edges, edge_of = mesh_edges(triangles)
        long = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) > length_mm
        if not long.any():
            return points, vectors, triangles
        new = np.full(len(edges), -1)
        new[long] = len(points) + np.arange(int(long.sum()))
        points, vectors = (
            np.concatenate([values, values[edges[long]].mean(axis=1)]) for values in (points, vectors)
        )
        triangles = _split(triangles, new[edge_of])


def _split(triangles: Int[Array, "triangle 3"], middles: Int[Array, "triangle 3"]) -> Int[Array, "piece 3"]:
    """Pieces of triangles with new points on some of their edges (-1 where there is none)."""
    count = (middles >= 0).sum(axis=1)
    pieces = [triangles[count == 0]]
    for times in (1, 2, 3):
        own, point = triangles[count == times], middles[count == times]
        lone = np.argmax(point >= 0, axis=1) if times == 1 else np.argmin(point >= 0, axis=1)
        turn = (lone[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(own, turn, axis=1).T
        ab, bc, ca = np.take_along_axis(point, turn, axis=1).T
        if times == 1:
            parts = [(a, ab, c), (ab, b, c)]
        elif times == 2:
            parts = [(c, ca, bc), (a, b, bc), (a, bc, ca)]
        else:
            parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        pieces += [np.stack(part, axis=1) for part in parts]
    return np.concatenate(pieces)
