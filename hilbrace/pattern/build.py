"""The pattern and solid stages: from a design to struts on the skin, and from these to a closed body."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.config import MaterialSettings, PatternSettings, SolidSettings
from hilbrace.domain.domain import Domain
from hilbrace.optimize.design import Design
from hilbrace.pattern.border import Border, border, hole_numbers, strut_widths
from hilbrace.pattern.checks import is_watertight, measured_thickness, part_count, spread_sample
from hilbrace.pattern.clean import clean, drop_islands, mend, trim_needles
from hilbrace.pattern.clip import ZeroLine, cut_out, solid_fraction, triangle_areas, zero_line
from hilbrace.pattern.implicit import BlendedPattern, blended_pattern
from hilbrace.pattern.pattern import Pattern, Solid
from hilbrace.pattern.refine import RefinedSkin, refine, vertex_normals
from hilbrace.pattern.thicken import border_edges, folded_triangles, manifold, simplify, surface, thicken

Array = np.ndarray

STRUT_MARGIN = 1.02
"""Least width that struts are widened to, over the configured one [-]: room for the mesh's error."""
FINEST_STRUT = 0.55
"""Longest mean edge of the refined skin, as a share of the least strut width: no edge jumps a strut [-]."""
FRACTION_TOLERANCE = 0.003
"""Difference between the pattern's area fraction and the design's at which the level is right [-]."""
LEVEL_LIMIT = 0.05
"""Largest constant added to the half width [cell sides]."""
NEEDLE = 0.3
"""Struts were widened to the least width before: what is still below this share of it is a needle [-]."""
_ROUNDS = 6
_REACH = 4.0
_RAYS = 1000


def build_pattern(
    domain: Domain, design: Design, settings: PatternSettings, material: MaterialSettings | None = None
) -> Pattern:
    """Draw the struts on the skin.

    A constant is added to the half width everywhere so that, after the clean-up, the struts cover as much
    of the skin as the design's volume fraction says: blending, bands and least widths change the share that
    the curves of pure cells predict. Where every strut already has its least width the share stays above.

    Args:
        domain: The design domain.
        design: The optimized design.
        settings: Scale, least widths and resolution.
        material: Names of the cells (default: those of the default configuration).

    Raises:
        GeometryError: The struts do not hang together.
    """
    skin = refine(domain, min(settings.resolution_mm, FINEST_STRUT * settings.min_strut_mm))
    areas = triangle_areas(skin.vertices, skin.triangles)
    blended = blended_pattern(domain, design, skin, settings, material or MaterialSettings.model_validate({}))
    share = design_fraction(domain, design)
    depth, shift, dropped = _level(skin, blended, areas, share, settings)
    line = zero_line(skin, depth)
    edge, widths = _measured(skin, line, settings.min_strut_mm)
    for extra in range(1, _ROUNDS + 1):
        narrow = edge.middle[widths < settings.min_strut_mm]
        if not len(narrow):
            break
        needles = edge.middle[widths < NEEDLE * settings.min_strut_mm]
        if len(needles):
            line = zero_line(skin, trim_needles(skin, line, needles, settings.min_strut_mm / 2))
        wider = (STRUT_MARGIN + 0.03 * extra) * settings.min_strut_mm
        line = zero_line(skin, mend(skin, line, blended.rim_depth, narrow, wider))
        edge, widths = _measured(skin, line, settings.min_strut_mm)
    struts = cut_out(skin, line)
    return Pattern(
        vertices=struts.vertices,
        normals=struts.normals,
        triangles=struts.triangles,
        strut_width_min_mm=float(widths.min()),
        strut_width_median_mm=float(np.median(widths)),
        islands_dropped=dropped,
        area_fraction=float(triangle_areas(struts.vertices, struts.triangles).sum() / areas.sum()),
        level_shift=shift,
    )


