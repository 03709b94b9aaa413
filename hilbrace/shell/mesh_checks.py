"""What makes a triangle mesh a shell that can be computed; everything else is refused by name."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from hilbrace.errors import GeometryError, SolverError

Array = np.ndarray


def check_numbers(vertices: Float[Array, "vertex 3"], thickness_mm: float, poisson: float) -> None:
    """Refuse a thickness [mm], Poisson's ratio or vertex position [mm] that makes no shell.

    Raises:
        GeometryError: A number is out of its range; the vertex or the setting is named.
    """
    if not (thickness_mm > 0 and 0 <= poisson < 0.5):
        raise GeometryError(
            f"thickness {thickness_mm:g} mm and Poisson's ratio {poisson:g} make no shell",
            where="material.thickness_mm, material.poisson",
            hint="the thickness must be above 0, the ratio from 0 to below 0.5",
        )
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if bad.size:
        raise GeometryError(
            f"{bad.size} vertices have no finite position",
            where=f"vertex {bad[0]} of the shell",
            hint="check the frame of the motion that posed the surface",
        )


def check_loops(upper_loop: Int[Array, " upper"], lower_loop: Int[Array, " lower"]) -> None:
    """Refuse loops that are too short, repeat a vertex or share one.

    Raises:
        GeometryError: The loop is named.
    """
    for name, loop in (("upper", upper_loop), ("lower", lower_loop)):
        if len(np.unique(loop)) < 3 or len(np.unique(loop)) != len(loop):
            raise GeometryError(
                f"the {name} loop is no loop: {len(loop)} vertices, {len(np.unique(loop))} of them different",
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


def check_supported(
    vertices: int,
    triangles: Int[Array, "triangle 3"],
    upper_loop: Int[Array, " upper"],
    lower_loop: Int[Array, " lower"],
) -> None:
    """Refuse vertices and parts of the surface that no edge of a loop holds.

    Raises:
        SolverError: The vertex or triangle is named.
    """
    loose = np.setdiff1d(np.arange(vertices), triangles)
    if loose.size:
        raise SolverError(
            f"{loose.size} vertices belong to no triangle, so nothing holds them",
            where=f"vertex {loose[0]} of the shell",
            hint="drop unused vertices from the surface",
        )
    part = _parts(triangles, vertices)
    on_loop = np.isin(triangles, np.concatenate([upper_loop, lower_loop]))
    part_and_vertex = np.stack([np.broadcast_to(part[:, None], triangles.shape), triangles], axis=-1)
    supports = np.unique(part_and_vertex[on_loop], axis=0)[:, 0]
    held = np.flatnonzero(np.bincount(supports, minlength=part.max() + 1) >= 2)
    floating = np.flatnonzero(~np.isin(part, held))
    if floating.size:
        raise SolverError(
            f"{floating.size} triangles are held by no edge of a loop",
            where=f"triangle {floating[0]} of the shell",
            hint="keep the one part of the surface that joins both loops, without flaps on single vertices",
        )


def _parts(triangles: Int[Array, "triangle 3"], vertices: int) -> Int[Array, " triangle"]:
    """Number of the part that each triangle belongs to; triangles hang together by shared edges."""
    start, end = triangles.ravel().astype(np.int64), np.roll(triangles, -1, axis=1).ravel()
    key = np.minimum(start, end) * vertices + np.maximum(start, end)
    edges, edge = np.unique(key, return_inverse=True)
    owner = np.repeat(np.arange(len(triangles)), 3)
    shape = (len(triangles), len(edges))
    incidence = sp.csr_array((np.ones(len(owner)), (owner, edge)), shape=shape)
    _, part = connected_components(incidence @ incidence.T, directed=False)
    return part
