from __future__ import annotations

import igl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.domain.flatten import (
    FlatMap,
    check_flips,
    lscm,
    map_gradients,
    mirrored,
    periodic_lscm,
    quasi_conformal,
)
from hilbrace.domain.limb import Surface
from hilbrace.domain.loops import loops_of
from hilbrace.domain.seam import cut_along, find_seam
from hilbrace.errors import GeometryError
from tests.unit.domain_body import sleeve, upright_limb


def opened(low, high, height=240.0, around=24, along=12, azimuth=180.0):
    surface = Surface(*sleeve(low, high, height, around, along))
    loops = loops_of(surface, upright_limb())
    upper, lower = loops.upper, loops.lower
    cut = cut_along(surface, find_seam(surface, upright_limb(), loops, azimuth))
    front = [
        int(np.argmax(cut.weld == loop[np.argmax(surface.vertices[loop, 0])])) for loop in (lower, upper)
    ]
    return surface, cut, (front[0], front[1])


def lengths(points, triangles):
    corner = points[triangles]
    return np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=-1)


@settings(max_examples=15, deadline=None)
@given(low=st.floats(30.0, 90.0), high=st.floats(30.0, 90.0))
def test_lscm_unrolls_cones_and_cylinders_without_strain(low, high):
    """Both are developable: the flat map is isometric up to one scale."""
    surface, cut, pins = opened(low, high)
    flat = lscm(surface.vertices, cut, pins)
    scale = lengths(flat.uv, cut.triangles) / lengths(surface.vertices, surface.triangles)
    assert np.allclose(scale, scale.mean(), rtol=1e-7)
    ratio = quasi_conformal(surface.vertices[cut.weld], flat.uv, cut.triangles)
    assert np.allclose(ratio, 1.0, atol=1e-7)
    assert flat.period_u == 0.0


def test_periodic_map_of_a_cylinder_is_its_development():
    surface, cut, _ = opened(60.0, 60.0)
    flat = periodic_lscm(surface.vertices, cut)
    perimeter = 24 * 2.0 * 60.0 * np.sin(np.pi / 24)
    assert np.isclose(flat.period_u, 1.0)
    assert np.isclose(np.ptp(flat.uv[:, 1]), 240.0 / perimeter, rtol=1e-9)
    ratio = quasi_conformal(surface.vertices[cut.weld], flat.uv, cut.triangles)
    assert np.allclose(ratio, 1.0, atol=1e-8)


def test_periodic_map_of_a_cone_has_the_cones_conformal_modulus():
    """A developed cone is an annulus sector; its logarithm is a rectangle ln(r2/r1) by the sector's angle."""
    low, high, height = 50.0, 80.0, 240.0
    slope = (high - low) / np.hypot(height, high - low)
    errors = []
    for around, along in ((24, 12), (96, 48)):
        angle = around * 2.0 * np.arcsin(np.sin(np.pi / around) * slope)
        surface, cut, _ = opened(low, high, height, around, along)
        flat = periodic_lscm(surface.vertices, cut)
        errors.append(abs(np.ptp(flat.uv[:, 1]) / flat.period_u / (np.log(high / low) / angle) - 1.0))
    assert errors[1] < 1e-3
    assert errors[1] < errors[0] / 3.0


@settings(max_examples=15, deadline=None)
@given(low=st.floats(30.0, 90.0), high=st.floats(30.0, 90.0), azimuth=st.floats(0.0, 360.0))
def test_periodic_map_closes_exactly(low, high, azimuth):
    surface, cut, _ = opened(low, high, azimuth=azimuth)
    flat = periodic_lscm(surface.vertices, cut)
    for one in (flat, mirrored(flat)):
        left, right = cut.pairs.T if one is flat else cut.pairs[:, ::-1].T
        jump = one.uv[right] - one.uv[left]
        assert (jump[:, 0] == flat.period_u).all()
        assert (jump[:, 1] == 0.0).all()
        assert one.uv.min() == 0.0
        assert 1.0 - 1e-9 < one.uv.max() <= 1.0


def test_lscm_is_the_one_of_libigl():
    surface, cut, pins = opened(50.0, 80.0)
    bump = surface.vertices * (1.0 + 0.1 * np.sin(surface.vertices[:, 1:2] / 30.0) * [1, 0, 1])
    flat = lscm(bump, cut, pins)
    reference, _ = igl.lscm(bump[cut.weld], cut.triangles, np.array(pins), np.array([[0.0, 0.0], [0.0, 1.0]]))
    reference = np.asarray(reference)
    reference = (reference - reference.min(axis=0)) / np.ptp(reference, axis=0).max()
    assert np.allclose(flat.uv, reference, atol=1e-7)


def test_u_grows_to_the_right_and_v_upwards_seen_from_outside():
    surface, cut, pins = opened(50.0, 80.0)
    for flat in (lscm(surface.vertices, cut, pins), periodic_lscm(surface.vertices, cut)):
        assert (np.linalg.det(map_gradients(surface.vertices[cut.weld], flat.uv, cut.triangles)) > 0.0).all()
        height = surface.vertices[cut.weld, 1]
        assert np.corrcoef(height, flat.uv[:, 1])[0, 1] > 0.95
        front = surface.vertices[cut.weld, 0] > 30.0
        assert np.corrcoef(surface.vertices[cut.weld, 2][front], flat.uv[front, 0])[0, 1] < -0.95
        assert (flat.uv[cut.pairs[:, 0], 0] < 0.3).all()
        assert (flat.uv[cut.pairs[:, 1], 0] > 0.7).all()


def test_turned_triangles_are_counted():
    surface, cut, pins = opened(50.0, 80.0)
    uv = lscm(surface.vertices, cut, pins).uv.copy()
    check_flips(surface.vertices[cut.weld], uv, cut.triangles)
    inner = int(np.argmin(np.abs(uv - 0.5).sum(axis=1)))
    uv[inner] += 0.5
    with pytest.raises(GeometryError, match=r"turns \d triangles over"):
        check_flips(surface.vertices[cut.weld], uv, cut.triangles)


def test_mirroring_twice_changes_nothing():
    flat = FlatMap(np.array([[0.0, 0.0], [1.0, 0.25], [0.25, 0.75]]), 0.75)
    assert np.array_equal(mirrored(mirrored(flat)).uv, flat.uv)
