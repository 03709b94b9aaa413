"""Flat maps of the opened sleeve: conformal with a free seam or a periodic one, or length-keeping.

The conformal energy is that of Levy, Petitjean, Ray and Maillot (2002): the area-weighted squares of
``u_x - v_y`` and ``u_y + v_x`` over the triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

from hilbrace.domain.deformation import local_edges
from hilbrace.domain.seam import Cut
from hilbrace.domain.slim import slim
from hilbrace.errors import GeometryError

Array = np.ndarray
Method = Literal["lscm", "periodic", "slim"]

_GRID = 2.0**40
"""Maps are rounded to this grid, so that differences across the seam are exact in floating point."""


@dataclass(frozen=True)
class FlatMap:
    """A flat map in [0, 1]^2, one scale for both axes.

    Seen from outside with the proximal end up, u grows to the right and v upwards.

    Attributes:
        uv: Coordinates of the cut vertices [-].
        period_u: What u grows by once around the limb [-]; 0 where the seam is free.
    """

    uv: Float[Array, "cut_vertex 2"]
    period_u: float


def flatten(vertices: Float[Array, "vertex 3"], cut: Cut, pins: tuple[int, int], method: Method) -> FlatMap:
    """Flat map of a sleeve, windows allowed.

    Args:
        vertices: Vertices of the closed sleeve [mm].
        cut: The sleeve opened along the seam.
        pins: Cut vertices at the lower and upper loop, opposite the seam.
        method: ``lscm`` keeps angles and leaves the seam free (the paper's map), ``periodic`` keeps angles
            and closes at the seam, ``slim`` starts from the first and keeps lengths.

    Raises:
        GeometryError: The map turns triangles over.
    """
    if method == "periodic":
        flat = periodic_lscm(vertices, cut)
    else:
        flat = lscm(vertices, cut, pins)
    check_flips(vertices[cut.weld], flat.uv, cut.triangles)
    if method == "slim":
        flat = _normalise(slim(vertices[cut.weld], cut.triangles, flat.uv), cut, 0.0)
        check_flips(vertices[cut.weld], flat.uv, cut.triangles)
    return flat


def lscm(vertices: Float[Array, "vertex 3"], cut: Cut, pins: tuple[int, int]) -> FlatMap:
    """Least-squares conformal map of the opened sleeve; both seam edges are free.

    Args:
        vertices: Vertices of the closed sleeve [mm].
        cut: The sleeve opened along the seam.
        pins: Cut vertices at the lower and upper loop, opposite the seam: held at (0, 0) and (0, 1).
    """
    count = len(cut.weld)
    energy = conformal_energy(vertices[cut.weld], cut.triangles)
    held = np.array([pins[0], pins[1], count + pins[0], count + pins[1]])
    start = np.zeros(2 * count)
    start[count + pins[1]] = 1.0
    solution = _least(energy, energy @ start, held) + start
    return _normalise(solution.reshape(2, count).T, cut, 0.0)


def periodic_lscm(vertices: Float[Array, "vertex 3"], cut: Cut) -> FlatMap:
    """Least-squares conformal map of the closed sleeve onto a flat cylinder.

    The unknowns live on the closed sleeve; u jumps by one period across the seam and by nothing
    elsewhere, so that the pattern drawn on the map closes exactly.

    Args:
        vertices: Vertices of the closed sleeve [mm].
        cut: The sleeve opened along the seam.
    """
    closed, count = len(vertices), len(cut.weld)
    energy = conformal_energy(vertices[cut.weld], cut.triangles)
    weld = sp.csr_array((np.ones(count), (np.arange(count), cut.weld)), shape=(count, closed))
    both = sp.block_diag([weld, weld], format="csr")
    jump = np.zeros(2 * count)
    jump[cut.pairs[:, 1]] = 1.0
    pinned = cut.weld[cut.pairs[0, 0]]
    solution = _least(energy @ both, energy @ jump, np.array([pinned, closed + pinned]))
    return _normalise((both @ solution + jump).reshape(2, count).T, cut, 1.0)


def conformal_energy(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> sp.csr_array:
    """Matrix A whose ``|A [u; v]|^2`` is the conformal energy of a flat map."""
    edges = local_edges(vertices, triangles)
    weight = np.sqrt(np.linalg.det(edges) / 2.0)[:, None]
    hats = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]]) @ np.linalg.inv(edges)
    dx, dy = (weight * hats[..., 0]).ravel(), (weight * hats[..., 1]).ravel()
    rows = np.repeat(np.arange(len(triangles)), 3)
    columns = triangles.ravel()
    shape = (len(triangles), len(vertices))
    ddx = sp.csr_array((dx, (rows, columns)), shape=shape)
    ddy = sp.csr_array((dy, (rows, columns)), shape=shape)
    return sp.csr_array(sp.block_array([[ddx, -ddy], [ddy, ddx]]))


def map_gradients(
    vertices: Float[Array, "vertex 3"],
    uv: Float[Array, "vertex 2"],
    triangles: Int[Array, "triangle 3"],
) -> Float[Array, "triangle 2 2"]:
    """Gradient of a flat map in each triangle, from the triangle's own axes to (u, v)."""
    corner = uv[triangles]
    flat = np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], axis=-1)
    return flat @ np.linalg.inv(local_edges(vertices, triangles))


