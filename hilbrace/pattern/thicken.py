"""From the cut surface to a closed body: an outer face along the skin's normals, and walls between."""

from __future__ import annotations

import manifold3d
import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError

Array = np.ndarray


def thicken(
    vertices: Float[Array, "vertex 3"],
    normals: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    thickness_mm: float | Float[Array, " vertex"],
) -> tuple[Float[Array, "point 3"], Int[Array, "face 3"]]:
    """Offset a surface outwards and close it; the inner face stays on the skin.

    Args:
        vertices: Positions on the skin [mm].
        normals: Outward unit normals there; smooth, so that the outer face has no steps.
        triangles: Vertex indices, outward.
        thickness_mm: Distance of the outer face [mm], everywhere or at each vertex.

    Returns:
        Vertices (inner ones first, then the outer ones in the same order) and outward triangles.
    """
    count = len(vertices)
    a, b = border_edges(triangles).T
    walls = np.concatenate([np.stack([a, b, b + count], axis=1), np.stack([a, b + count, a + count], axis=1)])
    points = np.concatenate([vertices, vertices + np.reshape(thickness_mm, (-1, 1)) * normals])
    return points, np.concatenate([triangles[:, ::-1], triangles + count, walls])


def border_edges(triangles: Int[Array, "triangle 3"]) -> Int[Array, "edge 2"]:
    """Directed edges of one triangle only, surface on the left."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    code = edges.min(axis=1) * (int(triangles.max()) + 1) + edges.max(axis=1)
    _, first, times = np.unique(code, return_index=True, return_counts=True)
    return edges[np.sort(first[times == 1])]


def folded_triangles(
    vertices: Float[Array, "vertex 3"],
    normals: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    thickness_mm: float | Float[Array, " vertex"],
) -> int:
    """Triangles that the offset turns over: the skin is more concave there than the thickness allows."""
    inner, outer = vertices[triangles], (vertices + np.reshape(thickness_mm, (-1, 1)) * normals)[triangles]
    turn = np.cross(inner[:, 1] - inner[:, 0], inner[:, 2] - inner[:, 0])
    turned = np.cross(outer[:, 1] - outer[:, 0], outer[:, 2] - outer[:, 0])
    return int(((turn * turned).sum(axis=1) <= 0).sum())


def manifold(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> manifold3d.Manifold:
    """The body in manifold3d, in double precision.

    Raises:
        GeometryError: The body is not a closed manifold.
    """
    body = manifold3d.Manifold(
        manifold3d.Mesh64(
            vert_properties=np.ascontiguousarray(vertices, dtype=np.float64),
            tri_verts=np.ascontiguousarray(triangles, dtype=np.uint64),
        )
    )
    if body.status() != manifold3d.Error.NoError:
        raise GeometryError(
            f"the thickened brace is no closed body: {body.status().name}",
            where="solid",
            hint="change pattern.resolution_mm a little or lower material.thickness_mm",
        )
    return body


def simplify(body: manifold3d.Manifold, deviation_mm: float) -> manifold3d.Manifold:
    """Merge triangles as far as the surface moves by no more than ``deviation_mm``."""
    return body.simplify(deviation_mm) if deviation_mm > 0 else body


def surface(body: manifold3d.Manifold) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """Vertices [mm] and outward triangles of a body."""
    mesh = body.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)
