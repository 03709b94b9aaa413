"""The design loop on a bending tube: exact gradients, interruption without a trace, a better brace."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings, parse_config
from hilbrace.domain.domain import Domain
from hilbrace.errors import ConfigError, SolverError
from hilbrace.optimize.brace_response import brace_response, posture_stiffness
from hilbrace.optimize.build import optimize_design
from hilbrace.optimize.design import COUPLINGS, LOSSES, Design
from hilbrace.optimize.evaluate import design_variable, evaluate
from hilbrace.optimize.history import TRACE, write_history_csv
from hilbrace.optimize.loop import adam, firmness, first_state
from hilbrace.optimize.objective import normalised, reference
from hilbrace.optimize.problem import Problem, build_problem, width_limits
from hilbrace.optimize.schedules import learning_rate
from hilbrace.optimize.uniform import uniform_design
from hilbrace.run.records import pack
from hilbrace.shell.solver import available_backends
from tests.unit.knee_tube import knee_domain, knee_loads

MATERIAL = MaterialSettings()
PATTERN = PatternSettings(scale=0.08, rim_mm=10.0)


@pytest.fixture(scope="module")
def domain() -> Domain:
    return knee_domain(knee_loads(), around=20, along=14)


def _settings(**changes: object) -> OptimizeSettings:
    return OptimizeSettings(**({"iterations": 12, "checkpoint_every": 3} | changes))


@pytest.fixture(scope="module")
def problem(domain: Domain) -> Problem:
    return build_problem(knee_loads(), domain, _settings(), MATERIAL, PATTERN)


@pytest.fixture(scope="module")
def design(domain: Domain, tmp_path_factory: pytest.TempPathFactory) -> Design:
    return _optimize(domain, tmp_path_factory.mktemp("design") / "checkpoint.npz", iterations=40)


def _optimize(domain: Domain, checkpoint: Path, progress=lambda *_: None, **changes: object) -> Design:
    settings = _settings(**changes)
    design, _ = optimize_design(
        knee_loads(), domain, settings, MATERIAL, PATTERN, checkpoint, key="task", progress=progress
    )
    return design


@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize(
    "mechanics", [{}, {"geometry": "clusters:3"}, {"geometry": "frame"}, {"skin_n_per_mm3": 0.01}]
)
def test_the_total_loss_has_the_gradient_of_finite_differences(
    domain: Domain, coupling: str, mechanics: dict
):
    problem = build_problem(
        knee_loads(), domain, _settings(coupling=coupling, **mechanics), MATERIAL, PATTERN
    )
    state = first_state(problem, "")
    firm = firmness(problem, state.firm)
    generator = torch.Generator().manual_seed(5)
    theta = torch.from_numpy(state.theta) + torch.randn((100, 100), generator=generator, dtype=torch.float64)
    bias = torch.tensor(float(state.bias), dtype=torch.float64)
    start = evaluate(problem, firm, theta, bias)
    measure = reference(problem, start)
    weights = torch.tensor([0.5, 0.8, 0.6, 0.3, 0.02], dtype=torch.float64)

    def total(at: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
        evaluation = evaluate(problem, firm, at, level)
        return (weights * normalised(evaluation, measure, coupling)).sum()

    at, level = theta.clone().requires_grad_(), bias.clone().requires_grad_()
    by_theta, by_bias = torch.autograd.grad(total(at, level), (at, level))
    direction = torch.randn(theta.shape, generator=generator, dtype=torch.float64)
    along_theta = _slope(lambda size: total(theta + size * direction, bias))
    along_bias = _slope(lambda size: total(theta, bias + size))
    assert float((by_theta * direction).sum()) == pytest.approx(along_theta, rel=1e-6)
    assert float(by_bias) == pytest.approx(along_bias, rel=1e-6)


def _slope(function: Callable[[float], torch.Tensor], step: float = 1e-3) -> float:
    """Derivative at zero by central differences of the fourth order."""
    with torch.no_grad():
        near, far = (float(function(size) - function(-size)) for size in (step, 2 * step))
    return (8 * near - far) / (12 * step)


def test_the_first_field_has_the_target_volume(problem: Problem):
    state = first_state(problem, "")
    evaluation = evaluate(
        problem, firmness(problem, state.firm), torch.from_numpy(state.theta), torch.from_numpy(state.bias)
    )
    fraction = float((evaluation.material.volume * problem.areas).sum() / problem.areas.sum())
    assert fraction == pytest.approx(problem.settings.volume_fraction, abs=1e-9)


def test_a_volume_that_cannot_be_cast_is_refused_with_the_range_that_can(domain: Domain, tmp_path: Path):
    with pytest.raises(SolverError, match=r"0\.12") as fault:
        _optimize(domain, tmp_path / "checkpoint.npz", volume_fraction=0.12)
    assert "optimize.volume_fraction" in fault.value.hint
    assert "can be reached" in fault.value.where


def test_the_field_stays_in_the_range_that_can_be_cast(problem: Problem):
    state = first_state(problem, "")
    firm = firmness(problem, state.firm)
    low, high = width_limits(problem, problem.triangles, firm.triangles)
    for level in (-50.0, 50.0):
        bias = torch.tensor(level, dtype=torch.float64)
        d = design_variable(problem, problem.triangles, firm.triangles, torch.from_numpy(state.theta), bias)
        assert bool((d >= low - 1e-12).all() and (d <= high + 1e-12).all())


EVERY_KIND = {
    "default": {},
    "exact": {"volume": "exact", "sharpness_end": 3.0},
    "network": {"field": "network", "gradient_noise": 0.2, "p_norm_start": 4.0},
    "refreshed": {"segmentation_every": 5, "field": "network", "volume": "exact"},
}
"""Settings of every part of the loop that carries a state."""


@pytest.mark.parametrize(
    ("kind", "stop"), [("default", 1), ("default", 7), ("exact", 4), ("network", 5), ("refreshed", 8)]
)
def test_an_interrupted_loop_ends_in_the_same_bytes(domain: Domain, tmp_path: Path, kind: str, stop: int):
    whole = _optimize(domain, tmp_path / "whole.npz", **EVERY_KIND[kind])

    def interrupt(done: int, _: int) -> None:
        if done == stop:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _optimize(domain, tmp_path / "checkpoint.npz", progress=interrupt, **EVERY_KIND[kind])
    assert pack(_optimize(domain, tmp_path / "checkpoint.npz", **EVERY_KIND[kind])) == pack(whole)
    assert kind == "refreshed" or whole.history[-1, -1] < whole.history[0, -1]


def test_a_checkpoint_of_another_task_or_a_broken_one_is_not_used(domain: Domain, tmp_path: Path):
    checkpoint = tmp_path / "checkpoint.npz"
    whole = pack(_optimize(domain, tmp_path / "whole.npz", iterations=6))
    _optimize(domain, checkpoint, iterations=3, seed=4)
    assert pack(_optimize(domain, tmp_path / "seed.npz", iterations=6, seed=4)) != whole
    checkpoint.write_bytes(checkpoint.read_bytes()[:100])
    assert pack(_optimize(domain, checkpoint, iterations=6)) == whole


def test_the_papers_coupling_designs_too_and_both_are_predicted(
    domain: Domain, design: Design, tmp_path: Path
):
    other = _optimize(
        domain, tmp_path / "checkpoint.npz", coupling="paper", prevent=("adduction", "rotation")
    )
    assert other.history[-1, -1] < 0.97 * other.history[0, -1]
    assert (other.coupling, design.coupling) == ("paper", "stiffness")
    for made in (other, design):
        assert made.angle_changes.shape == (2, len(domain.time), 3)
        np.testing.assert_array_equal(made.angle_change, made.angle_changes[COUPLINGS.index(made.coupling)])
        assert np.abs(made.angle_changes[0] - made.angle_changes[1]).max() > 0.0
    ends = [0, -1]
    np.testing.assert_allclose(other.contact_force_change[1][ends], other.reaction_lower[ends], rtol=1e-9)


def test_losses_fall_and_the_brace_beats_the_uniform_one(design: Design):
    assert design.history.shape == (41, len(LOSSES) + 1)
    assert design.history[-1, -1] < 0.9 * design.history[0, -1]
    sagittal, frontal = design.stiffness[0], design.stiffness[1]
    assert frontal > 0.95 * design.stiffness_uniform[1]
    assert frontal / sagittal > 1.5 * design.stiffness_uniform[1] / design.stiffness_uniform[0]
    assert design.volume_fraction == pytest.approx(design.volume_fraction_uniform, abs=1e-9)


def test_reactions_balance_the_load(design: Design, problem: Problem):
    carried = problem.load.forces.numpy()
    np.testing.assert_allclose(design.reaction_upper + design.reaction_lower, -carried, atol=1e-7)


def test_the_uniform_design_is_uniform_outside_the_rims(problem: Problem, design: Design):
    uniform = uniform_design(problem, design.volume_fraction)
    inside = ~problem.rim
    assert float(uniform.volume[inside].std()) < 1e-12
    assert float(uniform.volume[problem.rim].min()) == 1.0


def test_the_history_is_a_table_that_opens_anywhere(design: Design, tmp_path: Path):
    write_history_csv(design, tmp_path / "history.csv")
    rows = (tmp_path / "history.csv").read_text().splitlines()
    assert rows[0].split(",") == [
        "iteration",
        *(f"L{i + 1}_{name}" for i, name in enumerate(LOSSES)),
        "total",
        *TRACE,
    ]
    assert len(rows) == len(design.history) + 1


def test_a_loss_that_is_not_finite_stops_the_loop(domain: Domain, tmp_path: Path):
    loads = knee_loads()
    loads.angles[10:, :, 1] = np.nan
    with pytest.raises(SolverError, match="not finite"):
        optimize_design(loads, domain, _settings(), MATERIAL, PATTERN, tmp_path / "checkpoint.npz")


def test_adam_is_torchs_adam():
    generator = np.random.default_rng(0)
    ours = generator.random(5)
    theirs = torch.from_numpy(ours.copy()).requires_grad_()
    optimizer = torch.optim.Adam([theirs], lr=0.05)
    momentum = np.zeros((2, 5))
    for count in range(1, 20):
        gradient = generator.standard_normal(5)
        ours, momentum = adam(ours, gradient, momentum, count, 0.05)
        theirs.grad = torch.from_numpy(gradient)
        optimizer.step()
        np.testing.assert_allclose(ours, theirs.detach().numpy(), rtol=1e-12)


def test_the_step_falls_from_the_full_one_to_a_tenth():
    rates = [learning_rate(_settings(iterations=50), iteration) for iteration in range(50)]
    assert rates[0] == pytest.approx(0.3)
    assert rates[-1] == pytest.approx(0.03)
    assert all(a >= b for a, b in pairwise(rates))


def test_posed_shapes_and_skin_change_the_compliance_and_only_there(domain: Domain):
    """The stiffness between the loops, in which the brace acts on the joint, is that of the bare brace."""
    found = {}
    for name, mechanics in {
        "rest": {},
        "frame": {"geometry": "frame"},
        "all": {"geometry": f"clusters:{len(domain.posed)}"},
        "skin": {"skin_n_per_mm3": 0.01},
    }.items():
        problem = build_problem(knee_loads(), domain, _settings(**mechanics), MATERIAL, PATTERN)
        modulus = torch.full_like(problem.areas, 0.5)
        found[name] = brace_response(problem, modulus)
        torch.testing.assert_close(found[name].loops, found["rest"].loops, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(
            found[name].loops, posture_stiffness(problem, modulus), rtol=1e-9, atol=1e-9
        )
    compliance = {name: response.frames.compliance for name, response in found.items()}
    torch.testing.assert_close(compliance["all"], compliance["frame"], rtol=1e-12, atol=0)
    assert float((compliance["frame"] / compliance["rest"] - 1).abs().max()) > 0.01
    assert (compliance["skin"] < compliance["rest"]).all()


def test_a_design_names_its_solver_and_shapes_and_hardly_depends_on_the_solver(
    domain: Domain, tmp_path: Path
):
    ours, plain = (
        _optimize(domain, tmp_path / f"{solver}.npz", iterations=3, geometry="clusters:2", solver=solver)
        for solver in ("auto", "scipy")
    )
    assert (ours.solver, plain.solver) == (available_backends()[0], "scipy")
    assert ours.shapes == plain.shapes == 2
    np.testing.assert_allclose(ours.history, plain.history, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("text", ["clusters", "clusters:0", "posed", "clusters:-1"])
def test_a_geometry_that_does_not_exist_is_refused_with_the_settings(text: str):
    with pytest.raises(ConfigError, match="geometry"):
        parse_config({"optimize": {"geometry": text}}, "run.toml")
