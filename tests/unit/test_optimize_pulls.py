"""The pulls of the losses are their derivatives, and tell who wants a region firm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings
from hilbrace.optimize.evaluate import evaluate_material, material_of
from hilbrace.optimize.loop import firmness, segment_by_energy
from hilbrace.optimize.objective import normalised, reference
from hilbrace.optimize.problem import build_problem
from hilbrace.optimize.pulls import pulls, shares_of_pull
from tests.unit.knee_tube import knee_domain, knee_loads
from tests.unit.sleeve import sleeve_design

PATTERN = PatternSettings(scale=0.08, rim_mm=10.0)


@pytest.mark.parametrize("coupling", ["stiffness", "paper"])
def test_pulls_are_what_finite_differences_say(coupling: str):
    loads = knee_loads()
    domain = knee_domain(loads, around=16, along=12)
    settings = OptimizeSettings.model_validate({"coupling": coupling})
    problem = build_problem(loads, domain, settings, MaterialSettings(), PATTERN)
    firm = firmness(problem, segment_by_energy(problem))
    generator = np.random.default_rng(3)
    d = generator.uniform(0.3, 0.8, len(domain.triangles))
    at_vertices = torch.full((len(domain.uv),), 0.5, dtype=torch.float64)

    def evaluation(at: np.ndarray):
        material = material_of(problem, torch.from_numpy(at), firm.triangles)
        with torch.no_grad():
            return evaluate_material(problem, material, at_vertices)

    measure = reference(problem, evaluation(d))
    weights = np.array(list(settings.weights.model_dump().values()))

    def weighted(at: np.ndarray) -> np.ndarray:
        return weights * normalised(evaluation(at), measure, coupling).numpy()

    found = pulls(problem, firm, d, at_vertices.numpy(), measure)
    direction = generator.standard_normal(len(d))
    near, far = (weighted(d + size * direction) - weighted(d - size * direction) for size in (1e-4, 2e-4))
    slope = (8 * near - far) / 12e-4
    share = (problem.areas / problem.areas.sum()).numpy()
    np.testing.assert_allclose(-(found * share) @ direction, slope, rtol=1e-5, atol=1e-9)
    assert not found[:, problem.rim.numpy()].any()


def test_shares_count_only_what_pulls_the_asked_way():
    domain = knee_domain(knee_loads(), around=12, along=8)
    design = sleeve_design(domain, PATTERN)
    some = np.zeros((5, len(domain.triangles)))
    some[0], some[1], some[2] = 3.0, -4.0, 1.0
    areas = np.ones(len(domain.triangles))
    made = replace(design, pulls=some)
    np.testing.assert_allclose(shares_of_pull(made, areas, firmer=True), [0.75, 0, 0.25, 0, 0])
    np.testing.assert_allclose(shares_of_pull(made, areas, firmer=False), [0, 1, 0, 0, 0])
