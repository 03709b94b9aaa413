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
from hilbrace.domain.rim import loop_distance, rim_band
from hilbrace.run.records import load, pack, save
from hilbrace.shell import build_shell
from hilbrace.shell.boundary import boundary_loops
from tests.unit.domain_body import LEFT, bending, domain_settings, mirrored_body, outwardness, synthetic_body

FLEXION = np.linspace(0.0, 110.0, 12)


def domain_of(**settings_of):
    wanted = domain_settings(**settings_of)
    body = synthetic_body()
    return build_domain(
        body, bending(body, FLEXION, wanted.side), wanted.model_copy(update={"frames_per_second": 100.0})
    )


@pytest.fixture(scope="module")
def default():
    return domain_of(triangles=2000)


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


@settings(max_examples=6, deadline=None)
@given(
    above=st.floats(0.2, 0.6),
    below=st.floats(0.2, 0.6),
    side=st.sampled_from(["left", "right"]),
    triangles=st.integers(500, 3000),
    seam_azimuth_deg=st.floats(-180.0, 360.0),
    flatten=st.sampled_from(["lscm", "periodic"]),
)
def test_every_setting_gives_a_sound_domain(**settings_of):
    wanted = domain_settings(**settings_of)
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
    wanted = DomainSettings(side="right", triangles=2000, frames_per_second=100.0)
    right = build_domain(body, bending(body, FLEXION, "right"), wanted)
    assert np.array_equal(right.vertices, default.vertices * LEFT)
    assert np.array_equal(right.triangles, default.triangles[:, [0, 2, 1]])
    assert np.array_equal(right.upper_loop, np.roll(default.upper_loop[::-1], 1))
    assert np.array_equal(right.seam_pairs, default.seam_pairs[:, ::-1])
    assert right.period_u == default.period_u
    assert np.array_equal(right.uv[:, 1], default.uv[:, 1])
    assert np.array_equal(right.uv[:, 0] + default.uv[:, 0], np.full(len(right.uv), default.uv[:, 0].max()))
    assert np.allclose(right.posed, default.posed * LEFT, atol=1e-6)


DORSIFLEXION = np.radians([0.0, 15.0, -25.0, 0.0])
INVERSION = np.radians([0.0, 0.0, 0.0, 15.0])


@pytest.fixture(scope="module", params=["left", "right"])
def ankle(request):
    body, letter = synthetic_body(), request.param[0]
    turns = {f"ankle_angle_{letter}": DORSIFLEXION, f"subtalar_angle_{letter}": INVERSION, "pelvis_tx": 0.4}
    loads = bending(body, np.full(4, 20.0), request.param, **turns)
    wanted = {"joint": "ankle", "side": request.param, "triangles": 1500, "frames_per_second": 100.0}
    wanted |= {"upper_rim_mm": 15.0, "window_rim_mm": 5.0}
    return build_domain(body, loads, domain_settings(**wanted))


def test_an_ankle_brace_goes_from_shank_to_midfoot_with_an_open_heel(ankle):
    upper, lower = ankle.vertices[ankle.upper_loop], ankle.vertices[ankle.lower_loop]
    assert upper[:, 1].min() > 120.0
    assert np.ptp(lower[:, 0]) < 15.0
    assert lower[:, 0].min() > 40.0
    (heel,) = ankle.window_loops
    assert (ankle.vertices[heel, 0] < 15.0).all()
    assert (ankle.vertices[heel, 1] < 0.0).all()
    assert igl.euler_characteristic(ankle.triangles) == -1
    loops = boundary_loops(ankle.triangles)
    assert {frozenset(loop.tolist()) for loop in loops} == {
        frozenset(loop.tolist()) for loop in (ankle.upper_loop, ankle.lower_loop, heel)
    }
    build_shell(ankle.vertices, ankle.triangles, ankle.upper_loop, ankle.lower_loop, 4.0, 0.45)


def test_an_ankle_brace_is_seen_from_the_talus(ankle):
    """In its frame the shank swings back when the foot comes up, and nothing else of the body shows."""
    assert np.allclose(ankle.posed[0, ankle.lower_loop], ankle.vertices[ankle.lower_loop], atol=1.0)
    top = ankle.vertices[ankle.upper_loop].mean(axis=0)
    for frame in (1, 2):
        turn = DORSIFLEXION[frame]
        swung = ankle.posed[frame, ankle.upper_loop].mean(axis=0)
        expected = top @ np.array(
            [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        )
        away = np.abs(np.arctan2(*swung[:2]) - np.arctan2(*expected[:2]))
        assert np.degrees(away) < 3.0
        assert np.allclose(ankle.posed[frame, ankle.lower_loop], ankle.vertices[ankle.lower_loop], atol=12.0)
    sole = ankle.posed[3, ankle.lower_loop].mean(axis=0) - ankle.vertices[ankle.lower_loop].mean(axis=0)
    assert np.linalg.norm(sole) > 2.0
    ratio = np.linalg.det(ankle.deformation)
    assert ratio.min() > 0.4
    assert ratio.max() < 1.8


def test_rims_have_widths_of_their_own(ankle):
    assert np.array_equal(ankle.rims, [15.0, np.nan, 5.0], equal_nan=True)
    band = rim_band(ankle, 8.0)
    centres = ankle.vertices[ankle.triangles].mean(axis=1)
    loops = (ankle.upper_loop, ankle.lower_loop, *ankle.window_loops)
    for loop, width in zip(loops, (15.0, 8.0, 5.0), strict=True):
        assert band.triangles[loop_distance(centres, ankle.vertices[loop]) <= width].all()
    far = np.min([loop_distance(centres, ankle.vertices[loop]) for loop in loops], axis=0) > 15.0
    assert not band.triangles[far].any()
    assert (band.vertex_distance[ankle.window_loops[0]] == 0.0).all()


def test_windows_of_a_mirrored_or_saved_domain_stay_what_they_are(ankle, tmp_path):
    save(ankle, tmp_path / "domain.npz")
    again = load(Domain, tmp_path / "domain.npz")
    assert pack(again) == pack(ankle)
    assert np.array_equal(again.window_loops[0], ankle.window_loops[0])


def test_building_twice_gives_the_same_bytes(default):
    assert pack(domain_of(triangles=2000)) == pack(default)


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
