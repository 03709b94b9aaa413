"""The pattern and solid stages: from a design to struts on the skin, and from these to a closed body."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.config import MaterialSettings, PatternSettings, SolidSettings
from hilbrace.domain.domain import Domain
from hilbrace.optimize.design import Design
from hilbrace.pattern.border import strut_widths
from hilbrace.pattern.checks import is_watertight, measured_thickness, part_count, spread_sample
from hilbrace.pattern.clip import cut_out, triangle_areas
from hilbrace.pattern.implicit import blended_pattern
from hilbrace.pattern.level import levelled
from hilbrace.pattern.mend import mended
from hilbrace.pattern.pattern import Pattern, Solid
from hilbrace.pattern.refine import refine, vertex_normals
from hilbrace.pattern.thicken import border_edges, folded_triangles, manifold, simplify, surface, thicken

Array = np.ndarray

FINEST_STRUT = 0.55
"""Longest mean edge of the refined skin, as a share of the least strut width: no edge jumps a strut [-]."""
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
    level = levelled(skin, blended, areas, design_fraction(domain, design), settings)
    done = mended(skin, level.depth, blended.rim_depth, areas, settings.min_strut_mm, settings.min_slit_mm)
    struts = cut_out(skin, done.line)
    return Pattern(
        vertices=struts.vertices,
        normals=struts.normals,
        triangles=struts.triangles,
        strut_width_min_mm=done.strut_mm,
        strut_width_median_mm=float(np.median(strut_widths(done.edge, _REACH * settings.min_strut_mm))),
        slit_width_min_mm=done.slit_mm,
        islands_dropped=level.islands + done.islands,
        area_fraction=float(triangle_areas(struts.vertices, struts.triangles).sum() / areas.sum()),
        level_shift=level.shift,
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
