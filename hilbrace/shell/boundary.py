"""The open edges of a brace mesh, and which two of them go around the limb."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError

Array = np.ndarray

_CLEAR = 1.25
"""Least ratio between the area that an end of the brace encloses and that of the largest window [-]."""

_NAME_THEM = "name the vertices of both ends by the argument loops; boundary_loops gives all open edges"


def boundary_loops(triangles: Int[Array, "triangle 3"]) -> list[Int[Array, " loop"]]:
    """Closed loops of open edges, each in the order and direction of its triangles' edges.

    Loops come in the order of their smallest vertices, and start there.

    Args:
        triangles: Vertex indices, one orientation throughout.

    Raises:
        GeometryError: Open edges meet at a vertex in more than one loop, or do not close.
    """
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    size = int(triangles.max()) + 1
    forward, backward = start.astype(np.int64) * size + end, end.astype(np.int64) * size + start
    is_open = ~np.isin(forward, backward)
    following = dict(zip(start[is_open].tolist(), end[is_open].tolist(), strict=True))
    if len(following) != is_open.sum() or set(following) != set(following.values()):
        counts = np.bincount(start[is_open], minlength=size) + np.bincount(end[is_open], minlength=size)
        raise GeometryError(
            "the open edges of the mesh do not form separate closed loops",
            where=f"vertex {np.flatnonzero((counts != 0) & (counts != 2))[0]}",
            hint="orient all triangles alike, and part edges that touch in a single vertex",
        )
    loops = []
    while following:
        loop = [min(following)]
        while (step := following.pop(loop[-1])) != loop[0]:
            loop.append(step)
        loops.append(np.array(loop))
    return loops


def enclosed_area(vertices: Float[Array, "vertex 3"], loop: Int[Array, " loop"]) -> Float[Array, " xyz"]:
    """Vector area of a closed loop [mm^2]: along its mean normal, as large as what it encloses."""
    corners = vertices[loop] - vertices[loop].mean(axis=0)
    return 0.5 * np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)


def end_loops(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    axis: Float[Array, " xyz"],
) -> tuple[Int[Array, " upper"], Int[Array, " lower"]]:
    """The two loops of a brace that go around the limb; windows are passed over.

    An end encloses the limb and a window only a patch of its skin, so that the two loops of the largest
    vector area are the ends, and windows lie between them. Where this does not hold, as with a window wider
    than a slim end, nothing is guessed.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices, one orientation throughout.
        axis: Direction of the limb, towards its upper (proximal) end.

    Returns:
        The upper and the lower loop.

    Raises:
        GeometryError: There are fewer than two loops, or a window is as large as an end or lies beyond one.
    """
    loops = boundary_loops(triangles)
    if len(loops) < 2:
        raise GeometryError(
            f"the mesh has {len(loops)} open loops",
            where="brace mesh",
            hint="give the mesh of an open sleeve: its surface, not the closed solid made from it",
        )
    areas = np.array([np.linalg.norm(enclosed_area(vertices, loop)) for loop in loops])
    order = np.argsort(-areas, kind="stable")
    if len(loops) > 2 and not areas[order[1]] > _CLEAR * areas[order[2]]:
        raise GeometryError(
            "a window of the mesh is as large as an end, so that the ends cannot be told",
            where=f"loops of {areas[order[1]]:.0f} and {areas[order[2]]:.0f} mm^2",
            hint=_NAME_THEM,
        )
    centres = np.stack([vertices[loop].mean(axis=0) for loop in loops])
    between = centres[order[0]] - centres[order[1]]
    height = centres @ between
    beyond = np.flatnonzero((height > height[order[0]]) | (height < height[order[1]]))
    if beyond.size:
        raise GeometryError(
            "the largest open edges of the mesh are not its outermost ones, so that the ends cannot be told",
            where=f"loop of {len(loops[beyond[0]])} edges at vertex {loops[beyond[0]][0]}",
            hint=_NAME_THEM,
        )
    first, second = (loops[k] for k in order[:2])
    higher = between @ axis > 0
    return (first, second) if higher else (second, first)
