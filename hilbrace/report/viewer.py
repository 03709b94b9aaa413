"""A turnable 3-D view in one page: the field on the leg, and the solid brace on the same leg."""

from __future__ import annotations

import html

import numpy as np
import trimesh
from jaxtyping import Float, Int
from matplotlib import colormaps
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from trimesh.viewer.notebook import scene_to_html

from hilbrace.body.body import Body
from hilbrace.domain.domain import Domain
from hilbrace.domain.isoline import compact, cut_by_plane
from hilbrace.optimize.design import Design
from hilbrace.pattern.pattern import Solid
from hilbrace.report.figures import BRACE, FIELD, SKIN
from hilbrace.units import MM_PER_M

Array = np.ndarray

LIFT_MM = 3.0
"""The field is drawn this far above the skin and the leg below it, whose coarser mesh would pierce [mm]."""

THIGH, SHANK = 0.72, 0.85
"""Parts of the thigh and the shank that are shown around a knee, and of the shank above an ankle [-]."""

TO_FRONT = np.array([[0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Turns the front of the leg (x) towards the viewer's camera (z)."""

ADDED = "scene.add(gltf.scene);"
DULL = (
    "scene.add(new THREE.AmbientLight(0xffffff,0.35));tracklight.intensity=0.7;"
    "gltf.scene.traverse(function(o){if(o.material){o.material.metalness=0;o.material.roughness=1;}});"
)
"""Said to the viewer once the scene is there: its default material is metal, and looks black."""


def turnable(body: Body, domain: Domain, design: Design, brace: Solid) -> str:
    """An ``<iframe>`` with the leg twice: with the design variable, and with the solid brace."""
    leg_vertices, leg_triangles = leg_around(body, domain.joint)
    inward = trimesh.Trimesh(leg_vertices, leg_triangles, process=False).vertex_normals
    leg_vertices = leg_vertices - LIFT_MM * inward
    shift = np.array([0.0, 0.0, -(1.1 * np.ptp(leg_vertices[:, 2]) + 60.0)])
    smooth = trimesh.Trimesh(domain.vertices, domain.triangles, process=False).vertex_normals
    lifted = domain.vertices + LIFT_MM * smooth
    colours = colormaps[FIELD](design.d_triangle)[:, :3]
    scene = trimesh.Scene()
    scene.add_geometry(_coloured(leg_vertices, leg_triangles, SKIN), "leg with the field")
    scene.add_geometry(_coloured(lifted, domain.triangles, colours), "design variable")
    scene.add_geometry(_coloured(leg_vertices + shift, leg_triangles, SKIN), "leg with the brace")
    scene.add_geometry(_coloured(brace.vertices + shift, brace.triangles, BRACE), "brace")
    scene.apply_transform(TO_FRONT)
    page = scene_to_html(scene).replace(ADDED, ADDED + DULL)
    return f'<iframe class="turnable" title="turnable view" srcdoc="{html.escape(page)}"></iframe>'


def leg_around(body: Body, joint: str) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """The skin around the braced joint in the domain's frame [mm]; of an ankle down to the sole."""
    kind, side = joint.split("_")
    centre = _centre(body, joint)
    above, share = ("hip", THIGH) if kind == "knee" else ("knee", SHANK)
    vertices = (body.vertices - centre) * MM_PER_M
    top = MM_PER_M * share * (_centre(body, f"{above}_{side}") - centre)[1]
    up = np.array([0.0, 1.0, 0.0])
    vertices, triangles = cut_by_plane(vertices, body.triangles, up, top, snap=1.0)
    if kind == "knee":
        bottom = MM_PER_M * SHANK * (_centre(body, f"ankle_{side}") - centre)[1]
        vertices, triangles = cut_by_plane(vertices, triangles, -up, -bottom, snap=1.0)
    edges = (np.ones(len(triangles)), (triangles[:, 0], triangles[:, 1]))
    more = (np.ones(len(triangles)), (triangles[:, 1], triangles[:, 2]))
    size = (len(vertices), len(vertices))
    _, part = connected_components(coo_array(edges, size) + coo_array(more, size), directed=False)
    own = part[np.argmin(np.linalg.norm(vertices, axis=1))]
    return compact(vertices, triangles, part[triangles[:, 0]] == own)


def _centre(body: Body, joint: str) -> Float[Array, " xyz"]:
    return body.joint_centres[body.joint_names.index(joint)]


def _coloured(vertices: Array, triangles: Array, colours: object) -> trimesh.Trimesh:
    rgb = np.broadcast_to(np.asarray(colours, dtype=float), (len(triangles), 3))
    per_vertex = np.zeros((len(vertices), 3))
    count = np.bincount(triangles.ravel(), minlength=len(vertices)).clip(1)
    for corner in range(3):
        np.add.at(per_vertex, triangles[:, corner], rgb)
    shades = (255 * per_vertex / count[:, None]).round().clip(0, 255).astype(np.uint8)
    mesh = trimesh.Trimesh(vertices, triangles, vertex_colors=shades, process=False)
    return trimesh.Trimesh(
        vertices, triangles, vertex_colors=shades, vertex_normals=mesh.vertex_normals, process=False
    )
