"""The surfaces in which shells meet: sheets through the limb's outline as the pulls see it.

Two shells meet in one sheet that is a graph over the plane across their pulls, and follows the outline of
the limb seen along the pull. Whatever lies above the sheet leaves along the pull, whatever lies below it
leaves the other way, and no part of the limb is in the way as long as every line along the pull meets it only
once. Knees and ankles, bent or not, are all of this kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold
from scipy.ndimage import binary_closing, binary_erosion
from scipy.sparse import coo_array, csr_array, diags_array, kron
from scipy.sparse.linalg import splu

from fabrication.bodies import body_of, mesh_of
from fabrication.ends import End, inside, reaching_inside
from fabrication.faces import face_normals

Array = np.ndarray

STIFFNESS = 3.0
"""Weight of the sheet's bending against its way from the outline: features shorter than about 15 mm are
smoothed."""

BORDER_CELLS = 3
"""Silhouette edges further inside the shadow than this many cells belong to hollows, not to the outline."""

LEAST_COSINE = 0.5
"""Slabs on sheets steeper than this grow thinner [-]."""

SAMPLE_MM = 1.0
"""Spacing of the places along silhouette edges [mm]."""

DENSE_MM = 2.0
"""Spacing of the points that cast a surface's shadow [mm]."""


@dataclass(frozen=True)
class Surface:
    """A surface that shells shall come off.

    Attributes:
        vertices: Positions [mm].
        triangles: Triangles, outward.
        normals: Unit normals of the triangles.
        areas: Their areas [mm^2].
        points: Points that cover it densely [mm].
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    normals: Float[Array, "triangle 3"]
    areas: Float[Array, " triangle"]
    points: Float[Array, "point 3"]

    @property
    def middles(self) -> Float[Array, "triangle 3"]:
        """Middles of the triangles [mm]."""
        return self.vertices[self.triangles].mean(axis=1)


def surface_of(solid: Manifold, ends: tuple[End, ...]) -> Surface:
    """The sides of a body: what of its surface reaches inside its ends."""
    vertices, triangles = mesh_of(solid)
    sides = triangles[reaching_inside(ends, vertices, triangles)]
    points, _ = mesh_of(solid.refine_to_length(DENSE_MM))
    normals, areas = face_normals(vertices, sides)
    return Surface(vertices, sides, normals, areas, points[inside(ends, points)])


@dataclass(frozen=True)
class Seam:
    """A sheet in which two shells meet, as a grid of points.

    Attributes:
        first: Number of the shell on the side that ``across`` points away from.
        second: Number of the shell on the other side.
        points: The sheet's grid [mm]; rows run across the limb, columns along it.
        across: Unit direction through the sheet, out of the first shell into the second.
    """

    first: int
    second: int
    points: Float[Array, "row column 3"]
    across: Float[Array, "3"]

    def slab(self, half_mm: float) -> Manifold:
        """The body within a distance of the sheet, measured square to it."""
        slope = np.maximum(self.normals() @ self.across, LEAST_COSINE)
        shift = (half_mm / slope)[..., None] * self.across
        return between(self.points - shift, self.points + shift)

    def normals(self) -> Float[Array, "row column 3"]:
        """Unit normals of the sheet, out of the first shell."""
        rows, columns = np.gradient(self.points, axis=0), np.gradient(self.points, axis=1)
        normal = np.cross(rows, columns)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return normal * np.sign(normal @ self.across)[..., None]


@dataclass(frozen=True)
class Graph:
    """A sheet over the plane across a pull.

    Attributes:
        axes: Rows: two unit directions across the pull, and the pull.
        low: Least coordinates of the grid along the two [mm].
        cell: Spacing [mm].
        height: The sheet's coordinate along the pull at each place of the grid [mm].
    """

    axes: Float[Array, "3 3"]
    low: Float[Array, "2"]
    cell: float
    height: Float[Array, "row column"]

    def points(self) -> Float[Array, "row column 3"]:
        """The grid in space [mm]."""
        rows, columns = (
            low + self.cell * np.arange(n) for low, n in zip(self.low, self.height.shape, strict=True)
        )
        u, v = np.meshgrid(rows, columns, indexing="ij")
        return np.stack([u, v, self.height], axis=-1) @ self.axes

    def above(self, points: Float[Array, "point 3"]) -> Float[Array, " point"]:
        """How far points lie above the sheet, along the pull [mm]."""
        local = points @ self.axes.T
        weights = bilinear(local[:, :2], self.low, self.cell, self.height.shape)
        return local[:, 2] - weights @ self.height.reshape(-1)

    def half_spaces(self, reach_mm: float) -> tuple[Manifold, Manifold]:
        """What lies above the sheet and what lies below it, as far as a reach."""
        sheet = self.points()
        level = sheet - (sheet @ self.axes[2])[..., None] * self.axes[2]
        top, bottom = level + reach_mm * self.axes[2], level - reach_mm * self.axes[2]
        return between(sheet, top), between(bottom, sheet)


def pull_axes(pull: Float[Array, "3"], along: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Right-handed axes: the third a pull, the second as near as can be to the limb's direction."""
    third = pull / np.linalg.norm(pull)
    second = along - (along @ third) * third
    second /= np.linalg.norm(second)
    return np.stack([np.cross(second, third), second, third])


