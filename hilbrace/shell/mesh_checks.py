"""What makes a triangle mesh a shell that can be computed; everything else is refused by name.

A shell is one piece of consistently oriented triangles, at most two on an edge, with two closed boundaries to
hold it by. Further boundaries are windows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from hilbrace.errors import GeometryError, SolverError

Array = np.ndarray

WORST_SHAPE = 1e-3
"""Least ratio of a triangle's area to that of the regular one with the same sum of squared sides."""


def check_surface(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    upper_loop: Int[Array, " upper"],
    lower_loop: Int[Array, " lower"],
) -> None:
    """Refuse a surface that is no shell between two closed loops.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices.
        upper_loop: Vertices of the upper (proximal) loop, in any order.
        lower_loop: Vertices of the lower (distal) loop, in any order.

    Raises:
        GeometryError: The triangles or loops are wrong; the first triangle, edge or vertex is named.
        SolverError: A vertex or a part of the surface is held by nothing.
    """
    edges = _checked_edges(vertices, triangles)
    for name, loop in (("upper", upper_loop), ("lower", lower_loop)):
        _check_indices(f"{name} loop entry", loop, len(vertices))
    _check_loops_apart(upper_loop, lower_loop)
    for name, loop in (("upper", upper_loop), ("lower", lower_loop)):
        _check_closed(name, loop, edges)


