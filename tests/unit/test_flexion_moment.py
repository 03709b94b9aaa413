"""The moment of a brace against flexion: from its energy, from its stiffness, and where the two agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings
from hilbrace.optimize.brace_response import posture_stiffness
from hilbrace.optimize.coupling import brace_spring
from hilbrace.optimize.flexion_moment import (
    flexion_grid,
    free_moment,
    held_energy,
    held_moment,
    moment_curves,
    stiffness_by_energy,
)
from hilbrace.optimize.problem import Problem, build_problem
from tests.unit.knee_tube import knee_domain, knee_loads

MATERIAL = MaterialSettings()


@pytest.fixture(scope="module")
def problem() -> Problem:
    loads = knee_loads()
    domain = knee_domain(loads, around=24, along=16)
    return build_problem(
        loads, domain, OptimizeSettings(), MATERIAL, PatternSettings(scale=0.08, rim_mm=10.0)
    )


def _sagittal(problem: Problem, modulus: np.ndarray) -> np.ndarray:
    loops = posture_stiffness(problem, torch.from_numpy(modulus))
    return brace_spring(problem, loops).stiffness[:, 0, 0].numpy()


def _moduli(problem: Problem) -> dict[str, np.ndarray]:
    centres = problem.domain.vertices[problem.domain.triangles].mean(axis=1)
    sides = np.abs(centres[:, 2]) / np.hypot(centres[:, 0], centres[:, 2])
    return {
        "uniform": np.full(len(sides), 0.3),
        "firm sides": 0.002 + 0.4 * sides**4,
        "scattered": np.random.default_rng(2).uniform(0.01, 1.0, len(sides)),
    }


@pytest.mark.parametrize("name", ["uniform", "firm sides", "scattered"])
def test_energy_and_stiffness_give_the_same_moment_at_small_flexion(problem: Problem, name: str):
    modulus = _moduli(problem)[name]
    stiffness = _sagittal(problem, modulus)[problem.rest_posture]
    assert stiffness_by_energy(problem, modulus) == pytest.approx(stiffness, rel=0.10)


def test_the_free_moment_starts_as_the_stiffness_and_the_held_one_lies_above_it(problem: Problem):
    moduli = [*_moduli(problem).values()]
    sagittal = [_sagittal(problem, modulus) for modulus in moduli]
    stiffness = [np.stack([one, 0.0 * one, 0.0 * one], axis=1) for one in sagittal]
    curves = moment_curves(problem, knee_loads(), moduli, stiffness)
    assert np.rad2deg(curves.flexion[[0, -1]]) == pytest.approx([0.0, 60.0], abs=0.1)
    assert not curves.free[:, 0].any()
    assert not curves.held[:, 0].any()
    for free, one in zip(curves.free, sagittal, strict=True):
        assert free[1] == pytest.approx(one[problem.rest_posture] * curves.flexion[1], rel=0.10)
    assert (curves.held[:, 1:] > curves.free[:, 1:]).all()


def test_the_energy_of_skin_that_stretches_alike_everywhere_is_the_closed_form(problem: Problem):
    stretch = np.array([1.2, 0.9])
    domain = replace(problem.domain, deformation=np.broadcast_to(np.diag(stretch), (5, 768, 2, 2)))
    modulus, poisson = 0.3, MATERIAL.poisson
    mu, first = modulus / (2 * (1 + poisson)), modulus * poisson / (1 - poisson**2)
    log_area = np.log(stretch.prod())
    density = mu / 2 * ((stretch**2).sum() - 2) - mu * log_area + first / 2 * log_area**2
    volume_mm3 = float(problem.areas.sum()) * MATERIAL.thickness_mm
    found = held_energy(replace(problem, domain=domain), np.full(768, modulus))
    np.testing.assert_allclose(found, density * volume_mm3 / 1000.0, rtol=1e-12)


def test_the_held_moment_is_the_slope_of_the_energy():
    flexion = np.deg2rad(np.array([3.0, 12.0, 25.0, 47.0, 66.0, 30.0, 8.0]))
    energy = 0.01 + 0.4 * flexion**2 - 0.1 * flexion**3 + 0.2 * flexion**4
    grid = flexion_grid(flexion)
    expected = 0.8 * grid - 0.3 * grid**2 + 0.8 * grid**3
    np.testing.assert_allclose(held_moment(grid, flexion, energy), expected, atol=1e-9)
    assert not held_moment(np.zeros(1), np.zeros(3), np.zeros(3)).any()


def test_the_free_moment_is_the_integral_of_the_stiffness():
    grid = flexion_grid(np.deg2rad([-20.0, 65.0]))
    postures = np.deg2rad([-20.0, 0.0, 30.0])
    np.testing.assert_allclose(free_moment(grid, postures, np.full(3, 0.7)), 0.7 * grid, atol=1e-15)
    falling = np.array([1.4, 1.0, 0.4])  # 1 - 0.02 per degree; constant past the last posture
    at = np.minimum(grid, postures[-1])
    slope = (0.4 - 1.0) / postures[-1]
    expected = at + 0.5 * slope * at**2 + 0.4 * (grid - at)
    np.testing.assert_allclose(free_moment(grid, postures, falling), expected, atol=1e-12)


def test_a_curve_runs_between_the_ends_of_the_motion_and_through_the_neutral_pose():
    grid = np.rad2deg(flexion_grid(np.deg2rad([-7.0, 12.0, 3.0])))
    np.testing.assert_allclose(grid, [-7.0, -5.0, 0.0, 5.0, 10.0, 12.0], atol=1e-12)
    assert np.rad2deg(flexion_grid(np.deg2rad([14.0, 78.0])))[0] == 0.0
