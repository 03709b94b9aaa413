"""A lighter mesh of the solid for pictures; the exported files are not touched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from manifold3d import Manifold, Mesh64
from scipy.spatial import KDTree

from hilbrace.pattern.pattern import Solid

TOLERANCE_MM = 0.3
"""How far the pictures' mesh may lie from the solid [mm]."""


def lighter(brace: Solid) -> Solid:
    """The solid with flat parts in larger triangles; each vertex has the fields of the nearest one."""
    mesh = Mesh64(vert_properties=brace.vertices, tri_verts=brace.triangles.astype(np.uint64))
    simple = Manifold(mesh).simplify(TOLERANCE_MM).to_mesh64()
    vertices = np.asarray(simple.vert_properties)[:, :3]
    _, nearest = KDTree(brace.vertices).query(vertices)
    return replace(
        brace,
        vertices=vertices,
        triangles=np.asarray(simple.tri_verts).astype(np.int64),
        **{name: values[nearest] if len(values) else values for name, values in _fields(brace).items()},
    )


def _fields(brace: Solid) -> dict[str, np.ndarray]:
    return {name: getattr(brace, name) for name in ("d", "label", "strut_width_mm", "local_thickness_mm")}
