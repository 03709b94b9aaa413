from __future__ import annotations

import igl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.config import DomainSettings
from hilbrace.domain.build import build_domain
from hilbrace.domain.deformation import folded
from hilbrace.domain.domain import Domain
from hilbrace.domain.limb import Surface
from hilbrace.domain.remesh import mesh_quality
from hilbrace.domain.rim import rim_band
from hilbrace.run.records import load, pack, save
from tests.unit.domain_body import LEFT, bending, mirrored_body, outwardness, synthetic_body

FLEXION = np.linspace(0.0, 110.0, 12)


def domain_of(**settings_of):
    wanted = DomainSettings(**settings_of)
    body = synthetic_body()
    return build_domain(
        body, bending(body, FLEXION, wanted.side), wanted.model_copy(update={"frames_per_second": 100.0})
    )


@pytest.fixture(scope="module")
def default():
    return domain_of()


def check_domain(domain, wanted):
    surface = Surface(domain.vertices, domain.triangles)
    quality = mesh_quality(surface)
    assert abs(quality.triangles / wanted.triangles - 1.0) <= 0.03
    assert quality.min_angle_deg >= 20.0
    assert igl.euler_characteristic(domain.triangles) == 0
    assert outwardness(domain.vertices, domain.triangles) > 0.99
    upper, lower = domain.vertices[domain.upper_loop], domain.vertices[domain.lower_loop]
    assert upper[:, 1].min() > 0.0 > lower[:, 1].max()
    assert np.array_equal(domain.weld[domain.cut_triangles], domain.triangles)
    seam = domain.weld[domain.seam_pairs]
    assert np.array_equal(seam[:, 0], seam[:, 1])
    assert seam[0, 0] == domain.lower_loop[0]
    assert seam[-1, 0] == domain.upper_loop[0]
    assert domain.uv.min() == 0.0
    assert domain.uv.max() <= 1.0
    jump = np.diff(domain.uv[domain.seam_pairs], axis=1)[:, 0]
    if wanted.flatten == "periodic":
        assert (jump == [domain.period_u, 0.0]).all()
    else:
        assert (jump[:, 0] > 0.3).all()
        assert domain.period_u == 0.0
    uv = domain.uv[domain.cut_triangles]
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    assert (first[:, 0] * second[:, 1] > first[:, 1] * second[:, 0]).all()


@settings(max_examples=15, deadline=None)
@given(
    above=st.floats(0.2, 0.6),
    below=st.floats(0.2, 0.6),
    side=st.sampled_from(["left", "right"]),
    triangles=st.integers(500, 3000),
    seam_azimuth_deg=st.floats(-180.0, 360.0),
    flatten=st.sampled_from(["lscm", "periodic"]),
)
def test_every_setting_gives_a_sound_domain(**settings_of):
    wanted = DomainSettings(**settings_of)
    check_domain(domain_of(**settings_of), wanted)


@pytest.mark.parametrize(("flatten", "mean"), [("lscm", 1.010), ("periodic", 1.020)])
def test_the_default_domain_is_as_even_and_conformal_as_measured(flatten, mean):
    """Figures of the note on the domain (4000 triangles, 40 % thigh to 38 % shank)."""
    domain = domain_of(flatten=flatten)
    check_domain(domain, DomainSettings(flatten=flatten))
    assert domain.quasi_conformal.mean() <= mean
    assert domain.quasi_conformal.max() < 1.05


def test_the_loops_run_from_the_seam_the_way_that_u_grows(default):
    for loop in (default.upper_loop, default.lower_loop):
        place = {vertex: default.uv[default.weld == vertex] for vertex in loop}
        u = [place[loop[0]][:, 0].min(), *(place[vertex][0, 0] for vertex in loop[1:])]
        assert (np.diff(u) > 0.0).all()


def test_the_motion_starts_at_rest_and_stretches_like_skin(default):
    """Dual-quaternion skinning with 40 mm of smoothing: areas 0.29..2.0 at 110 deg, no folds (note)."""
    assert np.allclose(default.posed[0], default.vertices, atol=1e-6)
    assert np.allclose(default.deformation[0], np.eye(2), atol=1e-6)
    ratio = np.linalg.det(default.deformation)
    assert ratio.min() >= 0.25
    assert ratio.max() <= 2.2
    assert not folded(default.vertices, default.posed, default.triangles).any()
    assert len(default.time) == len(default.posed) == len(FLEXION)


def test_a_mirrored_body_has_the_mirrored_domain(default):
    body = mirrored_body(synthetic_body())
    wanted = DomainSettings(side="right", frames_per_second=100.0)
    right = build_domain(body, bending(body, FLEXION, "right"), wanted)
    assert np.array_equal(right.vertices, default.vertices * LEFT)
    assert np.array_equal(right.triangles, default.triangles[:, [0, 2, 1]])
    assert np.array_equal(right.upper_loop, np.roll(default.upper_loop[::-1], 1))
    assert np.array_equal(right.seam_pairs, default.seam_pairs[:, ::-1])
    assert right.period_u == default.period_u
    assert np.array_equal(right.uv[:, 1], default.uv[:, 1])
    assert np.array_equal(right.uv[:, 0] + default.uv[:, 0], np.full(len(right.uv), default.uv[:, 0].max()))
    assert np.allclose(right.posed, default.posed * LEFT, atol=1e-6)


def test_building_twice_gives_the_same_bytes(default):
    assert pack(domain_of()) == pack(default)


def test_the_record_survives_the_disk(default, tmp_path):
    save(default, tmp_path / "domain.npz")
    again = load(Domain, tmp_path / "domain.npz")
    assert pack(again) == pack(default)


def test_rim_bands_lie_at_both_edges(default):
    band = rim_band(default, 8.0)
    assert (band.vertex_distance[default.upper_loop] == 0.0).all()
    height = default.vertices[default.triangles[band.triangles]].mean(axis=1)[:, 1]
    assert (height > 100.0).any()
    assert (height < -100.0).any()
    assert 0.02 < band.triangles.mean() < 0.15


def test_a_posterior_seam_is_posterior_and_90_is_lateral_on_both_sides():
    for side, lateral in (("left", -1.0), ("right", 1.0)):
        back = domain_of(side=side, triangles=1000)
        points = back.vertices[back.weld[back.seam_pairs[:, 0]]]
        assert (points[:, 0] < -20.0).all()
        beside = domain_of(side=side, triangles=1000, seam_azimuth_deg=90.0)
        points = beside.vertices[beside.weld[beside.seam_pairs[:, 0]]]
        assert (points[:, 2] * lateral > 20.0).all()
