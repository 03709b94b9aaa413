"""Mirrored legs get mirrored braces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings
from hilbrace.domain.build import build_domain
from hilbrace.domain.domain import Domain
from hilbrace.field import GaussianField
from hilbrace.optimize.build import optimize_design
from hilbrace.optimize.design import Design
from tests.unit.domain_body import LEFT, bending, domain_settings, mirrored_body, synthetic_body

FLEXION = np.array([0.0, 15.0, 32.0, 50.0, 64.0, 41.0, 12.0])
ADDUCTION = np.radians([0.0, 1.0, -2.0, -3.0, -5.0, -2.0, 0.0])
AXES = np.array([[0.1, 0.0, 1.0], [1.0, 0.05, 0.0], [0.0, 1.0, 0.02]])
FORCE = np.array([60.0, -900.0, 120.0])


def _loads(side: str) -> JointLoads:
    """A motion that is no mirror image of itself, or that motion of the other leg in the mirror."""
    body = synthetic_body() if side == "left" else mirrored_body(synthetic_body())
    loads = bending(body, FLEXION, side)
    at = loads.joints.index(f"knee_{side[0]}")
    sign = 1.0 if side == "left" else -1.0
    axes = AXES / np.linalg.norm(AXES, axis=1, keepdims=True) * [sign, sign, 1.0]
    angles, force = loads.angles.copy(), loads.acting_force.copy()
    angles[:, at, 1] = ADDUCTION
    force[:, at] = np.linspace(0.2, 1.0, len(FLEXION))[:, None] * FORCE * [1.0, 1.0, sign]
    turn = np.broadcast_to(axes, (*angles.shape[:2], 3, 3)).copy()
    jacobian = np.concatenate([np.zeros_like(turn), np.swapaxes(turn, 2, 3)], axis=2)
    return replace(loads, angles=angles, acting_force=force, joint_axes=turn, distal_jacobian=jacobian)


def _brace(side: str, folder: Path, flatten: str, coupling: str) -> tuple[Domain, Design]:
    body = synthetic_body() if side == "left" else mirrored_body(synthetic_body())
    loads = _loads(side)
    domain = build_domain(
        body, loads, domain_settings(side=side, triangles=500, frames_per_second=100.0, flatten=flatten)
    )
    design, _ = optimize_design(
        loads,
        domain,
        OptimizeSettings.model_validate({"iterations": 12, "coupling": coupling}),
        MaterialSettings(),
        PatternSettings(period_mm=80.0),
        folder / f"{side}.npz",
    )
    return domain, design


@pytest.mark.parametrize(("flatten", "coupling"), [("periodic", "stiffness"), ("lscm", "paper")])
def test_a_mirrored_motion_gets_the_mirrored_brace(tmp_path: Path, flatten: str, coupling: str):
    left_domain, left = _brace("left", tmp_path, flatten, coupling)
    right_domain, right = _brace("right", tmp_path, flatten, coupling)
    np.testing.assert_array_equal(right_domain.vertices, left_domain.vertices * LEFT)
    assert np.ptp(left.d_triangle) > 0.2
    np.testing.assert_array_equal(right.firm_triangle > 0.5, left.firm_triangle > 0.5)
    np.testing.assert_allclose(right.d_triangle, left.d_triangle, atol=1e-6)
    np.testing.assert_allclose(right.stiffness_posed, left.stiffness_posed, rtol=1e-6)
    np.testing.assert_allclose(right.history, left.history, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(right.angle_changes, left.angle_changes, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("period", [0.0, 0.93])
def test_mirrored_parameters_are_the_field_in_the_mirror(period: float):
    points = np.random.default_rng(4).uniform(0.0, period or 1.0, (50, 2))
    mirrored = np.stack([(period or 1.0) - points[:, 0], points[:, 1]], axis=1)
    here, there = (GaussianField(at, 10.0, 20, period) for at in (points, mirrored))
    theta = torch.from_numpy(np.random.default_rng(5).normal(size=(20, 20)))
    np.testing.assert_allclose(there.evaluate(here.mirrored(theta)), here.evaluate(theta), atol=1e-9)
    start = here.start(seed=3, spread=0.1)
    torch.testing.assert_close(here.mirrored(start), start, rtol=0, atol=1e-15)
    assert float(start.std()) == pytest.approx(0.1, rel=0.2)
