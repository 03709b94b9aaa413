"""A free seam is stitched; a periodic one has nothing to stitch and is exact from either side."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from hilbrace.config import MaterialSettings, PatternSettings
from hilbrace.domain.flatten import lscm
from hilbrace.domain.limb import Surface
from hilbrace.domain.seam import cut_along
from hilbrace.material.cells import cell_distance, fold
from hilbrace.material.strut_width import effective_scale
from hilbrace.pattern.clip import zero_line
from hilbrace.pattern.implicit import band_depth, blended_pattern
from hilbrace.pattern.level import levelled
from hilbrace.pattern.refine import refine
from hilbrace.pattern.stitch import flat_values
from tests.unit.elbow import elbow_domain
from tests.unit.sleeve import sleeve_design, sleeve_domain

SETTINGS = PatternSettings(scale=0.1, min_strut_mm=2.5)
MATERIAL = MaterialSettings()
PERIODIC = sleeve_domain(around=40, along=16, height_mm=110.0)
FREE = sleeve_domain(around=40, along=16, height_mm=110.0, flatten="lscm")


def seam_values(domain, side, values):
    """A quantity of the cut mesh at 9 places on each edge of one copy of the seam."""
    copy = domain.seam_pairs[:, side]
    t = np.linspace(0, 1, 10)[:-1, None]
    return np.concatenate([(1 - t) * values[a] + t * values[b] for a, b in pairwise(copy)])


@pytest.mark.parametrize("cell", ["voronoi_open", "sinusoidal", "honeycomb", "reentrant"])
@pytest.mark.parametrize("domain", [PERIODIC, elbow_domain(25.0)])
def test_both_copies_of_a_periodic_seam_carry_the_same_pattern(domain, cell):
    scale = effective_scale(SETTINGS.scale, domain.period_u)
    left, right = (
        cell_distance(cell, *(fold(seam_values(domain, side, domain.uv)[:, k], scale) for k in range(2)))
        for side in range(2)
    )
    assert left == pytest.approx(right, abs=1e-6)
    assert np.ptp(left) > 0.1


def test_a_periodic_map_is_left_as_it_is():
    skin = refine(PERIODIC, 3.0)
    value = PERIODIC.uv[:, 1] ** 2
    flat = flat_values(PERIODIC, skin, value, 3.0)
    assert np.array_equal(flat.value, skin.from_vertices(PERIODIC.cut_triangles, value))
    assert np.isneginf(flat.strip_depth).all()


def test_strip_runs_along_the_seam_with_its_width():
    skin = refine(FREE, 1.2)
    flat = flat_values(FREE, skin, FREE.uv[:, 0], 4.0)
    seam = FREE.vertices[FREE.weld[FREE.seam_pairs[:, 0]]]
    y = np.clip(skin.vertices[:, 1], seam[:, 1].min(), seam[:, 1].max())
    order = np.argsort(seam[:, 1])
    on = np.stack([np.interp(y, seam[order, 1], seam[order, k]) for k in (0, 2)], axis=1)
    away = np.linalg.norm(skin.vertices[:, [0, 2]] - on, axis=1)
    inside = flat.strip_depth > 0
    assert inside.any()
    assert away[inside].max() < 2.3
    assert (away[~inside]).min() > 1.7


def test_beyond_a_seam_that_zigzags_the_map_goes_on_smoothly():
    """A map cut along a zigzag is stitched along the smooth line: what crosses takes the other copy's map."""
    domain = _with_zigzag_seam(elbow_domain(25.0))
    skin = refine(domain, 1.5)
    height = domain.vertices[domain.weld][:, 1]
    flat = flat_values(domain, skin, height, 3.0)
    plain = skin.from_vertices(domain.cut_triangles, height)
    # heights agree on both copies, so changing sides must not change them
    assert flat.value == pytest.approx(plain, abs=1e-9)
    moved = np.flatnonzero(np.abs(flat.uv - _plain_uv(domain, skin)).sum(axis=1) > 1e-9)
    assert len(moved) > 50
    # neighbours on one side of the strip now have neighbouring coordinates
    outside = flat.strip_depth < 0
    ends = skin.edges[outside[skin.edges].all(axis=1)]
    step = np.linalg.norm(flat.uv[ends[:, 0]] - flat.uv[ends[:, 1]], axis=1)
    before = _plain_uv(domain, skin)
    jump = np.linalg.norm(before[ends[:, 0]] - before[ends[:, 1]], axis=1)
    assert jump.max() > 0.3
    assert step.max() < 4 * np.median(step)


def _plain_uv(domain, skin):
    return np.stack([skin.from_vertices(domain.cut_triangles, domain.uv[:, k]) for k in range(2)], axis=1)


def _with_zigzag_seam(domain):
    """The sleeve opened along a path that changes column in every row, with a free map."""
    around = len(domain.upper_loop)
    rows = len(domain.vertices) // around
    path = [0]
    for row in range(1, rows - 1):
        step = [row * around, row * around + 1]
        path += step if row % 2 else step[::-1]
    path.append(path[-1] + around)
    cut = cut_along(Surface(domain.vertices, domain.triangles), np.array(path))
    middle = [row * around + around // 2 for row in (0, rows - 1)]
    pins = [int(np.flatnonzero(cut.weld == vertex)[0]) for vertex in middle]
    return dataclasses.replace(
        domain,
        cut_triangles=cut.triangles,
        weld=cut.weld,
        uv=lscm(domain.vertices, cut, (pins[0], pins[1])).uv,
        seam_pairs=cut.pairs,
        flatten="lscm",
        period_u=0.0,
    )


def test_both_sides_of_a_free_seam_hold_to_the_strip():
    """With the strip no hole crosses the seam, without it many would."""
    design = sleeve_design(FREE, SETTINGS, d=0.5, firm=1.0)
    skin = refine(FREE, 1.375)
    blended = blended_pattern(FREE, design, skin, SETTINGS, MATERIAL)
    strip = flat_values(FREE, skin, design.width_vertex, SETTINGS.seam_mm).strip_depth
    areas = np.full(len(skin.triangles), 1.0)
    level = levelled(skin, blended, areas, 0.45, SETTINGS)
    assert (level.depth[strip > 0] > 0).all()
    assert (zero_line(skin, level.depth).depth[strip > 0.1] > 0).all()


def test_bands_have_the_widths_that_the_domain_gives_them():
    domain = dataclasses.replace(FREE, rims=np.array([12.0, np.nan]))
    skin = refine(domain, 2.0)
    depth = band_depth(domain, skin, 6.0)
    away = 55.0 - np.abs(skin.vertices[:, 1])
    for side, width in ((1, 12.0), (-1, 6.0)):
        near = (side * skin.vertices[:, 1] > 0) & (away < 20.0)
        # skin runs aslant to the ends, so that ways along it are longer
        assert (depth[near] <= width - away[near] + 0.1).all()
        assert np.median(depth[near] - width + away[near]) > -1.5
        assert depth[near].max() == pytest.approx(width, abs=0.1)
