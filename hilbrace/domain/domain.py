"""The record that leaves the domain stage: the brace's surface, its flat map and its motion."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

Array = np.ndarray


@dataclass(frozen=True)
class Domain:
    """The design domain in the brace's rest frame [mm]: neutral pose, OpenSim axes, origin in the joint.

    The rest frame is that of the joint's distal body in `JointLoads` (tibia of a knee, talus of an ankle) in
    the neutral pose, moved into the joint's centre and not turned: z is to the subject's right on both legs,
    and forces and axes in the distal frame are loads and axes in the rest frame.

    A sleeve is an annulus around the limb with two ends, the upper and the lower loop; a brace of the ankle
    goes from the shank to the midfoot. Windows (kneecap, open heel) are holes inside it: their edges are no
    ends, and nothing holds them.

    The mesh is closed around the limb (welded at the seam). The flat map lives on a copy of the mesh cut
    along the seam: ``cut_triangles`` index the rows of ``uv``, ``weld`` leads from them to the vertices.

    Attributes:
        joint: ``knee_l``, ``knee_r``, ``ankle_l`` or ``ankle_r``.
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
        posed: Vertices in each frame [mm], in the rest frame: seen by an observer who rides on
            the distal body.
        deformation: Deformation gradient of each triangle, rest to posed [-], between the triangle's own
            axes: the first along the edge from corner 0 to 1, the second in the triangle towards corner 2.
        quasi_conformal: Ratio of the singular values of the flat map per triangle [-], 1 is conformal.
        windows: Edges of the windows: rows of (number of the window, vertex), in order around each window,
            the way the lower loop runs. No rows for a plain sleeve.
        rims: Widths of the solid bands at the upper loop, the lower loop and around each window [mm]; NaN, or
            no entries at all, where the pattern's own width holds.
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
    windows: Int[Array, "corner 2"] = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    rims: Float[Array, " loop"] = field(default_factory=lambda: np.zeros(0))

    @property
    def window_loops(self) -> tuple[Int[Array, " _corner"], ...]:
        """Vertices of the edge of each window, in order around."""
        count = int(self.windows[:, 0].max(initial=-1)) + 1
        return tuple(self.windows[self.windows[:, 0] == number, 1] for number in range(count))


@dataclass(frozen=True)
class RimBand:
    """Triangles that become solid bands along the loops, those of the windows included.

    Attributes:
        triangles: True where a triangle's centre lies within the width of the band of a loop.
        vertex_distance: Distance of each vertex to the nearest loop [mm].
        width_mm: Width of the bands that the domain gives no width of their own [mm].
    """

    triangles: Bool[Array, " triangle"]
    vertex_distance: Float[Array, " vertex"]
    width_mm: float
