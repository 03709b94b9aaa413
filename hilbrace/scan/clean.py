"""A mesh fit for use: its largest piece, and what is open in it."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from hilbrace.errors import GeometryError

Array = np.ndarray

END = 0.08
"""Part of the height at either end in which a border counts as the end of the scan [-]."""


@dataclass(frozen=True)
class Hole:
    """A border of the mesh.

    Attributes:
        middle: Its middle [mm].
        length_mm: Its length [mm].
        across_mm: Its largest extent [mm].
    """

    middle: tuple[float, float, float]
    length_mm: float
    across_mm: float


@dataclass(frozen=True)
class CleanMesh:
    """The largest piece of a surface.

    Attributes:
        vertices: Positions [mm].
        triangles: Vertex indices, outward.
        holes: Its borders, the longest first.
        pieces_dropped: Smaller pieces that were left out.
        area_dropped: Their part of the whole area [-].
        second_middle: Middle of the largest of them [mm]; none without one.
        second_part: Its area against that of the piece that stays [-].
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    holes: tuple[Hole, ...]
    pieces_dropped: int
    area_dropped: float
    second_middle: tuple[float, float, float] | None
    second_part: float


def clean_mesh(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], where: str
) -> CleanMesh:
    """The largest piece of a mesh, manifold, without unused vertices.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices.
        where: Its name, for errors.

    Raises:
        GeometryError: There are no triangles.
    """
    vertices, joined = np.unique(vertices, axis=0, return_inverse=True)
    triangles = joined.reshape(-1)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    if not len(triangles):
        raise GeometryError("the surface is empty", where=where, hint="look at the pictures of the views")
    area = _areas(vertices, triangles)
    label = _pieces(triangles)
    sizes = np.bincount(label, area)
    largest = label == int(sizes.argmax())
    second = label == int(np.argsort(sizes)[-2]) if len(sizes) > 1 else None
    x, y, z = (0.0, 0.0, 0.0) if second is None else vertices[triangles[second]].mean(axis=(0, 1))
    own = _without_pinches(triangles[largest])
    label = _pieces(own)
    own = own[label == int(np.bincount(label, _areas(vertices, own)).argmax())]
    used, flat = np.unique(own, return_inverse=True)
    vertices, own = np.ascontiguousarray(vertices[used]), np.ascontiguousarray(flat.reshape(-1, 3))
    return CleanMesh(
        vertices,
        own,
        _holes(vertices, own),
        len(sizes) - 1,
        float(1.0 - _areas(vertices, own).sum() / max(area.sum(), 1e-12)),
        None if second is None else (float(x), float(y), float(z)),
        0.0 if second is None else float(np.sort(sizes)[-2] / sizes.max()),
    )


def inner_holes(mesh: CleanMesh) -> tuple[Hole, ...]:
    """Holes that are not the upper or lower end of the scan."""
    low, high = mesh.vertices[:, 1].min(), mesh.vertices[:, 1].max()
    margin = END * (high - low)
    return tuple(hole for hole in mesh.holes if low + margin < hole.middle[1] < high - margin)


def _areas(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, " triangle"]:
    corner = vertices[triangles]
    return 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)


def _pieces(triangles: Int[Array, "triangle 3"]) -> Int[Array, " triangle"]:
    """Number of the piece of each triangle; pieces that touch in a vertex only are two."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, number = np.unique(edges, axis=0, return_inverse=True)
    number = number.reshape(-1)
    triangle = np.repeat(np.arange(len(triangles)), 3)
    order = np.argsort(number, kind="stable")
    same = np.flatnonzero(number[order][1:] == number[order][:-1])
    one, other = triangle[order][same], triangle[order][same + 1]
    count = len(triangles)
    links = sparse.coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)


def _without_pinches(triangles: Int[Array, "triangle 3"]) -> Int[Array, "triangle 3"]:
    """The triangles without those at vertices where two sheets touch in a point, and at edges of three."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    good = (count[number.reshape(-1)] <= 2).reshape(-1, 3).all(axis=1)
    triangles = triangles[good]
    while True:
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, count = np.unique(edges, axis=0, return_counts=True)
        borders = np.bincount(unique[count == 1].ravel(), minlength=int(triangles.max(initial=0)) + 1)
        pinched = borders > 2
        if not pinched.any():
            return triangles
        triangles = triangles[~pinched[triangles].any(axis=1)]


def _holes(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> tuple[Hole, ...]:
    holes = []
    for loop in igl.boundary_loop_all(triangles):
        ring = vertices[loop]
        after = np.roll(ring, -1, axis=0)
        lengths = np.linalg.norm(after - ring, axis=1)
        length = float(lengths.sum())
        x, y, z = (float(value) for value in np.average(0.5 * (ring + after), axis=0, weights=lengths))
        holes.append(Hole((x, y, z), length, float(np.ptp(ring, axis=0).max())))
    return tuple(sorted(holes, key=lambda hole: -hole.length_mm))
