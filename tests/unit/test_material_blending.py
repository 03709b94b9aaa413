"""The band between firm and soft against straight borders; blended curves against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.material.blending import blend_map, ironed
from hilbrace.material.curves import load_microstructures
from hilbrace.pattern.clip import triangle_areas
from tests.unit.sleeve import sleeve_domain

SLEEVE = sleeve_domain(around=40, along=24)
CENTRES = SLEEVE.vertices[SLEEVE.triangles].mean(axis=1)


def strip(length=120.0, width=20.0, step=2.0):
    x, y = np.meshgrid(np.arange(0, length + step, step), np.arange(0, width + step, step), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    rows = x.shape[1]
    a = (np.arange(x.shape[0] - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([a, a + rows, a + rows + 1], 1), np.stack([a, a + rows + 1, a + 1], 1)]
    )
    return vertices, triangles


@pytest.mark.parametrize("width", [10.0, 20.0, 45.0])
def test_the_band_is_as_wide_as_asked_and_climbs_by_the_smoothstep(width):
    vertices, triangles = strip()
    firm = vertices[triangles].mean(axis=1)[:, 0] > 60
    at_vertex, at_triangle = blend_map(vertices, triangles, firm, width)
    x = np.clip(0.5 + (vertices[:, 0] - 60) / width, 0, 1)
    assert at_vertex == pytest.approx(3 * x**2 - 2 * x**3, abs=0.3 / width + 0.01)
    away = np.abs(vertices[:, 0] - 60)
    assert (at_vertex[(away > width / 2 + 0.5) & (vertices[:, 0] > 60)] == 1).all()
    assert (at_vertex[(away > width / 2 + 0.5) & (vertices[:, 0] < 60)] == 0).all()
    inside = (at_vertex > 0) & (at_vertex < 1)
    assert np.ptp(vertices[inside, 0]) == pytest.approx(width, abs=4.1)
    assert at_triangle == pytest.approx(at_vertex[triangles].mean(axis=1))


@pytest.mark.parametrize("width", [20.0, 30.0])
def test_a_jagged_border_gives_an_even_band(width):
    vertices, triangles = strip(width=60.0)
    rng = np.random.default_rng(0)
    centre = vertices[triangles].mean(axis=1)
    firm = centre[:, 0] + rng.uniform(-2, 2, len(centre)) > 60
    at_vertex, _ = blend_map(vertices, triangles, firm, width)
    x = np.clip(0.5 + (vertices[:, 0] - 60) / width, 0, 1)
    assert np.abs(at_vertex - (3 * x**2 - 2 * x**3)).max() < 0.2
    assert np.abs(at_vertex - (3 * x**2 - 2 * x**3)).mean() < 0.02


def test_the_band_around_the_limb_has_its_area():
    firm = CENTRES[:, 1] > 0
    areas = triangle_areas(SLEEVE.vertices, SLEEVE.triangles)
    _, at_triangle = blend_map(SLEEVE.vertices, SLEEVE.triangles, firm, 40.0)
    ring = SLEEVE.vertices[np.abs(SLEEVE.vertices[:, 1]) < 3.0]
    girth = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).sum()
    band = areas[(at_triangle > 0) & (at_triangle < 1)].sum()
    assert band == pytest.approx(girth * 40.0, rel=0.25)
    assert (areas * at_triangle).sum() == pytest.approx((areas * firm).sum(), rel=0.02)


def test_values_stay_between_zero_and_one_on_skewed_triangles():
    rng = np.random.default_rng(4)
    vertices = SLEEVE.vertices * [1, 0.2, 1] + rng.normal(0, 0.5, SLEEVE.vertices.shape)
    smooth = ironed(vertices, SLEEVE.triangles, CENTRES[:, 1] > 0, 6.0)
    assert 0 <= smooth.min() < smooth.max() <= 1


@pytest.mark.parametrize("label", [True, False])
def test_without_a_border_all_is_pure(label):
    fraction, _ = blend_map(SLEEVE.vertices, SLEEVE.triangles, np.full(len(CENTRES), label), 15.0)
    assert (fraction == float(label)).all()


def test_ironing_follows_the_exponential_of_its_equation():
    vertices, triangles = strip()
    firm = vertices[triangles].mean(axis=1)[:, 0] > 60
    smooth = ironed(vertices, triangles, firm, 7.0)
    away = vertices[:, 0] - 60
    exact = np.where(away < 0, np.exp(away / 7.0) / 2, 1 - np.exp(-away / 7.0) / 2)
    assert smooth == pytest.approx(exact, abs=0.03)


@given(st.floats(0.05, 0.95), st.floats(0.0, 1.0))
def test_blended_modulus_and_volume_have_the_slopes_of_finite_differences(d, firm):
    cells = load_microstructures("sinusoidal", "voronoi_open")
    step = 1e-6
    for curve in (cells.modulus, cells.volume, cells.width):
        variable = torch.tensor([d, firm], dtype=torch.float64, requires_grad=True)
        (slope,) = torch.autograd.grad(curve(variable[0], variable[1]), variable)
        by_d = (curve(d + step, firm) - curve(d - step, firm)) / (2 * step)
        by_firm = (curve(d, firm + step) - curve(d, firm - step)) / (2 * step)
        assert slope.numpy() == pytest.approx([by_d, by_firm], rel=1e-6, abs=1e-8)


@given(st.floats(0.0, 1.0))
def test_blended_values_are_the_pure_ones_at_the_ends_and_between_them_inside(d):
    cells = load_microstructures("sinusoidal", "voronoi_open")
    for name in ("modulus", "volume"):
        blended, soft, firm = (getattr(one, name) for one in (cells, cells.soft, cells.firm))
        assert blended(d, 0.0) == soft(d)
        assert blended(d, 1.0) == firm(d)
        assert min(soft(d), firm(d)) <= blended(d, 0.4) <= max(soft(d), firm(d))
