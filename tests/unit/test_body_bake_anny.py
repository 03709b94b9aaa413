"""The bake against a stand-in for anny whose shapes are known: a ball with an eye, two phenotypes, legs."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest
import torch
import trimesh

from hilbrace.body import bake_anny
from hilbrace.body.anny_lite import AnnyLite

BALL = trimesh.creation.icosphere(subdivisions=1)
EYE = trimesh.creation.icosphere(subdivisions=0, radius=0.1)


class StandIn:
    """Anny's axes (x left, y back, z up): ``height`` stretches along z, ``weight`` along y."""

    bone_labels = ("root", "upperleg01.L", "upperleg01.R")
    bone_parents = (-1, 0, 0)
    bone_count = 3
    phenotype_labels = ("height", "weight")
    local_change_labels = ("l-upperleg-fat-incr", "r-upperleg-fat-incr", "nose-point-up")

    def __init__(self, **_):
        points = np.concatenate(
            [np.round(BALL.vertices, 12), np.round(EYE.vertices, 12) - np.array([0.0, 2.0, 0.0])]
        )
        self.template_vertices = torch.as_tensor(points)
        self.faces = np.concatenate([BALL.faces, EYE.faces + len(BALL.vertices)])
        left = points[:, 0] > 0
        self.vertex_bone_indices = torch.as_tensor(
            np.column_stack([np.where(left, 1, 2), np.zeros(len(points))])
        ).long()
        middle = np.abs(points[:, 0]) < 1e-9
        self.vertex_bone_weights = torch.as_tensor(
            np.column_stack([np.where(middle, 0.0, 0.7), np.where(middle, 1.0, 0.3)])
        )

    def __call__(self, pose_parameters, phenotype_kwargs, local_changes_kwargs):
        assert pose_parameters.shape[1:] == (3, 4, 4)
        stretch = torch.ones(len(phenotype_kwargs["height"]), 1, 3, dtype=torch.float64)
        stretch[:, 0, 2] += phenotype_kwargs["height"]
        stretch[:, 0, 1] += phenotype_kwargs["weight"]
        points = self.template_vertices * stretch
        for label, value in (local_changes_kwargs or {}).items():
            sign = 1.0 if label.startswith("l-") else -1.0
            side = (sign * self.template_vertices[:, 0] > 0).double()
            points = points + torch.stack([sign * 0.2 * side, 0 * side, 0 * side], 1) * value[:, None, None]
        heads = torch.tensor([[0.0, 0, 0], [0.5, 0, -0.2], [-0.5, 0, -0.2]], dtype=torch.float64) * stretch
        return {"rest_vertices": points, "rest_bone_heads": heads}


class Distribution:
    def __init__(self, *_, **__):
        pass

    def sample(self, count):
        return {"height": 0.2 * torch.randn(count).double(), "weight": 0.1 * torch.randn(count).double()}


@pytest.fixture(scope="module")
def baked():
    with pytest.MonkeyPatch.context() as patch:
        for name, content in (
            ("anny", {"Anny": StandIn}),
            ("anny.shape_distribution", {"SimpleShapeDistribution": Distribution}),
        ):
            module = ModuleType(name)
            vars(module).update(content)
            patch.setitem(sys.modules, name, module)
        patch.setattr(bake_anny, "version", lambda _: "9.9")
        yield bake_anny.bake(seed=3)


def test_only_the_skin_is_kept_and_the_axes_are_opensims(baked: AnnyLite):
    assert len(baked.template) == len(BALL.vertices)
    assert len(baked.triangles) == len(BALL.faces)
    expected = BALL.vertices @ bake_anny.ANNY_TO_OPENSIM.T
    scale = np.ptp(baked.template, axis=0) / np.ptp(expected, axis=0)
    np.testing.assert_allclose(baked.template, expected * scale, atol=1e-5)
    assert np.linalg.det(bake_anny.ANNY_TO_OPENSIM) == pytest.approx(1.0)


def test_components_are_one_standard_deviation_long(baked: AnnyLite):
    top = baked.template[:, 1].argmax()
    deviation = np.ptp(baked.directions[0, :, 1]) / 2
    assert deviation == pytest.approx(0.2, rel=0.1)
    assert abs(baked.directions[0, top, 1]) == pytest.approx(deviation, rel=1e-3)
    front = baked.template[:, 0].argmax()
    assert abs(baked.directions[1, front, 0]) == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(baked.directions[2:16].astype(float), 0.0, atol=1e-6)


def test_both_legs_share_one_slider_and_other_targets_are_left_out(baked: AnnyLite):
    assert baked.coefficient_names[16:] == ("upperleg-fat-incr",)
    move = baked.directions[16].astype(float)
    np.testing.assert_allclose(move[:, 2], 0.2 * np.sign(np.round(baked.template[:, 2], 6)), atol=1e-3)


def test_weights_and_bones_are_carried_over(baked: AnnyLite):
    weights = baked.dense_weights()
    right = baked.template[:, 2] > 1e-6
    np.testing.assert_allclose(weights[right][:, 2], 0.7, atol=1e-3)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert baked.bone_names == StandIn.bone_labels
    assert baked.head_template[2, 2] == pytest.approx(0.5, abs=1e-6)
    assert "anny 9.9" in baked.source


def test_the_error_on_the_legs_is_stored_with_the_bake(baked: AnnyLite):
    """Two phenotypes are two components, so that strangers are met within the stored precision."""
    assert 0.0 < baked.leg_rms_mm < 2.0
    moved = baked.template[None] + np.array([0.0, 0.0, 0.003])
    rms, p99 = bake_anny.leg_error_mm(baked, moved)
    assert rms == pytest.approx(3.0, rel=0.35)
    assert p99 >= rms


def test_the_command_writes_the_file(tmp_path, baked, monkeypatch):
    monkeypatch.setattr(bake_anny, "bake", lambda: baked)
    monkeypatch.setattr(sys, "argv", ["bake_anny", str(tmp_path / "model.npz")])
    bake_anny.main()
    back = bake_anny.records.load(AnnyLite, tmp_path / "model.npz")
    assert back.coefficient_names == baked.coefficient_names
    np.testing.assert_array_equal(back.directions, baked.directions)
