"""The limb that a brace from a file lies on, from a file of its own: read, and cut where the brace ends."""

from __future__ import annotations

from pathlib import Path

import igl
import numpy as np
from jaxtyping import Float, Int

from fabrication.foreign_brace import Mesh, distinct, open_edges, parts_of
from fabrication.sheet import rim_of
from fabrication.sleeve_axis import Span
from hilbrace.body.mesh_file import load_triangles
from hilbrace.domain.isoline import compact, cut_by_levels, cut_by_plane
from hilbrace.errors import GeometryError

Array = np.ndarray

SHORT_MM = 15.0
"""How far a limb may end before its brace does; it is prolonged."""
_SNAP_MM = 0.02
_BACK_MM = 0.5
_LONGER_MM = 5.0
_SNAP = 0.2


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
