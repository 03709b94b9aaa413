"""Motions and wishes that no brace can be designed for, and those that only look like it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings, parse_config
from hilbrace.domain.domain import Domain
from hilbrace.errors import ConfigError, InputError
from hilbrace.optimize.build import optimize_design
from hilbrace.optimize.design import Design
from hilbrace.optimize.losses import compliance
from tests.unit.knee_tube import knee_domain, knee_loads


@pytest.fixture(scope="module")
def domain() -> Domain:
    return knee_domain(knee_loads(), around=16, along=10)


def _design(domain: Domain, loads: JointLoads, folder: Path, **settings: object) -> Design:
    wanted = OptimizeSettings.model_validate({"iterations": 4, "checkpoint_every": 100} | settings)
    pattern = PatternSettings(scale=0.08, rim_mm=10.0)
    return optimize_design(loads, domain, wanted, MaterialSettings(), pattern, folder / "state.npz")[0]


def _loads(flexion: float = 1.0, adduction: float = 1.0, force: float = 1.0) -> JointLoads:
    """The landing with its angles and forces scaled."""
    loads = knee_loads()
    return replace(
        loads,
        angles=loads.angles * np.array([flexion, adduction, 1.0]),
        acting_force=force * loads.acting_force,
    )


@pytest.mark.parametrize("flexion", [0.0, 0.01])
def test_a_motion_that_never_bends_is_refused(domain: Domain, tmp_path: Path, flexion: float):
    with pytest.raises(InputError, match="never bends: flexion stay") as fault:
        _design(domain, _loads(flexion=flexion), tmp_path)
    assert "knee_l" in fault.value.where
    assert "motion.window" in fault.value.hint


def test_a_still_joint_may_be_braced_for_support_alone(domain: Domain, tmp_path: Path):
    design = _design(domain, _loads(flexion=0.0), tmp_path, preserve=[])
    assert np.isfinite(design.history).all()
    assert np.isfinite(design.stiffness_posed).all()


def test_an_angle_to_prevent_that_is_zero_anyway_is_no_fault(domain: Domain, tmp_path: Path):
    design = _design(domain, _loads(adduction=0.0), tmp_path)
    assert np.isfinite(design.history).all()


@pytest.mark.parametrize("settings", [{}, {"coupling": "paper"}])
def test_a_motion_without_any_load_is_refused(domain: Domain, tmp_path: Path, settings: dict):
    with pytest.raises(InputError, match="no frame of the motion loads the joint") as fault:
        _design(domain, _loads(force=0.0), tmp_path, **settings)
    assert "optimize.weights.compliance = 0" in fault.value.hint


def test_without_load_a_brace_is_designed_by_its_stiffness_as_the_hint_says(domain: Domain, tmp_path: Path):
    settings = {"coupling": "stiffness", "weights": {"compliance": 0.0}}
    design = _design(domain, _loads(force=0.0), tmp_path, **settings)
    assert np.isfinite(design.history).all()
    assert not design.history[:, 2].any()


@pytest.mark.parametrize("coupling", ["stiffness", "paper"])
def test_frames_in_flight_count_nothing(domain: Domain, tmp_path: Path, coupling: str):
    loads = knee_loads()
    landing = loads.time >= 0.4
    flying = replace(loads, acting_force=loads.acting_force * landing[:, None, None])
    design = _design(domain, flying, tmp_path, coupling=coupling)
    assert np.isfinite(design.history).all()
    assert not design.reaction_lower[domain.time < 0.4].any()
    assert design.reaction_lower[domain.time >= 0.4].any()


def test_compliance_without_load_is_zero_with_a_zero_gradient():
    energies = torch.tensor([0.0, 3.0, 0.0], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(compliance(energies, 20.0), energies)
    assert compliance(energies, 20.0).item() == pytest.approx(3.0)
    np.testing.assert_allclose(slope, [0.0, 1.0, 0.0], atol=1e-12)
    scale = torch.ones(1, dtype=torch.float64, requires_grad=True)
    nothing = compliance(scale * torch.zeros(4, dtype=torch.float64), 20.0)
    assert float(nothing.detach()) == 0.0
    assert torch.autograd.grad(nothing, scale)[0].item() == 0.0


def test_a_brace_that_shall_do_nothing_is_refused():
    with pytest.raises(ConfigError, match="both empty") as fault:
        parse_config({"optimize": {"preserve": [], "prevent": []}}, "run.toml")
    assert "flexion" in fault.value.hint
