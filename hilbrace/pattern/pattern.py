"""The record that leaves the pattern stage: the struts as a surface."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray


def _nowhere() -> Float[Array, "0"]:
    return np.zeros(0)


@dataclass(frozen=True)
class Pattern:
    """The clipped pattern on the skin, ready to be thickened. Same frame and unit as the domain [mm].

    Attributes:
        vertices: Positions on the skin [mm].
        normals: Outward unit normals, interpolated from the smooth skin [-].
        triangles: Triangles of the struts, outward.
        d: Design variable at the vertices, in [0, 1] [-].
        firm: Firm fraction there, 0 soft to 1 firm [-].
        strut_width_mm: Width of the strut there [mm]: the largest disc in the strut that holds the vertex.
        strut_width_min_mm: Narrowest strut left [mm], at most 2.5 times the least one.
        strut_width_median_mm: Median strut width [mm].
        slit_width_min_mm: Narrowest slit left [mm], at most 2.5 times the least one.
        islands_dropped: Pieces that hung on nothing and were removed.
        area_fraction: Area of the struts over the area of the skin [-].
        level_shift: Constant added to the strut half width so that the area fraction is the design's [-].
        land_vertices: Positions of the vertices that only the skin between the struts has [mm].
        land_triangles: Triangles of the skin between the struts, outward. They index ``vertices`` first, then
            ``land_vertices``; with ``triangles`` they are the whole skin, without gap or overlap.
    """

    vertices: Float[Array, "vertex 3"]
    normals: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    d: Float[Array, " vertex"]
    firm: Float[Array, " vertex"]
    strut_width_mm: Float[Array, " vertex"]
    strut_width_min_mm: float
    strut_width_median_mm: float
    slit_width_min_mm: float
    islands_dropped: int
    area_fraction: float
    level_shift: float
    land_vertices: Float[Array, "land 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    land_triangles: Int[Array, "window 3"] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))

    @property
    def fields(self) -> dict[str, Float[Array, " vertex"]]:
        """What is known at each vertex, by the name it has in files."""
        return {"d": self.d, "firm": self.firm, "strut_width_mm": self.strut_width_mm}


@dataclass(frozen=True)
class Solid:
    """The brace as a closed body [mm].

    Attributes:
        vertices: Positions [mm].
        triangles: Triangles, outward.
        thickness_mm: Nominal thickness [mm].
        volume_mm3: Volume [mm^3].
        mass_g: Mass of the casting [g].
        parts: Connected pieces.
        watertight: Every edge has two triangles and the winding is consistent.
        manifold_status: Status that manifold3d gives, ``"NoError"`` when sound.
        genus: Number of handles.
        expected_volume_mm3: Mid-surface area times volume fraction times thickness [mm^3].
        thickness_p01_mm: First percentile of the thickness measured along rays [mm].
        thickness_min_mm: Least thickness of the offset; below the nominal one where the skin bends inwards
            so much that the outer face would fold [mm].
        folded_triangles: Outer triangles turned against their inner ones by the offset.
        d: Design variable at the vertices, in [0, 1] [-].
        label: Microstructure there, 1 firm and 0 soft.
        strut_width_mm: Width of the strut there [mm].
        local_thickness_mm: Thickness there [mm].
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    thickness_mm: float
    volume_mm3: float
    mass_g: float
    parts: int
    watertight: bool
    manifold_status: str
    genus: int
    expected_volume_mm3: float
    thickness_p01_mm: float
    folded_triangles: int
    thickness_min_mm: float = 0.0
    d: Float[Array, " place"] = field(default_factory=_nowhere)
    label: Float[Array, " place"] = field(default_factory=_nowhere)
    strut_width_mm: Float[Array, " place"] = field(default_factory=_nowhere)
    local_thickness_mm: Float[Array, " place"] = field(default_factory=_nowhere)

    @property
    def fields(self) -> dict[str, Float[Array, " place"]]:
        """What is known at each vertex, by the name it has in files."""
        return {
            "d": self.d,
            "label": self.label,
            "strut_width_mm": self.strut_width_mm,
            "thickness_mm": self.local_thickness_mm,
        }
