"""What the pattern stage refuses before it draws anything, each by the key or field that is wrong."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.config import PatternSettings
from hilbrace.domain.domain import Domain
from hilbrace.errors import ConfigError, InputError
from hilbrace.material.curves import Microstructures
from hilbrace.material.strut_width import cell_scale, minimum_width, wanted_scale
from hilbrace.optimize.design import Design

Array = np.ndarray

FINEST_STRUT = 0.55
"""Longest mean edge of the refined skin, as a share of the least strut width: no edge jumps a strut [-]."""
COARSEST_MM = 1.0
"""Edge length where no other is asked for and the least strut would allow a longer one [mm]."""


def check_design(domain: Domain, design: Design) -> None:
    """Refuse a design that does not fit the domain or holds values that are no numbers.

    Raises:
        InputError: Names the field.
    """
    sizes = {
        "width_vertex": len(domain.uv),
        "d_vertex": len(domain.uv),
        "firm_vertex": len(domain.vertices),
        "volume_fraction_triangle": len(domain.triangles),
    }
    for name, size in sizes.items():
        value = getattr(design, name)
        if len(value) != size:
            raise InputError(
                f"'{name}' has {len(value)} values where the domain has {size}",
                where=f"design: {name}",
                hint="run the optimize stage again: the domain is another one",
            )
        wrong = np.flatnonzero(~np.isfinite(value))
        if len(wrong):
            raise InputError(
                f"'{name}' has {len(wrong)} of {size} values that are no numbers, the first at {wrong[0]}",
                where=f"design: {name}",
                hint="run the optimize stage again; if it was edited, mend the file",
            )


def check_cells(
    domain: Domain,
    design: Design,
    cells: Microstructures,
    settings: PatternSettings,
    map_length: Float[Array, " vertex"],
) -> None:
    """Refuse cells that do not fit on the brace, and struts that do not fit in the cells.

    Args:
        domain: The design domain.
        design: The design, for its firm fraction.
        cells: The two cells.
        settings: Scale and least strut.
        map_length: Length of one unit of the flat map at the vertices [mm].

    Raises:
        ConfigError: Names the key and the sizes in mm.
    """
    extent = np.ptp(domain.uv, axis=0)
    width = min(float(extent[0] if domain.period_u <= 0 else domain.period_u), float(extent[1]))
    typical = float(np.median(map_length))
    wanted = wanted_scale(settings, domain)
    key = "pattern.scale" if settings.scale is not None else "pattern.period_mm"
    if wanted > width:
        raise ConfigError(
            f"one period of the cells is {wanted * typical:.0f} mm long, the brace only "
            f"{width * typical:.0f} mm",
            where=key,
            hint=f"set it below {width / 2 * (1.0 if settings.scale is not None else typical):.2f}",
        )
    scale = cell_scale(settings, domain)
    least = minimum_width(settings.min_strut_mm, scale, map_length)
    filled = least >= cells.pinch_width(design.firm_vertex)
    if filled.mean() > 0.5:
        cell = scale / 2 * typical
        room = np.median(cells.pinch_width(design.firm_vertex) * scale * map_length)
        raise ConfigError(
            f"struts of {settings.min_strut_mm:g} mm leave no holes in cells of {cell:.1f} mm",
            where="pattern.min_strut_mm",
            hint=f"set it below {room:.1f}, or widen the cells "
            f"{settings.min_strut_mm / room:.1f} times ({key})",
        )


def resolution(settings: PatternSettings) -> float:
    """Edge length of the refined skin [mm].

    Raises:
        ConfigError: The one asked for is too coarse for the struts.
    """
    finest = FINEST_STRUT * settings.min_strut_mm
    if settings.resolution_mm is None:
        return min(finest, COARSEST_MM)
    if settings.resolution_mm > finest * (1 + 1e-9):
        raise ConfigError(
            f"edges of {settings.resolution_mm:g} mm cannot show struts of {settings.min_strut_mm:g} mm",
            where="pattern.resolution_mm",
            hint=f"set it to {finest:.2f} or less, or leave it out",
        )
    return settings.resolution_mm
