"""Bodies and their meshes: `manifold3d` in double precision on one side, plain arrays on the other."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Error, Manifold, Mesh64

from hilbrace.errors import GeometryError

Array = np.ndarray


def body_of(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], name: str = "mold"
) -> Manifold:
    """A body from its closed surface, in double precision.

    Args:
        vertices: Positions [mm].
        triangles: Outward triangles.
        name: What the body is called in the error.

    Raises:
        GeometryError: The surface is open, or an edge belongs to more than two triangles.
    """
    mesh = Mesh64(
        vert_properties=np.ascontiguousarray(vertices, dtype=np.float64),
        tri_verts=np.ascontiguousarray(triangles, dtype=np.uint64),
    )
    body = Manifold(mesh)
    if body.status() != Error.NoError:
        raise GeometryError(
            f"the surface encloses no body ({body.status().name})",
            where=name,
            hint="close its holes and remove doubled or flipped triangles in a mesh editor",
        )
    return body


def mesh_of(solid: Manifold) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """Vertices [mm] and outward triangles of a body."""
    mesh = solid.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, dtype=float)[:, :3]
    return vertices, np.asarray(mesh.tri_verts).astype(np.int64)


def extent(solid: Manifold) -> Float[Array, "3"]:
    """Size of a body's bounding box along x, y and z [mm]."""
    box = np.asarray(solid.bounding_box(), dtype=float)
    return box[3:] - box[:3]


def vertex_normals(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, "vertex 3"]:
    """Unit normals at the vertices, weighed by area; zero where the triangles cancel out [-]."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(total, triangles[:, corner], normals)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
