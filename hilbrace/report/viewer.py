"""A turnable 3-D view in one page: the field on the leg, and the solid brace on the same leg."""

from __future__ import annotations

import html

import numpy as np
import trimesh
from jaxtyping import Float, Int
from manifold3d import Manifold, Mesh64
from matplotlib import colormaps
from trimesh.viewer.notebook import scene_to_html

from hilbrace.body.body import Body
from hilbrace.domain.domain import Domain
from hilbrace.optimize.design import Design
from hilbrace.pattern.pattern import Solid
from hilbrace.report.figures import BRACE, FIELD, SKIN
from hilbrace.units import MM_PER_M

Array = np.ndarray

VIEW_TOLERANCE_MM = 0.25
"""How far the view's mesh may lie from the solid [mm]; the exported files are not touched."""


def turnable(body: Body, domain: Domain, design: Design, brace: Solid) -> str:
    """An ``<iframe>`` with the leg twice: with the design variable, and with the solid brace."""
    leg_vertices, leg_triangles = leg_around(body, domain.joint)
    shift = np.array([0.0, 0.0, 1.15 * np.ptp(leg_vertices[:, 2]) + 60.0])
    lifted = (
        domain.vertices
        + 1.5 * trimesh.Trimesh(domain.vertices, domain.triangles, process=False).vertex_normals
    )
    values = np.where(design.rim, 1.0, design.d_triangle)
    scene = trimesh.Scene()
    scene.add_geometry(_coloured(leg_vertices, leg_triangles, SKIN), "leg with field")
    scene.add_geometry(
        _coloured(lifted, domain.triangles, colormaps[FIELD](values)[:, :3]), "design variable"
    )
    scene.add_geometry(_coloured(leg_vertices + shift, leg_triangles, SKIN), "leg with brace")
    vertices, triangles = _lighter(brace)
    scene.add_geometry(_coloured(vertices + shift, triangles, BRACE), "brace")
    page = scene_to_html(scene)
    return f'<iframe class="turnable" title="turnable view" srcdoc="{html.escape(page)}"></iframe>'


def leg_around(body: Body, joint: str) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """The skin of the braced leg in the domain's frame [mm], hip to ankle."""
    side = joint.split("_")[1]
    centre = body.joint_centres[body.joint_names.index(joint)]
    hip = body.joint_centres[body.joint_names.index(f"hip_{side}")]
    ankle = body.joint_centres[body.joint_names.index(f"ankle_{side}")]
    middle = body.vertices[body.triangles].mean(axis=1)
    height = middle[:, 1]
    own_side = middle[:, 2] > 0 if side == "r" else middle[:, 2] < 0
    carried = [
        body.bones.index(bone)
        for bone in body.bones
        if bone.endswith(f"_{side}") and bone[:4] in ("femu", "tibi")
    ]
    on_leg = body.bone_weights[:, carried].sum(axis=1)[body.triangles].mean(axis=1) > 0.5
    kept = own_side & on_leg & (height < hip[1] - 0.08) & (height > ankle[1] + 0.02)
    used, triangles = np.unique(body.triangles[kept], return_inverse=True)
    return (body.vertices[used] - centre) * MM_PER_M, triangles.reshape(-1, 3)


def _lighter(brace: Solid) -> tuple[Array, Array]:
    mesh = Mesh64(vert_properties=brace.vertices, tri_verts=brace.triangles.astype(np.uint64))
    simple = Manifold(mesh).simplify(VIEW_TOLERANCE_MM).to_mesh64()
    return np.asarray(simple.vert_properties)[:, :3], np.asarray(simple.tri_verts).astype(np.int64)


def _coloured(vertices: Array, triangles: Array, colours: object) -> trimesh.Trimesh:
    rgb = np.broadcast_to(np.asarray(colours, dtype=float), (len(triangles), 3))
    per_vertex = np.zeros((len(vertices), 3))
    count = np.bincount(triangles.ravel(), minlength=len(vertices)).clip(1)
    for corner in range(3):
        np.add.at(per_vertex, triangles[:, corner], rgb)
    shades = (255 * per_vertex / count[:, None]).round().clip(0, 255).astype(np.uint8)
    return trimesh.Trimesh(vertices, triangles, vertex_colors=shades, process=False)
