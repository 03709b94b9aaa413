"""The pattern and solid stages: from a design to struts on the skin, and from these to a closed body."""

from __future__ import annotations

import manifold3d
import numpy as np
from jaxtyping import Float

from hilbrace.config import MaterialSettings, PatternSettings, SolidSettings
from hilbrace.domain.domain import Domain
from hilbrace.material.curves import load_microstructures
from hilbrace.optimize.design import Design
from hilbrace.pattern.axis import strut_axis
from hilbrace.pattern.border import strut_widths
from hilbrace.pattern.checks import is_watertight, measured_thickness, part_count, spread_sample
from hilbrace.pattern.clip import cut_out, lands_beside, solid_fraction, triangle_areas
from hilbrace.pattern.fields import local_widths, nearest_values, places_on
from hilbrace.pattern.implicit import BlendedPattern, blended_pattern, vertex_map_length
from hilbrace.pattern.inputs import check_cells, check_design, resolution
from hilbrace.pattern.level import Levelled, levelled
from hilbrace.pattern.mend import Mended, mended
from hilbrace.pattern.offset import offset_volume, safe_offset
from hilbrace.pattern.pattern import Pattern, Solid
from hilbrace.pattern.refine import RefinedSkin, refine
from hilbrace.pattern.thicken import border_edges, folded_triangles, manifold, simplify, surface, thicken

Array = np.ndarray

REPAIR_TOLERANCE = 0.01
"""Relative difference from the design's share of the skin above which repairs are made up for [-]."""
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
        ConfigError: The cells do not fit on the brace, or the struts not in the cells.
        InputError: The design holds values that are no numbers.
        GeometryError: The struts do not hang together.
    """
    check_design(domain, design)
    material = material or MaterialSettings.model_validate({})
    cells = load_microstructures(material.soft, material.firm)
    check_cells(domain, design, cells, settings, vertex_map_length(domain))
    skin = refine(domain, resolution(settings))
    areas = triangle_areas(skin.vertices, skin.triangles)
    blended = blended_pattern(domain, design, skin, settings, material)
    level, done = _to_share(skin, blended, areas, design_fraction(domain, design), settings)
    struts, lands = cut_out(skin, done.line), lands_beside(skin, done.line)
    places = places_on(domain, struts.vertices)
    return Pattern(
        vertices=struts.vertices,
        normals=struts.normals,
        triangles=struts.triangles,
        d=places.value(domain.cut_triangles, design.d_vertex),
        firm=places.value(domain.triangles, design.firm_vertex),
        strut_width_mm=local_widths(strut_axis(skin, done.line), struts.vertices),
        strut_width_min_mm=done.strut_mm,
        strut_width_median_mm=float(np.median(strut_widths(done.edge, _REACH * settings.min_strut_mm))),
        slit_width_min_mm=done.slit_mm,
        islands_dropped=level.islands + done.islands,
        area_fraction=float(triangle_areas(struts.vertices, struts.triangles).sum() / areas.sum()),
        level_shift=level.shift,
        land_vertices=lands.vertices,
        land_triangles=lands.triangles,
    )


def _to_share(
    skin: RefinedSkin,
    blended: BlendedPattern,
    areas: Float[Array, " triangle"],
    share: float,
    settings: PatternSettings,
) -> tuple[Levelled, Mended]:
    """Level and mend; where repairs add too much, level again for as much less. The better of the two."""
    found, aim = [], share
    while len(found) < 2:
        level = levelled(skin, blended, areas, aim, settings)
        done = mended(
            skin, level.depth, blended.rim_depth, areas, settings.min_strut_mm, settings.min_slit_mm
        )
        error = solid_fraction(skin, done.line.depth, areas) - share
        found.append((abs(error), level, done))
        if abs(error) <= REPAIR_TOLERANCE * share:
            break
        aim -= error
    _, level, done = min(found, key=lambda one: one[0])
    return level, done


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
    offset = safe_offset(domain, thickness)
    places = places_on(domain, pattern.vertices)
    vector = places.value(domain.triangles, offset.vector)
    reach = np.linalg.norm(vector, axis=1)
    direction = vector / reach[:, None]
    local = places.value(domain.triangles, offset.thickness)
    points, faces = thicken(pattern.vertices, direction, pattern.triangles, reach)
    body = simplify(manifold(points, faces), settings.simplify_mm)
    vertices, triangles = surface(body)
    known = nearest_values(vertices, points) % len(pattern.vertices)
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
        expected_volume_mm3=offset_volume(domain, offset, _filled(design)),
        thickness_p01_mm=float(np.percentile(_along_rays(body, pattern, direction, thickness), 1)),
        thickness_min_mm=float(local.min()),
        folded_triangles=folded_triangles(pattern.vertices, direction, pattern.triangles, reach),
        d=pattern.d[known],
        label=(pattern.firm[known] > 0.5).astype(float),
        strut_width_mm=pattern.strut_width_mm[known],
        local_thickness_mm=local[known],
    )


def design_fraction(domain: Domain, design: Design) -> float:
    """Share of the skin that the design fills, bands included [-]."""
    areas = triangle_areas(domain.vertices, domain.triangles)
    return float((areas * _filled(design)).sum() / areas.sum())


def expected_volume(domain: Domain, design: Design, thickness_mm: float) -> float:
    """Area of the mid-surface times volume fraction times thickness, summed over the domain [mm^3]."""
    return offset_volume(domain, safe_offset(domain, thickness_mm), _filled(design))


def _along_rays(
    body: manifold3d.Manifold, pattern: Pattern, direction: Float[Array, "vertex 3"], thickness_mm: float
) -> Float[Array, " ray"]:
    """Thickness measured along rays through a sample of the inner face, its border left out [mm]."""
    on_border = np.isin(pattern.triangles, border_edges(pattern.triangles)).any(axis=1)
    corners = pattern.triangles[~on_border]
    corners = corners[spread_sample(len(corners), _RAYS)]
    towards = direction[corners].mean(axis=1)
    return measured_thickness(body, pattern.vertices[corners].mean(axis=1), towards, 2 * thickness_mm)


def _filled(design: Design) -> Float[Array, " triangle"]:
    return np.where(design.rim, 1.0, design.volume_fraction_triangle)
