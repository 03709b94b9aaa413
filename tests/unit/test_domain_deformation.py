from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilbrace.domain.deformation import check_deformation, deformation_gradients, folded, local_edges
from hilbrace.errors import GeometryError
from tests.unit.domain_body import sleeve

REST, TRIANGLES = sleeve(55.0, 75.0, 280.0)
TIME = np.array([0.5])


def gradients(posed):
    return deformation_gradients(REST, posed[None], TRIANGLES)


def test_rest_gives_the_identity():
    assert np.allclose(gradients(REST), np.eye(2), atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_rigid_motion_gives_the_identity(seed):
    draw = np.random.default_rng(seed)
    moved = REST @ Rotation.random(rng=draw).as_matrix().T + draw.normal(size=3) * 500.0
    assert np.allclose(gradients(moved), np.eye(2), atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(scale=st.floats(0.2, 5.0))
def test_uniform_scaling_gives_the_scale(scale):
    assert np.allclose(gradients(REST * scale), scale * np.eye(2), rtol=1e-9, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_cauchy_green_is_the_metric_of_a_linear_map(seed):
    """For x -> A x the strain of a triangle is A^T A restricted to its plane."""
    matrix = np.eye(3) + 0.3 * np.random.default_rng(seed).normal(size=(3, 3))
    gradient = gradients(REST @ matrix.T)[0]
    corner = REST[TRIANGLES]
    first = corner[:, 1] - corner[:, 0]
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    normal = np.cross(first, corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(normal, first)], axis=-1)
    metric = np.swapaxes(axes, 1, 2) @ (matrix.T @ matrix) @ axes
    assert np.allclose(np.swapaxes(gradient, 1, 2) @ gradient, metric, atol=1e-9)
    assert (gradient[:, 1, 0] == 0.0).all()


def test_local_edges_keep_lengths_and_areas():
    edges = local_edges(REST, TRIANGLES)
    corner = REST[TRIANGLES]
    assert np.allclose(
        np.linalg.norm(edges[..., 1], axis=-1), np.linalg.norm(corner[:, 2] - corner[:, 0], axis=-1)
    )
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=-1)
    assert np.allclose(np.linalg.det(edges), area)


def test_area_ratios_pass_and_a_collapse_is_named():
    assert np.allclose(check_deformation(gradients(REST * 1.2), TIME), 1.44)
    flat = REST.copy()
    flat[TRIANGLES[7, 2]] = REST[TRIANGLES[7, :2]].mean(axis=0)
    with pytest.raises(GeometryError, match=r"at 0\.500 s"):
        check_deformation(gradients(flat), TIME)
    lost = REST.copy()
    lost[5] = np.nan
    with pytest.raises(GeometryError, match="shrink below 1%"):
        check_deformation(gradients(lost), TIME)


def test_a_fold_shows_and_a_smooth_bend_does_not():
    bent = REST.copy()
    bent[:, 0] += (REST[:, 1] / 280.0) ** 2 * 60.0
    assert not folded(REST, bent[None], TRIANGLES).any()
    tucked = REST.copy()
    ring = np.isclose(REST[:, 1], 140.0)
    tucked[ring, 1] = 100.0
    found = folded(REST, np.stack([REST, tucked]), TRIANGLES)
    assert not found[0].any()
    assert found[1].any()
    centre = REST[TRIANGLES[found[1]]].mean(axis=1)[:, 1]
    assert ((centre > 90.0) & (centre < 170.0)).all()
