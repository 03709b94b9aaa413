"""Pieces as a printer gets them: standing on the bed, in single precision, and watertight in it.

Single precision can press two vertices into one; what is exported is therefore checked after the rounding,
on the very numbers that a slicer will read.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int
from manifold3d import Manifold

from fabrication.bodies import mesh_of
from fabrication.mold import Piece
from hilbrace.errors import GeometryError

Array = np.ndarray

TOLERANCES_MM = (1e-4, 1e-3, 1e-2)
"""How far surfaces may move so that no two vertices become one in single precision: the first that does it
[mm]. A printer is a hundred times coarser than the last."""


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
    vertices, triangles, opened = _rounded(solid, TOLERANCES_MM[0])
    for tolerance in TOLERANCES_MM[1:]:
        if opened == 0:
            break
        vertices, triangles, opened = _rounded(solid, tolerance)
    return Printable(
        piece,
        vertices,
        triangles,
        parts=sum(volume > 0 for volume in bodies),
        voids=sum(volume <= 0 for volume in bodies),
        open_edges=opened,
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
    return int((times != 1).sum() + np.setxor1d(keys, back).size)


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


def _rounded(solid: Manifold, tolerance_mm: float) -> tuple[Array, Array, int]:
    vertices, triangles = mesh_of(solid.simplify(tolerance_mm))
    points, corners = weld(vertices.astype("<f4")[triangles])
    return points, corners, open_edges(corners)


def _volume(vertices: Array, triangles: Array) -> float:
    a, b, c = np.moveaxis(vertices[triangles].astype(float), 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
