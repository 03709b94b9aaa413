"""The record that leaves the domain stage: the brace's surface, its flat map and its motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

Array = np.ndarray


@dataclass(frozen=True)
class Domain:
    """The design domain in the brace's rest frame [mm]: neutral pose, OpenSim axes, origin in the joint.

    The mesh is closed around the limb (welded at the seam). The flat map lives on a copy of the mesh cut
    along the seam: ``cut_triangles`` index the rows of ``uv``, ``weld`` leads from them to the vertices.

    Attributes:
        joint: ``knee_l`` or ``knee_r``.
        vertices: Rest positions [mm].
        triangles: Vertex indices, outward orientation.
        upper_loop: Vertices of the proximal edge, in order around: from the seam the way u grows.
        lower_loop: Vertices of the distal edge, likewise.
        cut_triangles: Triangles of the cut mesh (same order as ``triangles``).
        weld: Vertex of each cut vertex.
        uv: Flat map of the cut vertices, in [0, 1]^2, one scale for both axes. Seen from outside with the
            proximal end up, u grows to the right and v upwards.
        seam_pairs: Cut vertices that are one vertex in the closed mesh: (left, right) edge of the flat map,
            from distal to proximal. In a periodic map u differs by exactly ``period_u`` and v by 0.
        flatten: ``"lscm"``, ``"periodic"`` or ``"slim"``.
        period_u: Width of the map around the limb where it is periodic [uv units]; 0 for a free seam.
        time: Frames kept for the design [s].
        posed: Vertices in each frame [mm], in the frame of the neutral tibia (rigid motion removed).
        deformation: Deformation gradient of each triangle, rest to posed [-], between the triangle's own
            axes: the first along the edge from corner 0 to 1, the second in the triangle towards corner 2.
        quasi_conformal: Ratio of the singular values of the flat map per triangle [-], 1 is conformal.
    """

    joint: str
    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    upper_loop: Int[Array, " upper"]
    lower_loop: Int[Array, " lower"]
    cut_triangles: Int[Array, "triangle 3"]
    weld: Int[Array, " cut_vertex"]
    uv: Float[Array, "cut_vertex 2"]
    seam_pairs: Int[Array, "pair 2"]
    flatten: str
    period_u: float
    time: Float[Array, " frame"]
    posed: Float[Array, "frame vertex 3"]
    deformation: Float[Array, "frame triangle 2 2"]
    quasi_conformal: Float[Array, " triangle"]


@dataclass(frozen=True)
class RimBand:
    """Triangles that become solid bands along both loops.

    Attributes:
        triangles: True where a triangle's centre lies within ``width_mm`` of a loop.
        vertex_distance: Distance of each vertex to the nearer loop [mm].
        width_mm: Width of the band [mm].
    """

    triangles: Bool[Array, " triangle"]
    vertex_distance: Float[Array, " vertex"]
    width_mm: float
