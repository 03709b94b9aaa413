"""Random designs on a domain: fields, segmentations, cells and sizes that a user could ask for."""

from __future__ import annotations

import dataclasses

import numpy as np

from hilbrace.config import MaterialSettings, PatternSettings
from hilbrace.domain.domain import Domain
from hilbrace.material.blending import blend_map
from hilbrace.material.curves import load_microstructures
from hilbrace.material.strut_width import cell_scale, maximum_width, minimum_width
from hilbrace.optimize.design import Design
from hilbrace.pattern.implicit import vertex_map_length
from tests.unit.sleeve import sleeve_design


def random_task(
    seed: int,
    domain: Domain,
    cells: tuple[str, ...] = ("voronoi_open", "sinusoidal"),
    struts: tuple[float, float] = (1.8, 3.2),
) -> tuple[PatternSettings, MaterialSettings, Design]:
    """Settings and a design, all drawn from one seed; widths stay where the optimizer keeps them."""
    rng = np.random.default_rng(seed)
    strut = rng.uniform(*struts)
    slit = strut * rng.uniform(0.5, 0.9)
    soft, firm_cell = (str(name) for name in rng.choice(cells, 2, replace=False))
    typical = float(np.median(vertex_map_length(domain)))
    settings = PatternSettings(
        scale=float(
            np.clip(rng.uniform(1.0, 1.5) * _fitting(soft, firm_cell, strut, slit) / typical, 0.03, 0.4)
        ),
        min_strut_mm=strut,
        min_slit_mm=slit,
        rim_mm=rng.uniform(4.0, 12.0),
        blend_mm=rng.uniform(8.0, 40.0),
        seam_mm=rng.uniform(1.0, 5.0),
        resolution_mm=0.55 * strut,
    )
    material = MaterialSettings(thickness_mm=rng.uniform(2.0, 5.0), soft=soft, firm=firm_cell)
    long = float(np.ptp(domain.vertices[:, 1]))
    labels = _waves(rng, domain.vertices, long)
    if rng.random() < 0.25:
        firm = np.full(len(labels), float(rng.integers(2)))
    else:
        cut = np.quantile(labels, rng.uniform(0.2, 0.8))
        firm, _ = blend_map(
            domain.vertices, domain.triangles, labels[domain.triangles].mean(axis=1) > cut, settings.blend_mm
        )
    field = _waves(rng, domain.vertices, 0.7 * long)
    low, high = np.sort(rng.uniform(0.0, 1.0, 2))
    field = low + (high - low) * (field - field.min()) / np.ptp(field)
    return settings, material, feasible_design(domain, settings, material, field, firm)


def _fitting(soft: str, firm: str, strut_mm: float, slit_mm: float) -> float:
    """Period [mm] of cells in which the least struts leave room for slits and for the design."""
    cells = load_microstructures(soft, firm)
    least = [strut_mm / curves.width(0.35) for curves in (cells.soft, cells.firm)]
    slits = [1.3 * (strut_mm + slit_mm) / curves.pinch_width for curves in (cells.soft, cells.firm)]
    return float(max(least + slits))


def feasible_design(
    domain: Domain,
    settings: PatternSettings,
    material: MaterialSettings,
    field: np.ndarray,
    firm: np.ndarray,
) -> Design:
    """A design whose struts and slits are wide enough by the curves; ``field`` is 0 to 1 in between."""
    cells = load_microstructures(material.soft, material.firm)
    length = vertex_map_length(domain)
    scale = cell_scale(settings, domain)
    low = cells.design_variable(minimum_width(settings.min_strut_mm, scale, length), firm).clip(0.0, 0.9)
    high = maximum_width(cells.pinch_width(firm), settings.min_slit_mm, scale, length)
    high = np.maximum(cells.design_variable(high, firm).clip(max=1.0), low + 0.1)
    d = low + (high - low) * field
    width = cells.width(d, firm)
    base = sleeve_design(domain, settings, d=0.5, firm=firm)
    corners = domain.triangles
    d_triangle, firm_triangle = d[corners].mean(axis=1), firm[corners].mean(axis=1)
    return dataclasses.replace(
        base,
        d_vertex=d[domain.weld],
        d_triangle=d_triangle,
        width_vertex=width[domain.weld],
        width_triangle=width[corners].mean(axis=1),
        firm_triangle=firm_triangle,
        volume_fraction_triangle=np.where(base.rim, 1.0, cells.volume(d_triangle, firm_triangle)),
    )


def _waves(rng: np.random.Generator, points: np.ndarray, longest: float) -> np.ndarray:
    total = np.zeros(len(points))
    for _ in range(4):
        wave = rng.normal(size=3)
        wave *= 2 * np.pi / (longest * rng.uniform(0.4, 1.5)) / np.linalg.norm(wave)
        total += rng.normal() * np.cos(points @ wave + rng.uniform(0, 2 * np.pi))
    return total
