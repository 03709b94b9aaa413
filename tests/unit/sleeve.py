"""A knee-like sleeve with a flat map, a flexing motion and a design: a stand-in for the stages before."""

from __future__ import annotations

import numpy as np

from hilbrace.config import PatternSettings
from hilbrace.domain.deformation import deformation_gradients
from hilbrace.domain.domain import Domain
from hilbrace.domain.flatten import lscm, periodic_lscm, quasi_conformal
from hilbrace.domain.rim import rim_band
from hilbrace.domain.seam import Cut
from hilbrace.material.blending import blend_map
from hilbrace.material.curves import load_microstructures
from hilbrace.material.strut_width import cell_scale, map_length, minimum_width
from hilbrace.optimize.design import LOSSES, Design
from hilbrace.optimize.history import TRACE

CELLS = load_microstructures("sinusoidal", "voronoi_open")


def sleeve_domain(
    around: int = 60, along: int = 33, height_mm: float = 240.0, flatten: str = "periodic"
) -> Domain:
    """Limb-like annulus: bent axis, waist, a knee cap; y up, outward triangles, seam at the back column."""
    rows = along + 1
    t = np.arange(around + 1) / around * 2 * np.pi
    turn, y = np.meshgrid(t, np.linspace(-height_mm / 2, height_mm / 2, rows), indexing="ij")
    h = y / height_mm + 0.5
    radius = 58 + 18 * (2 * h - 1) ** 2 * np.where(h > 0.5, 1, 0.35)
    radius = radius + 5 * np.exp(-(((h - 0.5) / 0.15) ** 2)) * np.cos(turn - np.pi) ** 4 * (np.cos(turn) < 0)
    points = np.stack(
        [
            radius * np.sin(turn - np.pi / 2) + 14 * np.sin(np.pi * h),
            y,
            0.93 * radius * np.cos(turn - np.pi / 2),
        ],
        -1,
    )
    cut_vertices = points.reshape(-1, 3)
    cut_triangles = _grid_triangles(around, along)
    count = around * rows
    weld = np.arange((around + 1) * rows) % count
    first, last = np.arange(rows), np.arange(rows) + count
    cut = Cut(cut_triangles, weld, np.stack([first, last], axis=1))
    vertices, triangles = cut_vertices[:count], weld[cut_triangles]
    middle = around // 2 * rows
    flat = (
        periodic_lscm(vertices, cut)
        if flatten == "periodic"
        else lscm(vertices, cut, (middle, middle + along))
    )
    posed = np.stack([_flexed(vertices, np.radians(a)) for a in np.linspace(0, 70, 8)])
    return Domain(
        joint="knee_l",
        vertices=vertices,
        triangles=triangles,
        upper_loop=np.arange(around) * rows + along,
        lower_loop=np.arange(around) * rows,
        cut_triangles=cut_triangles,
        weld=weld,
        uv=flat.uv,
        seam_pairs=cut.pairs,
        flatten=flatten,
        period_u=flat.period_u,
        time=np.arange(len(posed)) / 15.0,
        posed=posed,
        deformation=deformation_gradients(vertices, posed, triangles),
        quasi_conformal=quasi_conformal(vertices[weld], flat.uv, cut_triangles),
    )


