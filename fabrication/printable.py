"""Pieces as a printer gets them: standing on the bed, in single precision, and watertight in it.

Where two faces lie within a rounding error of each other, single precision presses vertices into one, and
whoever reads the file sees edges with four triangles. Such vertices are moved apart, two thousandths of a
millimetre into the piece. What is exported is checked after the rounding, on the numbers that a slicer reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int

from fabrication.bodies import mesh_of, vertex_normals
from fabrication.mold import Piece
from hilbrace.errors import GeometryError

Array = np.ndarray

SIMPLIFY_MM = 0.005
"""How far surfaces may move when needles are given up [mm]: a tenth of what printers can show."""

APART_MM = 2e-3
"""How far vertices that would become one are moved apart, into the piece [mm]."""

ROUNDS = 6
"""How often vertices are moved apart before a piece counts as beyond help."""


@dataclass(frozen=True)
class Printable:
    """A piece as it stands on the printer's bed.

    Attributes:
        piece: What it is.
        vertices: Positions, z from the bed up, x and y about the middle of the bed [mm].
        triangles: Outward triangles.
        parts: Bodies that do not hang together; 1 of a sound piece.
        voids: Hollows that nothing leads into; 0 of a sound piece.
        open_edges: Edges that have not exactly two triangles of opposite sense; 0 of a sound piece.
        volume_mm3: Volume of the exported mesh [mm^3].
    """

    piece: Piece
    vertices: Float32[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    parts: int
    voids: int
    open_edges: int
    volume_mm3: float

    @property
    def size(self) -> tuple[float, float, float]:
        """Width, depth and height on the bed [mm]."""
        width, depth, height = (self.vertices.max(axis=0) - self.vertices.min(axis=0)).astype(float)
        return float(width), float(depth), float(height)


def printable(piece: Piece) -> Printable:
    """Turn a piece as it is printed, round it to single precision and look at what came out."""
    solid = piece.solid.transform(np.column_stack([piece.printing, np.zeros(3)]))
    low, high = np.split(np.asarray(solid.bounding_box(), dtype=float), 2)
    middle = 0.5 * (low + high)
    solid = solid.translate((-middle[0], -middle[1], -low[2]))
    bodies = [part.volume() for part in solid.decompose()]
    vertices, triangles = weld(_apart(*mesh_of(solid.simplify(SIMPLIFY_MM))))
    return Printable(
        piece,
        vertices,
        triangles,
        parts=sum(volume > 0 for volume in bodies),
        voids=sum(volume <= 0 for volume in bodies),
        open_edges=open_edges(triangles),
        volume_mm3=_volume(vertices, triangles),
    )


def weld(
    corners: Float32[Array, "triangle 3 3"],
) -> tuple[Float32[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """Join equal corners of loose triangles, as whoever reads an STL file does; drop what has no area left.

    Args:
        corners: The corners of each triangle [mm].
    """
    loose = corners.reshape(-1, 3)
    order = np.lexsort(loose.T)
    ordered = loose[order]
    new = np.ones(len(loose), bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    index = np.empty(len(loose), np.int64)
    index[order] = np.cumsum(new) - 1
    triangles = index.reshape(-1, 3)
    a, b, c = triangles.T
    return ordered[new], triangles[(a != b) & (b != c) & (c != a)]


def open_edges(triangles: Int[Array, "triangle 3"]) -> int:
    """Edges that are not shared by two triangles of opposite sense; 0 of a closed surface."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = int(edges.max(initial=0)) + 1
    forth = edges[:, 0] * count + edges[:, 1]
    back = edges[:, 1] * count + edges[:, 0]
    keys, times = np.unique(forth, return_counts=True)
    return int((times != 1).sum() + np.setdiff1d(keys, back).size)


def read_stl(content: bytes) -> Float32[Array, "triangle 3 3"]:
    """Corners of the triangles of a binary STL file [mm].

    Raises:
        GeometryError: The file is shorter than it says.
    """
    count = int.from_bytes(content[80:84], "little")
    if len(content) != 84 + 50 * count:
        raise GeometryError(
            "a binary STL file of another length than it says", where="STL", hint="write it again"
        )
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    return np.frombuffer(content, kind, offset=84)["corners"]


def _apart(vertices: Array, triangles: Array) -> Float32[Array, "triangle 3 3"]:
    """Corners of the triangles in single precision, no two vertices at one place."""
    rounded = vertices.astype("<f4")
    inward = None
    for _ in range(ROUNDS):
        twins = _twins(rounded)
        if not twins.any():
            break
        if inward is None:
            inward = -vertex_normals(vertices, triangles)
        places = rounded.astype(float)
        places[twins] += APART_MM * inward[twins]
        rounded = places.astype("<f4")
    return rounded[triangles]


def _twins(points: Array) -> Bool[Array, " point"]:
    """Points that equal another one, the first of each set left out."""
    order = np.lexsort(points.T)
    same = (points[order][1:] == points[order][:-1]).all(axis=1)
    twins = np.zeros(len(points), bool)
    twins[order[1:][same]] = True
    return twins


def _volume(vertices: Array, triangles: Array) -> float:
    a, b, c = np.moveaxis(vertices[triangles].astype(float), 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
