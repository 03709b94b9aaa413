"""The embedded model: a closed symmetric surface of adult size whose shape is linear in its coefficients."""

from __future__ import annotations

from importlib import resources

import igl
import numpy as np
import pytest

from hilbrace.body.anny_lite import load_anny_lite
from hilbrace.body.fit import enclosed_volume
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