def build_solid(
    pattern: Pattern, domain: Domain, design: Design, material: MaterialSettings, settings: SolidSettings
) -> Solid:
    """Thicken the struts into a closed body and check it.

    Args:
        pattern: The struts on the skin; the body's inner face.
        domain: The design domain.
        design: The optimized design, for the volume that it promises.
        material: Thickness and density.
        settings: Accuracy of the final mesh.

    Raises:
        GeometryError: The result is no closed body.
    """
    thickness = material.thickness_mm
    thick = manifold(*thicken(pattern.vertices, pattern.normals, pattern.triangles, thickness))
    body = simplify(thick, settings.simplify_mm)
    vertices, triangles = surface(body)
    on_border = np.isin(pattern.triangles, border_edges(pattern.triangles)).any(axis=1)
    corners = pattern.triangles[~on_border]
    corners = corners[spread_sample(len(corners), _RAYS)]
    measured = measured_thickness(
        body, pattern.vertices[corners].mean(axis=1), pattern.normals[corners].mean(axis=1), 2 * thickness
    )
    return Solid(
        vertices=vertices,
        triangles=triangles,
        thickness_mm=thickness,
        volume_mm3=float(body.volume()),
        mass_g=float(body.volume() / 1000.0 * material.density_g_per_ml),
        parts=part_count(body),
        watertight=is_watertight(triangles),
        manifold_status=body.status().name,
        genus=int(body.genus()),
        expected_volume_mm3=expected_volume(domain, design, thickness),
        thickness_p01_mm=float(np.percentile(measured, 1)),
        folded_triangles=folded_triangles(pattern.vertices, pattern.normals, pattern.triangles, thickness),
    )


def design_fraction(domain: Domain, design: Design) -> float:
    """Share of the skin that the design fills, bands included [-]."""
    areas = triangle_areas(domain.vertices, domain.triangles)
    return float((areas * _filled(design)).sum() / areas.sum())


def expected_volume(domain: Domain, design: Design, thickness_mm: float) -> float:
    """Area of the mid-surface times volume fraction times thickness, summed over the domain [mm^3]."""
    middle = domain.vertices + thickness_mm / 2 * vertex_normals(domain)
    return float((triangle_areas(middle, domain.triangles) * _filled(design)).sum() * thickness_mm)


def _filled(design: Design) -> Float[Array, " triangle"]:
    return np.where(design.rim, 1.0, design.volume_fraction_triangle)


def _measured(skin: RefinedSkin, line: ZeroLine, strut_mm: float) -> tuple[Border, Float[Array, " segment"]]:
    """The pattern's border, and the strut width at each of its segments [mm]."""
    edge = border(skin, line, hole_numbers(skin, line))
    return edge, strut_widths(edge, _REACH * strut_mm)


def _level(
    skin: RefinedSkin,
    blended: BlendedPattern,
    areas: Float[Array, " triangle"],
    share: float,
    settings: PatternSettings,
) -> tuple[Float[Array, " vertex"], float, int]:
    """Clean pattern whose area share is the design's: its depth, the level shift, the islands dropped."""
    best = (np.inf, np.zeros(0), 0.0, 0)
    aims, errors = [share], [0.0]
    for _ in range(_ROUNDS):
        shift = _shift_for(skin, blended, areas, aims[-1])
        depth = clean(
            skin,
            blended.depth(shift),
            blended.rim_depth,
            areas,
            STRUT_MARGIN * settings.min_strut_mm,
            settings.min_slit_mm,
        )
        depth, dropped = drop_islands(skin, depth, areas)
        errors[-1] = solid_fraction(skin, depth, areas) - share
        if abs(errors[-1]) < best[0]:
            best = (abs(errors[-1]), depth, shift, dropped)
        if best[0] <= FRACTION_TOLERANCE or abs(shift) >= 0.99 * LEVEL_LIMIT:
            break
        slope = 1.0 if len(aims) == 1 else (errors[-1] - errors[-2]) / (aims[-1] - aims[-2])
        aims.append(aims[-1] - errors[-1] / np.clip(slope, 0.5, 4.0))
        errors.append(0.0)
    return best[1], best[2], best[3]


def _shift_for(
    skin: RefinedSkin, blended: BlendedPattern, areas: Float[Array, " triangle"], share: float
) -> float:
    """Level shift at which the pattern, before any clean-up, covers ``share`` of the skin (bisection)."""
    low, high = -LEVEL_LIMIT, LEVEL_LIMIT
    for _ in range(20):
        middle = (low + high) / 2
        covered = solid_fraction(skin, blended.depth(middle), areas)
        low, high = (middle, high) if covered < share else (low, middle)
    return (low + high) / 2