def check_sheet(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> None:
    """Refuse triangles that are not one sheet of one orientation, whatever its boundaries.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices.

    Raises:
        GeometryError: The first wrong triangle, edge or vertex is named.
        SolverError: A vertex or a part of the surface is held by nothing.
    """
    _checked_edges(vertices, triangles)


def check_shape(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> None:
    """Refuse positions that are not finite, and triangles without area or as thin as needles.

    Args:
        vertices: Positions [mm], of the rest or of a posed shape.
        triangles: Vertex indices.

    Raises:
        GeometryError: The first such vertex or triangle is named.
    """
    lost = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if lost.size:
        raise GeometryError(
            f"{lost.size} vertices have no finite position",
            where=f"vertex {lost[0]} of the shell",
            hint="check the frame of the motion that posed the surface",
        )
    sides = np.roll(vertices[triangles], -1, axis=1) - vertices[triangles]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    regular = (sides**2).sum(axis=(1, 2)) / (4.0 * np.sqrt(3.0))
    thin = np.flatnonzero(~(area > WORST_SHAPE * regular))
    if thin.size:
        raise GeometryError(
            f"{thin.size} triangles have no area, or are as thin as needles",
            where=f"triangle {thin[0]} of the shell",
            hint="remesh the surface, or weld its doubled vertices",
        )


def check_thickness(thickness: Float[Array, " triangle"]) -> None:
    """Refuse a thickness [mm] that is not positive and finite.

    Raises:
        GeometryError: The first such triangle is named.
    """
    wrong = np.flatnonzero(~((thickness > 0) & np.isfinite(thickness)))
    if wrong.size:
        raise GeometryError(
            f"the thicknesses of {wrong.size} triangles make no shell",
            where=f"triangle {wrong[0]}, thickness {thickness[wrong[0]]:g} mm",
            hint="give every triangle a finite thickness above 0",
        )


@dataclass(frozen=True)
class _Edges:
    """Edges of a mesh. Side 3 t + k of the triangles runs from corner k of triangle t to the next one."""

    ends: Int[Array, "edge 2"]
    """Vertices, the lower index first."""
    of_side: Int[Array, " side"]
    rising: Bool[Array, " side"]
    """The side runs from the lower to the higher index."""
    sides: Int[Array, " edge"]
    """Sides on each edge: 1 on a boundary, 2 inside."""


def _edges(triangles: Int[Array, "triangle 3"], vertices: int) -> _Edges:
    start, end = triangles.ravel().astype(np.int64), np.roll(triangles, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    keys, of_side, sides = np.unique(low * vertices + high, return_inverse=True, return_counts=True)
    return _Edges(np.stack(np.divmod(keys, vertices), axis=1), of_side, start < end, sides)


def _checked_edges(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> _Edges:
    """Edges of triangles that are one sheet of one orientation."""
    _check_arrays(vertices, triangles)
    _check_indices("triangle", triangles, len(vertices))
    _check_repeats(triangles)
    check_shape(vertices, triangles)
    edges = _edges(triangles, len(vertices))
    _check_manifold(edges)
    _check_one_piece(vertices, triangles, edges)
    _check_orientation(edges)
    return edges


def _check_arrays(vertices: Array, triangles: Array) -> None:
    columns = (vertices.ndim, triangles.ndim, *vertices.shape[1:], *triangles.shape[1:])
    if columns != (2, 2, 3, 3) or not len(triangles) or not np.issubdtype(triangles.dtype, np.integer):
        raise GeometryError(
            f"vertices of shape {vertices.shape} and triangles of shape {triangles.shape}, {triangles.dtype}",
            where="mesh of the shell",
            hint="give three coordinates per vertex, and three whole vertex numbers per triangle",
        )


def _check_indices(name: str, indices: Array, vertices: int) -> None:
    outside = (indices < 0) | (indices >= vertices)
    if outside.any():
        entry = np.argwhere(outside)[0]
        raise GeometryError(
            f"{int(outside.sum())} indices lead to no vertex; there are {vertices}",
            where=f"{name} {entry[0]}: vertex {indices[tuple(entry)]}",
            hint="count vertices from 0, and keep triangles and vertices of one mesh together",
        )


def _check_repeats(triangles: Int[Array, "triangle 3"]) -> None:
    corners = np.sort(triangles, axis=1)
    collapsed = np.flatnonzero((corners[:, 1:] == corners[:, :-1]).any(axis=1))
    if collapsed.size:
        raise GeometryError(
            f"{collapsed.size} triangles have no area: a vertex stands in them twice",
            where=f"triangle {collapsed[0]} of the shell",
            hint="drop collapsed triangles from the surface",
        )
    _, first, which = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    doubled = np.flatnonzero(first[which.ravel()] != np.arange(len(triangles)))
    if doubled.size:
        raise GeometryError(
            f"{doubled.size} triangles stand in the surface twice",
            where=f"triangle {doubled[0]} repeats triangle {first[which.ravel()[doubled[0]]]}",
            hint="drop doubled triangles from the surface",
        )


def _check_loops_apart(upper_loop: Int[Array, " upper"], lower_loop: Int[Array, " lower"]) -> None:
    for name, loop in (("upper", upper_loop), ("lower", lower_loop)):
        different = len(np.unique(loop))
        if different < 3 or different != len(loop):
            raise GeometryError(
                f"the {name} loop is no loop: {len(loop)} vertices, {different} of them different",
                where="domain",
                hint="a loop needs three vertices or more, each once",
            )
    shared = np.intersect1d(upper_loop, lower_loop)
    if shared.size:
        raise GeometryError(
            f"{shared.size} vertices lie on both loops",
            where=f"vertex {shared[0]} of the domain",
            hint="move the edges of the region apart",
        )


def _check_manifold(edges: _Edges) -> None:
    crowded = np.flatnonzero(edges.sides > 2)
    if crowded.size:
        edge = crowded[0]
        on_it = np.flatnonzero(edges.of_side == edge) // 3
        low, high = edges.ends[edge]
        raise GeometryError(
            f"{crowded.size} edges carry three triangles or more",
            where=f"edge from vertex {low} to {high}, triangles {', '.join(map(str, on_it))}",
            hint="a shell has one sheet: remove fins and inner walls from the surface",
        )


def _check_one_piece(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], edges: _Edges
) -> None:
    loose = np.setdiff1d(np.arange(len(vertices)), triangles)
    if loose.size:
        raise SolverError(
            f"{loose.size} vertices belong to no triangle, so nothing holds them",
            where=f"vertex {loose[0]} of the shell",
            hint="drop unused vertices from the surface",
        )
    owner = np.arange(3 * len(triangles)) // 3
    incidence = sp.csr_array(
        (np.ones(len(owner)), (owner, edges.of_side)), shape=(len(triangles), len(edges.ends))
    )
    pieces, piece = connected_components(incidence @ incidence.T, directed=False)
    if pieces > 1:
        apart = np.flatnonzero(piece != np.bincount(piece).argmax())
        doubled = len(vertices) - len(np.unique(vertices, axis=0))
        raise SolverError(
            f"the surface falls into {pieces} pieces; {apart.size} triangles share no edge with the main one",
            where=f"triangle {apart[0]} of the shell",
            hint=f"weld the {doubled} vertices that lie on another one, as trimesh's merge_vertices does"
            if doubled
            else "keep the one part of the surface that joins both loops, without flaps on single vertices",
        )


def _check_orientation(edges: _Edges) -> None:
    rising = np.bincount(edges.of_side, edges.rising, minlength=len(edges.ends))
    against = (edges.sides == 2) & (rising != 1)
    if against.any():
        wrong = against[edges.of_side].reshape(-1, 3).sum(axis=1)
        worst = int(wrong.argmax())
        edge = edges.of_side[3 * worst + int(against[edges.of_side].reshape(-1, 3)[worst].argmax())]
        neighbour = next(
            int(side) // 3 for side in np.flatnonzero(edges.of_side == edge) if side // 3 != worst
        )
        raise GeometryError(
            f"{int(against.sum())} edges are run through the same way by both of their triangles",
            where=f"triangle {worst} against its neighbour {neighbour}",
            hint="turn inverted triangles over, so that all of them face outwards",
        )


def _check_closed(name: str, loop: Int[Array, " loop"], edges: _Edges) -> None:
    """The loop's vertices must be all vertices of one boundary."""
    on_loop = np.isin(edges.ends, loop).all(axis=1) & (edges.sides == 1)
    steps = edges.ends[on_loop]
    degree = np.bincount(steps.ravel(), minlength=int(loop.max()) + 1)[loop]
    open_at = np.flatnonzero(degree != 2)
    if open_at.size:
        ends = "no" if degree[open_at[0]] == 0 else str(degree[open_at[0]])
        raise GeometryError(
            f"the {name} loop is not closed: {open_at.size} of its vertices do not have two neighbours on it"
            " along the boundary",
            where=f"vertex {loop[open_at[0]]} of the shell, {ends} boundary edges of the loop",
            hint="give all vertices of one boundary, and weld the seam of a cut surface",
        )
    size = int(edges.ends.max()) + 1
    graph = sp.csr_array((np.ones(len(steps)), (steps[:, 0], steps[:, 1])), shape=(size, size))
    _, chain = connected_components(graph, directed=False)
    apart = np.flatnonzero(chain[loop] != chain[loop[0]])
    if apart.size:
        raise GeometryError(
            f"the {name} loop runs along more than one boundary",
            where=f"vertex {loop[apart[0]]} lies on another boundary than vertex {loop[0]}",
            hint="leave windows free: a loop is one edge of the brace",
        )