def quasi_conformal(
    vertices: Float[Array, "vertex 3"],
    uv: Float[Array, "vertex 2"],
    triangles: Int[Array, "triangle 3"],
) -> Float[Array, " triangle"]:
    """Ratio of the singular values of a flat map per triangle [-]; 1 keeps all angles."""
    values = np.linalg.svd(map_gradients(vertices, uv, triangles), compute_uv=False)
    return values[:, 0] / values[:, 1]


def check_flips(
    vertices: Float[Array, "vertex 3"],
    uv: Float[Array, "vertex 2"],
    triangles: Int[Array, "triangle 3"],
) -> None:
    """Refuse a flat map that turns triangles over.

    Raises:
        GeometryError: Says how many triangles are turned over.
    """
    flipped = int((np.linalg.det(map_gradients(vertices, uv, triangles)) <= 0.0).sum())
    if flipped:
        raise GeometryError(
            f"the flat map turns {flipped} triangles over",
            where="domain.flatten",
            hint="take a shorter region, more triangles, or another map ('lscm', 'periodic' or 'slim')",
        )


def _least(
    matrix: sp.csr_array, offset: Float[Array, " row"], held: Int[Array, " held"]
) -> Float[Array, " column"]:
    """Minimiser x of ``|matrix x + offset|^2`` whose held entries are zero."""
    normal = sp.csc_matrix(matrix.T @ matrix)
    right = -(matrix.T @ offset)
    free = np.setdiff1d(np.arange(len(right)), held)
    factors = splu(normal[free][:, free].tocsc(), "MMD_AT_PLUS_A", options={"SymmetricMode": True})
    solution = np.zeros(len(right))
    solution[free] = factors.solve(right[free])
    return solution


def mirrored(flat: FlatMap) -> FlatMap:
    """The map of the mirrored sleeve: u runs the other way, so that it still grows to the right."""
    width = flat.uv[:, 0].max()
    return FlatMap(np.stack([width - flat.uv[:, 0], flat.uv[:, 1]], axis=1), flat.period_u)


def _normalise(uv: Float[Array, "cut_vertex 2"], cut: Cut, period: float) -> FlatMap:
    """Move and scale a map into [0, 1]^2; jumps across a periodic seam become exact."""
    scale = 1.0 / np.ptp(uv, axis=0).max()
    placed = np.floor((uv - uv.min(axis=0)) * scale * _GRID) / _GRID
    period_u = float(np.floor(period * scale * _GRID) / _GRID)
    if period_u:
        placed[cut.pairs[:, 1]] = placed[cut.pairs[:, 0]] + [period_u, 0.0]
    return FlatMap(placed, period_u)