def fit_graph(surface: Surface, axes: Float[Array, "3 3"], margin_mm: float, cell_mm: float) -> Graph:
    """The smooth sheet through the outline of a surface as it is seen along a pull.

    The outline consists of the edges between faces that look along the pull and faces that look against it.
    The sheet is the thin plate that passes them in the sense of least squares, each edge by its length.

    Args:
        surface: The surface.
        axes: Rows: two directions across the pull, and the pull.
        margin_mm: How far the sheet reaches beyond the surface [mm].
        cell_mm: Spacing of its grid [mm].
    """
    places = surface.points @ axes[:2].T
    low = places.min(axis=0) - margin_mm
    shape = tuple((np.ceil((places.max(axis=0) + margin_mm - low) / cell_mm).astype(int) + 1).tolist())
    middle, length = _outline(surface, axes, low, cell_mm, shape)
    data = bilinear(middle[:, :2], low, cell_mm, shape)
    normal = data.T @ diags_array(length / cell_mm) @ data + STIFFNESS * _bending(shape)
    right = data.T @ (length / cell_mm * middle[:, 2])
    height = splu((normal + 1e-9 * diags_array(np.ones(normal.shape[0]))).tocsc()).solve(right)
    return Graph(axes, low, cell_mm, height.reshape(shape))


def bilinear(
    places: Float[Array, "point 2"], low: Float[Array, "2"], cell: float, shape: tuple[int, ...]
) -> csr_array:
    """Weights that interpolate values of a grid at places; places outside take the nearest edge's plane."""
    at = (places - low) / cell
    corner = np.clip(np.floor(at).astype(int), 0, np.array(shape) - 2)
    part = at - corner
    rows, columns, weights = [], [], []
    for i in (0, 1):
        for j in (0, 1):
            rows.append(np.arange(len(places)))
            columns.append((corner[:, 0] + i) * shape[1] + corner[:, 1] + j)
            weights.append(np.where(i, part[:, 0], 1 - part[:, 0]) * np.where(j, part[:, 1], 1 - part[:, 1]))
    entries = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, shape=(len(places), int(np.prod(shape)))).tocsr()


def between(lower: Float[Array, "row column 3"], upper: Float[Array, "row column 3"]) -> Manifold:
    """The body between two sheets of equal grids; two that share a sheet share its very triangles."""
    rows, columns = lower.shape[:2]
    count = rows * columns
    number = np.arange(count).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    top = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    ahead = np.roll(rim, -1)
    walls = np.concatenate(
        [np.stack([rim, ahead, ahead + count], axis=1), np.stack([rim, ahead + count, rim + count], axis=1)]
    )
    triangles = np.concatenate([top[:, ::-1], top + count, walls])
    vertices = np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
    cross = np.cross(lower[1, 0] - lower[0, 0], lower[0, 1] - lower[0, 0])
    outward = cross @ (upper[0, 0] - lower[0, 0]) > 0
    return body_of(vertices, triangles if outward else triangles[:, ::-1], "parting")


def silhouette(
    normals: Float[Array, "triangle 3"], triangles: Int[Array, "triangle 3"], pull: Float[Array, "3"]
) -> Int[Array, "edge 2"]:
    """Edges between faces that look along a pull and faces that look against it."""
    front = normals @ pull > 0
    forth = triangles[front][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    back = triangles[~front][:, [1, 0, 2, 1, 0, 2]].reshape(-1, 2)
    count = int(triangles.max()) + 1
    shared = np.isin(forth[:, 0] * count + forth[:, 1], back[:, 0] * count + back[:, 1])
    return forth[shared]


def _outline(
    surface: Surface, axes: Array, low: Array, cell: float, shape: tuple[int, ...]
) -> tuple[Float[Array, "sample 3"], Float[Array, " sample"]]:
    """Places along the silhouette edges at the border of the shadow, and the length that each stands for."""
    ends = surface.vertices[silhouette(surface.normals, surface.triangles, axes[2])] @ axes.T
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    count = np.ceil(length / SAMPLE_MM).astype(int)
    edge = np.repeat(np.arange(len(ends)), count)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    part = ((number + 0.5) / count[edge])[:, None]
    samples = (1.0 - part) * ends[edge, 0] + part * ends[edge, 1]
    shadow = np.zeros(shape, bool)
    shadow[tuple(np.rint((surface.points @ axes[:2].T - low) / cell).astype(int).T)] = True
    inside = np.asarray(binary_erosion(binary_closing(shadow, iterations=2), iterations=BORDER_CELLS), bool)
    at_border = ~inside[tuple(np.rint((samples[:, :2] - low) / cell).astype(int).T)]
    return samples[at_border], (length / count)[edge][at_border]


def _bending(shape: tuple[int, ...]) -> csr_array:
    """Energy of a thin plate on a grid: squares of second differences."""
    first = [_differences(n, 1) for n in shape]
    second = [_differences(n, 2) for n in shape]
    eye = [diags_array(np.ones(n)) for n in shape]
    bends = (kron(second[0], eye[1]), kron(eye[0], second[1]), np.sqrt(2.0) * kron(first[0], first[1]))
    return csr_array(sum(bend.T @ bend for bend in bends))


def _differences(count: int, order: int) -> csr_array:
    """Differences of neighbouring values, once or twice."""
    return csr_array(np.diff(np.eye(count), n=order, axis=0))
