"""The two microstructures as one signed depth on the refined skin.

The paper blends the distance fields, ``(1 - s) f_soft + s f_firm`` (Eq. 6). That sum is small only where two
skeletons happen to meet: homogenized for our cells at equal volume, its modulus is zero for ``s`` between 0.3
and 0.7, and a brace cut by it falls into two rings. Where the firm fraction ``s`` is near one half we lay the
two patterns over each other instead, each ending a little way inside the other's region, and leave it to the
clean-up to cut what hangs free back to the next node. Outside that band both forms are the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from hilbrace.config import MaterialSettings, PatternSettings
from hilbrace.domain.domain import Domain
from hilbrace.material.cells import cell_distance, fold
from hilbrace.material.curves import load_microstructures
from hilbrace.material.strut_width import cell_scale, map_length, minimum_width
from hilbrace.optimize.design import Design
from hilbrace.pattern.clip import zero_line
from hilbrace.pattern.refine import RefinedSkin
from hilbrace.pattern.stitch import flat_values

Array = np.ndarray

OVERLAP = 0.2
"""How far past the line of equal shares the soft pattern ends, and the firm one beyond it [cell sides]."""


@dataclass(frozen=True)
class BlendedPattern:
    """What decides at each vertex of the refined skin whether it is strut or hole.

    Attributes:
        soft_distance: Distance to the skeleton of the soft cell [cell sides].
        firm_distance: Distance to the skeleton of the firm cell [cell sides].
        soft_width: Strut half width that the design asks of the soft cell [cell sides].
        firm_width: The same of the firm cell [cell sides].
        least_width: Half width of the narrowest strut [cell sides].
        into_firm: Distance from the line of equal shares, positive where firm [mm].
        cell_mm: Side of a cell on the limb [mm].
        rim_depth: Depth inside the solid bands along the edges of the skin, and inside the strip along a
            free seam, negative outside of them [mm].
    """

    soft_distance: Float[Array, " vertex"]
    firm_distance: Float[Array, " vertex"]
    soft_width: Float[Array, " vertex"]
    firm_width: Float[Array, " vertex"]
    least_width: Float[Array, " vertex"]
    into_firm: Float[Array, " vertex"]
    cell_mm: Float[Array, " vertex"]
    rim_depth: Float[Array, " vertex"]

    def depth(self, level_shift: float) -> Float[Array, " vertex"]:
        """Signed depth inside the solid [mm], positive in struts and bands, negative in holes.

        Args:
            level_shift: Constant added to the half width, which stays above the least [cell sides].
        """
        soft = np.maximum(self.soft_width + level_shift, self.least_width) - self.soft_distance
        firm = np.maximum(self.firm_width + level_shift, self.least_width) - self.firm_distance
        soft = np.minimum(soft * self.cell_mm, OVERLAP * self.cell_mm - self.into_firm)
        firm = np.minimum(firm * self.cell_mm, OVERLAP * self.cell_mm + self.into_firm)
        return np.maximum(np.maximum(soft, firm), self.rim_depth)


def blended_pattern(
    domain: Domain, design: Design, skin: RefinedSkin, settings: PatternSettings, material: MaterialSettings
) -> BlendedPattern:
    """Evaluate the two microstructures on the refined skin.

    The flat map is evaluated on the cut mesh, in the triangle that each vertex belongs to. On a periodic
    map the period of the cells is rounded so that the pattern closes across the seam; a free seam is
    stitched (`hilbrace.pattern.stitch`).

    Args:
        domain: The design domain.
        design: The optimized design; its blended width says how wide both patterns' struts are.
        skin: The refined mesh of the domain.
        settings: Scale of the cells, least strut and width of the bands.
        material: Names of the two cells.
    """
    cells = load_microstructures(material.soft, material.firm)
    scale = cell_scale(settings, domain)
    flat = flat_values(domain, skin, design.width_vertex, max(settings.seam_mm, settings.min_strut_mm))
    u, v = (fold(flat.uv[:, k], scale) for k in range(2))
    length = skin.from_vertices(domain.triangles, vertex_map_length(domain))
    firm = skin.from_vertices(domain.triangles, design.firm_vertex)
    d = cells.design_variable(flat.value, firm)
    return BlendedPattern(
        soft_distance=cell_distance(material.soft, u, v),
        firm_distance=cell_distance(material.firm, u, v),
        soft_width=cells.soft.width(d),
        firm_width=cells.firm.width(d),
        least_width=minimum_width(settings.min_strut_mm, scale, length),
        into_firm=_distance_into(skin, firm, scale * float(length.max())),
        cell_mm=scale / 2 * length,
        rim_depth=np.maximum(band_depth(domain, skin, settings.rim_mm), flat.strip_depth),
    )


def vertex_map_length(domain: Domain) -> Float[Array, " vertex"]:
    """Length of one unit of the flat map at the vertices of the closed mesh [mm], mean of their triangles."""
    length = map_length(domain.vertices, domain.triangles, domain.uv, domain.cut_triangles)
    corners = domain.triangles.ravel()
    return np.bincount(corners, np.repeat(length, 3)) / np.bincount(corners)


def _distance_into(
    skin: RefinedSkin, firm: Float[Array, " vertex"], reach_mm: float
) -> Float[Array, " vertex"]:
    """Distance from the line where the firm fraction is one half, negative on the soft side [mm]."""
    line = zero_line(skin, (firm - 0.5) * skin.edge_mm)
    distance = np.full(len(firm), reach_mm)
    if len(line.points):
        distance = np.minimum(KDTree(line.points).query(skin.vertices, workers=-1)[0], reach_mm)
    return np.where(firm > 0.5, distance, -distance)


def band_depth(domain: Domain, skin: RefinedSkin, width_mm: float) -> Float[Array, " vertex"]:
    """Depth inside the solid bands along the ends of the brace and around its windows [mm].

    Args:
        domain: The design domain; bands take the widths that it gives them.
        skin: Its refined mesh.
        width_mm: Width of the other bands [mm].
    """
    loops = (domain.upper_loop, domain.lower_loop, *domain.window_loops)
    own = domain.rims if len(domain.rims) else np.full(len(loops), np.nan)
    depth = np.full(len(skin.vertices), -np.inf)
    for number in range(int(skin.loop.max()) + 1):
        edges = skin.loop_edges[skin.loop == number]
        known = [w for loop, w in zip(loops, own, strict=True) if loop[0] in edges and not np.isnan(w)]
        depth = np.maximum(depth, (known[0] if known else width_mm) - _line_distance(skin, edges))
    return depth


def _line_distance(skin: RefinedSkin, edges: Int[Array, "edge 2"]) -> Float[Array, " vertex"]:
    """Distance of the vertices to a line of edges, exact to its segments near it [mm]."""
    start, end = skin.vertices[edges[:, 0]], skin.vertices[edges[:, 1]]
    _, near = KDTree((start + end) / 2).query(skin.vertices, k=3, workers=-1)
    a, b = start[near], end[near]
    along = b - a
    t = ((skin.vertices[:, None] - a) * along).sum(axis=2) / (along**2).sum(axis=2)
    foot = a + np.clip(t, 0, 1)[..., None] * along
    return np.linalg.norm(skin.vertices[:, None] - foot, axis=2).min(axis=1)
