"""What the losses are measured by: the first field, and the uniform brace of the same volume."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings
from hilbrace.optimize import objective
from hilbrace.optimize.evaluate import evaluate, fraction_of
from hilbrace.optimize.loop import firmness, first_state
from hilbrace.optimize.losses import Stability
from hilbrace.optimize.objective import Reference, normalised, reference, relative_stability
from hilbrace.optimize.problem import build_problem
from hilbrace.optimize.uniform import uniform_design
from tests.unit.knee_tube import knee_domain, knee_loads

DOUBLE = torch.float64
MEASURE = Reference(np.ones(5), preserved=0.02, relieved=0.1, support=np.array([[2.0], [1.0]]))


def _stability(preserved: float, relieved: float) -> Stability:
    return Stability(*(torch.tensor(v, dtype=DOUBLE) for v in (preserved, 0.9 - relieved, relieved)))


def _relative(preserved: float, relieved: float, support: tuple[float, float]) -> float:
    held = torch.tensor(support, dtype=DOUBLE)[:, None]
    return float(relative_stability(_stability(preserved, relieved), held, MEASURE))


def test_the_uniform_brace_has_the_value_one():
    assert _relative(0.02, 0.1, (2.0, 1.0)) == pytest.approx(1.0)


def test_half_the_hindrance_counts_its_logarithm():
    assert _relative(0.02 / 4, 0.1, (2.0, 1.0)) == pytest.approx(1.0 - math.log(2.0))


def test_support_counts_its_share_and_its_lack_is_penalised_in_every_posture():
    more = _relative(0.02, 0.2, (4.0, 2.0))
    assert more == pytest.approx(1.0 - objective.SUPPORT_SHARE * math.log(2.0))
    lacking = _relative(0.02, 0.1, (2.0, 0.5))
    assert lacking == pytest.approx(1.0 + objective.FLOOR_WEIGHT * math.log(2.0) ** 2)


def test_a_brace_that_relieves_nothing_has_a_finite_loss():
    assert math.isfinite(_relative(0.02, -0.1, (2.0, 1.0)))
    none = Reference(np.ones(5), preserved=0.02, relieved=-0.1, support=np.zeros((2, 0)))
    unsupported = relative_stability(_stability(0.02, 0.1), torch.zeros((2, 0), dtype=DOUBLE), none)
    assert float(unsupported) == pytest.approx(1.0)


@pytest.mark.parametrize("coupling", ["stiffness", "paper"])
def test_losses_start_at_one_and_floors_measure_those_that_start_at_zero(coupling: str):
    loads = knee_loads()
    settings = OptimizeSettings(coupling=coupling)
    domain = knee_domain(loads, around=16, along=10)
    problem = build_problem(
        loads, domain, settings, MaterialSettings(), PatternSettings(scale=0.08, rim_mm=10.0)
    )
    state = first_state(problem, "")
    field = torch.from_numpy(state.theta), torch.from_numpy(state.bias)
    start = evaluate(problem, firmness(problem, state.firm), *field)
    measure = reference(problem, start)
    terms = normalised(start, measure, coupling).numpy()
    np.testing.assert_allclose(terms[1:3], 1.0)
    assert terms[3] < 1e-9
    assert measure.start[3] == objective.TOLERANCE**2
    if coupling == "paper":
        assert terms[0] == pytest.approx(1.0)
    uniform = uniform_design(problem, settings.volume_fraction)
    assert fraction_of(problem, uniform) == pytest.approx(settings.volume_fraction)
    assert measure.support.shape == (len(problem.postures), 1)


def test_postures_are_taken_to_both_sides_of_the_rest_shape_and_at_even_steps():
    loads = knee_loads()
    joint = loads.joints.index("knee_l")
    angles = loads.angles.copy()
    angles[:, joint, 0] = np.linspace(np.deg2rad(-40.0), np.deg2rad(50.0), len(loads.time))
    moved = replace(loads, angles=angles)
    domain = knee_domain(loads, around=16, along=10)
    settings = OptimizeSettings()
    problem = build_problem(moved, domain, settings, MaterialSettings(), PatternSettings(scale=0.08))
    flexions = np.rad2deg([posture.flexion for posture in problem.postures])
    assert (np.diff(flexions) > 15.0).all()
    assert flexions[problem.rest_posture] == 0.0
    assert flexions[0] < -20.0
    assert flexions[-1] > 30.0


def test_past_the_flexion_of_support_a_share_of_the_uniform_braces_is_enough():
    loads = knee_loads()
    domain = knee_domain(loads, around=16, along=10)
    found = {}
    for until in (90.0, 45.0):
        settings = OptimizeSettings(support_until_deg=until, support_beyond=0.6)
        problem = build_problem(
            loads, domain, settings, MaterialSettings(), PatternSettings(scale=0.08, rim_mm=10.0)
        )
        state = first_state(problem, "")
        field = torch.from_numpy(state.theta), torch.from_numpy(state.bias)
        found[until] = reference(problem, evaluate(problem, firmness(problem, state.firm), *field)).support
    flexions = np.rad2deg([posture.flexion for posture in problem.postures])
    assert flexions[-1] > 45.0 > flexions[0]
    wanted = np.where(flexions > 45.0, 0.6, 1.0)[:, None]
    np.testing.assert_allclose(found[45.0] / found[90.0], np.broadcast_to(wanted, found[45.0].shape))
