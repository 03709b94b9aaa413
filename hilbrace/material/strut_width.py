"""From widths in the unit cell to millimetres on the limb, and back.

One unit of the flat map is ``mm_per_uv`` millimetres long at a point, a cell is ``s / 2`` of the map, and a
strut reaches ``width`` cell sides to both sides of its skeleton: it is ``width * s * mm_per_uv`` wide.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from hilbrace.config import PatternSettings
from hilbrace.domain.domain import Domain

Array = np.ndarray

CELL_PERIOD_MM = {"knee": 80.0, "ankle": 60.0}
"""Period of the cells on the limb where the configuration leaves it out [mm]."""


def strut_width_mm(width: Any, scale: float, mm_per_uv: Any) -> Any:
    """Width of a strut on the limb [mm].

    Args:
        width: Half width in the cell, ``f_cell <= width`` [cell sides].
        scale: Period ``s`` of the cells in the flat map.
        mm_per_uv: Length of one unit of the flat map at the point [mm].
    """
    return width * scale * mm_per_uv


def minimum_width(strut_mm: float, scale: float, mm_per_uv: Any) -> Any:
    """Smallest half width whose strut is ``strut_mm`` wide [cell sides]; inverse of `strut_width_mm`."""
    return strut_mm / (scale * mm_per_uv)


def maximum_width(pinch_width: Any, slit_mm: float, scale: float, mm_per_uv: Any) -> Any:
    """Largest half width that leaves slits of at least ``slit_mm`` where the holes pinch [cell sides].

    Args:
        pinch_width: Half width at which holes split or fill up [cell sides].
        slit_mm: Narrowest slit [mm].
        scale: Period ``s`` of the cells in the flat map.
        mm_per_uv: Length of one unit of the flat map at the point [mm].
    """
    return pinch_width - slit_mm / (scale * mm_per_uv)


def wanted_scale(pattern: PatternSettings, domain: Domain) -> float:
    """Period of the cells in the flat map that the settings ask for, before it is closed around the limb.

    Args:
        pattern: The period in the map, on the limb, or neither.
        domain: The brace's surface and its map.
    """
    if pattern.scale is not None:
        return pattern.scale
    period_mm = pattern.period_mm or CELL_PERIOD_MM[domain.joint.split("_")[0]]
    length = map_length(domain.vertices, domain.triangles, domain.uv, domain.cut_triangles)
    return period_mm / float(np.median(length))


def cell_scale(pattern: PatternSettings, domain: Domain) -> float:
    """Period of the cells in the flat map, closed around the limb; see `wanted_scale`, `effective_scale`."""
    return effective_scale(wanted_scale(pattern, domain), domain.period_u)


def effective_scale(scale: float, period_u: float) -> float:
    """Period of the cells that closes around the limb: a whole number of periods in the map's width.

    Args:
        scale: Wanted period ``s``.
        period_u: Width of the periodic map; 0 for a map that is cut, whose scale stays as it is.
    """
    if period_u <= 0:
        return scale
    return period_u / max(1, round(period_u / scale))


def map_length(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    uv: Float[Array, "cut_vertex 2"],
    cut_triangles: Int[Array, "triangle 3"],
) -> Float[Array, " triangle"]:
    """Length of one unit of the flat map in each triangle [mm], from the ratio of the areas.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices.
        uv: Flat map of the cut vertices.
        cut_triangles: Triangles of the cut mesh, in the same order.
    """
    p, q = vertices[triangles], uv[cut_triangles]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    a, b = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
    return np.sqrt(area / np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