def sleeve_design(
    domain: Domain,
    settings: PatternSettings,
    d: np.ndarray | float | None = None,
    firm: np.ndarray | float | None = None,
) -> Design:
    """A design on the sleeve: d per cut vertex and firm fraction per vertex, or smooth built-in ones."""
    vertices, y = domain.vertices, domain.vertices[:, 1]
    if firm is None:
        above = y[domain.triangles].mean(axis=1) > 0.15 * np.ptp(y) / 2
        firm_vertex, _ = blend_map(vertices, domain.triangles, above, settings.blend_mm)
    else:
        firm_vertex = np.broadcast_to(np.asarray(firm, float), len(vertices)).copy()
    if d is None:
        turn = 2 * np.pi * domain.uv[:, 0] / (domain.period_u or 1.0)
        d = 0.55 + 0.35 * np.cos(turn) * np.cos(np.pi * domain.uv[:, 1] / np.ptp(domain.uv[:, 1]))
    d_vertex = np.broadcast_to(np.asarray(d, float), len(domain.uv))
    firm_cut = firm_vertex[domain.weld]
    scale = cell_scale(settings, domain)
    length = map_length(vertices, domain.triangles, domain.uv, domain.cut_triangles)
    at_vertex = np.bincount(domain.triangles.ravel(), np.repeat(length, 3)) / np.bincount(
        domain.triangles.ravel()
    )
    least = minimum_width(settings.min_strut_mm, scale, at_vertex[domain.weld])
    width = np.maximum(CELLS.width(d_vertex, firm_cut), least)
    d_vertex = np.asarray(CELLS.design_variable(width, firm_cut))
    rim = rim_band(domain, settings.rim_mm).triangles
    mean = lambda x: x[domain.cut_triangles].mean(axis=1)  # noqa: E731
    firm_triangle = firm_vertex[domain.triangles].mean(axis=1)
    volume = np.where(rim, 1.0, CELLS.volume(mean(d_vertex), firm_triangle))
    p = vertices[domain.triangles]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    empty = np.zeros(3)
    return Design(
        seed=0,
        iterations=0,
        solver="scipy",
        shapes=1,
        parameters=np.zeros((1, 1)),
        d_triangle=mean(d_vertex),
        d_vertex=d_vertex,
        width_triangle=mean(width),
        width_vertex=width,
        youngs_modulus=np.where(rim, 1.0, CELLS.modulus(mean(d_vertex), firm_triangle)),
        volume_fraction_triangle=volume,
        firm_triangle=firm_triangle,
        firm_vertex=firm_vertex,
        rim=rim,
        energy_density=np.zeros(len(area)),
        pulls=np.zeros((len(LOSSES), len(area))),
        history=np.zeros((0, len(LOSSES) + 1)),
        trace=np.zeros((0, len(TRACE))),
        film=np.zeros((0, len(d_vertex)), dtype=np.uint8),
        film_iterations=np.zeros(0, dtype=np.int64),
        losses_initial=np.zeros(len(LOSSES)),
        losses_final=np.zeros(len(LOSSES)),
        stiffness=empty,
        stiffness_uniform=empty,
        stiffness_flexions=np.zeros(0),
        stiffness_posed=np.zeros((0, 3)),
        stiffness_posed_uniform=np.zeros((0, 3)),
        stiffness_by_energy=0.0,
        moment_flexions=np.zeros(0),
        moment_held=np.zeros((2, 0)),
        moment_free=np.zeros((2, 0)),
        coupling="stiffness",
        angle_changes=np.zeros((2, 0, 3)),
        contact_force_change=np.zeros((2, 0, 3)),
        contact_moment_change=np.zeros((2, 0, 3)),
        passive_levels=np.zeros(0),
        passive_sensitivity=np.zeros((0, 2, 3)),
        reaction_upper=np.zeros((0, 3)),
        reaction_lower=np.zeros((0, 3)),
        volume_fraction=float((volume * area).sum() / area.sum()),
        volume_fraction_uniform=0.4,
    )


def _grid_triangles(around: int, along: int) -> np.ndarray:
    a, b = (x.ravel() for x in np.meshgrid(np.arange(around), np.arange(along), indexing="ij"))
    corner = np.stack(
        [
            a * (along + 1) + b,
            (a + 1) * (along + 1) + b,
            (a + 1) * (along + 1) + b + 1,
            a * (along + 1) + b + 1,
        ],
        1,
    )
    even = ((a + b) % 2 == 0)[:, None, None]
    return np.where(even, corner[:, [[0, 1, 3], [1, 2, 3]]], corner[:, [[0, 1, 2], [0, 2, 3]]]).reshape(-1, 3)


def _flexed(vertices: np.ndarray, angle: float) -> np.ndarray:
    """Bend the lower half backwards about the z axis, weights smooth across the middle."""
    weight = 1 / (1 + np.exp(vertices[:, 1] / 20.0))[:, None]
    c, s = np.cos(-angle), np.sin(-angle)
    turned = vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return (1 - weight) * vertices + weight * turned
