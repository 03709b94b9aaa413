"""The course of the design loop: exact volume, schedules, noise, patience, refreshes, snapshots, pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings
from hilbrace.domain.domain import Domain
from hilbrace.errors import SolverError
from hilbrace.optimize.build import optimize_design
from hilbrace.optimize.design import Design
from hilbrace.optimize.evaluate import evaluate
from hilbrace.optimize.firm_map import firmness, segment_by_energy
from hilbrace.optimize.history import TRACE, Snapshot, told, write_history_picture
from hilbrace.optimize.loop import first_state, level_for_volume
from hilbrace.optimize.objective import normalised, reference
from hilbrace.optimize.problem import Problem, build_problem
from hilbrace.optimize.schedules import at_iteration, is_done, is_snapshot, learning_rate
from hilbrace.optimize.state import drawn, first_generator
from tests.unit.knee_tube import knee_domain, knee_loads

MATERIAL = MaterialSettings()
PATTERN = PatternSettings(scale=0.08, rim_mm=10.0)
NETWORK = {"field": "network", "network_layers": (12,), "network_waves": 3}


@pytest.fixture(scope="module")
def domain() -> Domain:
    return knee_domain(knee_loads(), around=18, along=12)


def _settings(**changes: object) -> OptimizeSettings:
    return OptimizeSettings(**({"iterations": 10, "snapshots": 4} | changes))


def _problem(domain: Domain, **changes: object) -> Problem:
    return build_problem(knee_loads(), domain, _settings(**changes), MATERIAL, PATTERN)


def _optimize(domain: Domain, folder: Path, watches=(), **changes: object) -> Design:
    arguments = (_settings(**changes), MATERIAL, PATTERN, folder / "checkpoint.npz")
    return optimize_design(knee_loads(), domain, *arguments, watches=watches)[0]


def _column(design: Design, name: str) -> np.ndarray:
    return design.trace[:, TRACE.index(name)]


@pytest.mark.parametrize("coupling", ["stiffness", "paper"])
@pytest.mark.parametrize("kind", [{}, NETWORK])
def test_the_total_loss_at_exact_volume_has_the_gradient_of_finite_differences(domain, coupling, kind):
    problem = replace(_problem(domain, coupling=coupling, volume="exact", **kind), sharpness=2.0)
    firm = firmness(problem, segment_by_energy(problem))
    theta = problem.triangles.field.start(1, 0.5)
    measure = reference(problem, evaluate(problem, firm, theta, level_for_volume(problem, firm, theta)))
    weights = torch.tensor([0.5, 0.8, 0.6, 0.3, 0.02], dtype=torch.float64)

    def total(at: torch.Tensor) -> torch.Tensor:
        evaluation = evaluate(problem, firm, at, level_for_volume(problem, firm, at))
        return (weights * normalised(evaluation, measure, coupling)).sum()

    at = theta.clone().requires_grad_()
    (slope,) = torch.autograd.grad(total(at), at)
    direction = torch.randn(theta.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    with torch.no_grad():
        near, far = (
            (total(theta + h * direction) - total(theta - h * direction)).item() for h in (1e-3, 2e-3)
        )
    assert (slope * direction).sum().item() == pytest.approx((8 * near - far) / 12e-3, rel=1e-6)


@pytest.mark.parametrize("kind", [{}, NETWORK])
def test_an_exact_volume_is_exact_in_every_iteration_and_the_design_still_improves(domain, tmp_path, kind):
    design = _optimize(domain, tmp_path, volume="exact", iterations=15, **kind)
    np.testing.assert_allclose(_column(design, "volume_fraction"), 0.4, atol=1e-12)
    assert design.history[-1, -1] < design.history[0, -1] - 0.05
    assert design.history[:, 3].max() < 1e-20


def test_a_penalised_volume_leaves_the_target_and_comes_near_it(domain, tmp_path):
    missed = np.abs(_column(_optimize(domain, tmp_path, iterations=30), "volume_fraction") - 0.4)
    assert missed[0] < 1e-9
    assert 1e-6 < missed[-1] < 0.05


def test_an_exact_volume_out_of_reach_is_refused(domain, tmp_path):
    with pytest.raises(SolverError, match="volume"):
        _optimize(domain, tmp_path, volume="exact", volume_fraction=0.95)


def test_schedules_end_where_the_settings_say(domain):
    problem = _problem(domain, p_norm_start=4.0, sharpness_end=9.0, learning_rate=0.2, learning_rate_end=0.5)
    seen = [at_iteration(problem, iteration) for iteration in (0, 3, 9, 12)]
    assert [now.settings.p_norm for now in seen] == pytest.approx([4.0, 4.0 * 5 ** (1 / 3), 20.0, 20.0])
    assert [now.sharpness for now in seen] == pytest.approx([1.0, 9 ** (1 / 3), 9.0, 9.0])
    rates = [learning_rate(problem.settings, iteration) for iteration in (0, 9)]
    assert rates == pytest.approx([0.2, 0.1])
    assert at_iteration(_problem(domain), 5).sharpness == 1.0


def test_a_run_follows_its_schedules(domain, tmp_path):
    design = _optimize(domain, tmp_path, p_norm_start=4.0, sharpness_end=3.0)
    assert (_column(design, "p_norm")[[0, -1]] == [4.0, 20.0]).all()
    assert _column(design, "sharpness")[-1] == pytest.approx(3.0)
    assert np.isnan(_column(design, "learning_rate")[-1])


def test_a_short_gradient_limit_changes_the_step_not_the_gradient_that_is_told(domain, tmp_path):
    free, short = (
        _optimize(domain, tmp_path / name, gradient_limit=limit)
        for name, limit in (("free", 0.0), ("short", 1e-9))
        if not (tmp_path / name).mkdir()
    )
    assert _column(free, "gradient_norm")[0] == _column(short, "gradient_norm")[0] > 1e-6
    assert not np.array_equal(free.parameters, short.parameters)


def test_patience_ends_a_loop_that_stands_still(domain, tmp_path):
    design = _optimize(domain, tmp_path, iterations=60, patience=5, learning_rate=1e-9)
    assert design.iterations == 6
    assert len(design.history) == len(design.trace) == 7
    assert design.film_iterations[-1] == 6


def test_patience_waits_as_long_as_the_loss_falls():
    settings = _settings(iterations=100, patience=3)
    falling = np.linspace(2.0, 1.0, 40)
    assert not is_done(settings, falling)
    assert not is_done(settings, np.append(falling, [1.0, 1.0]))
    assert is_done(settings, np.append(falling, [1.0, 1.0, 1.0]))
    assert not is_done(_settings(iterations=100), np.ones(99))
    assert is_done(_settings(iterations=100), np.ones(100))


def test_noise_is_drawn_from_a_state_that_goes_on():
    whole, _ = drawn(first_generator(4), 7)
    first, state = drawn(first_generator(4), 3)
    rest, _ = drawn(state, 4)
    np.testing.assert_array_equal(np.append(first, rest), whole)
    assert not np.array_equal(drawn(first_generator(5), 7)[0], whole)


def test_noise_changes_the_design_and_has_faded_at_the_end(domain, tmp_path):
    calm, noisy = (
        _optimize(domain, tmp_path / str(noise), gradient_noise=noise)
        for noise in (0.0, 0.5)
        if not (tmp_path / str(noise)).mkdir()
    )
    assert not np.array_equal(calm.parameters, noisy.parameters)
    assert noisy.history[-1, -1] < noisy.history[0, -1]


def test_a_refresh_segments_by_the_energy_of_the_present_moduli(domain, tmp_path):
    problem = _problem(domain)
    plain = segment_by_energy(problem)
    np.testing.assert_array_equal(segment_by_energy(problem, np.full(len(plain), 7.0)), plain)
    stiff_below = np.where(domain.vertices[domain.triangles, 1].mean(axis=1) < 0, 50.0, 1.0)
    assert (segment_by_energy(problem, stiff_below) != plain).mean() > 0.02
    design = _optimize(domain, tmp_path, segmentation_every=4)
    firm = _column(design, "firm_share")
    assert (firm[:4] == firm[0]).all()
    assert (firm[4:8] == firm[4]).all()
    assert np.isfinite(design.history).all()


def test_snapshots_are_even_and_the_last_is_the_design(domain, tmp_path):
    design = _optimize(domain, tmp_path)
    assert design.film_iterations.tolist() == [0, 3, 6, 9, 10]
    np.testing.assert_allclose(design.film[-1] / 255.0, design.d_vertex, atol=0.5 / 255 + 1e-12)
    assert np.ptp(design.film[0].astype(int)) < np.ptp(design.film[-1].astype(int))


def test_no_snapshots_are_kept_where_none_are_wanted():
    assert not any(is_snapshot(_settings(snapshots=0), iteration) for iteration in range(5))
    assert [i for i in range(7) if is_snapshot(_settings(iterations=7, snapshots=400), i)] == list(range(7))


def test_watches_see_every_iteration_and_may_end_the_loop(domain, tmp_path):
    seen: list[Snapshot] = []
    design = _optimize(domain, tmp_path, watches=(seen.append,))
    assert [snapshot.iteration for snapshot in seen] == list(range(1, 11))
    assert {snapshot.iterations for snapshot in seen} == {10}
    np.testing.assert_array_equal([snapshot.terms for snapshot in seen], design.history[:-1, :5])
    np.testing.assert_array_equal([snapshot.total for snapshot in seen], design.history[:-1, -1])
    assert seen[3]["ratio_vs_uniform"] == _column(design, "ratio_vs_uniform")[3]
    assert seen[-1].seconds_left == 0.0 < seen[0].seconds_left
    for word in ("L1", "L5", "ratio", "s left"):
        assert word in told(seen[0])

    class Enough(Exception):
        pass

    def stop(snapshot: Snapshot) -> None:
        raise Enough

    (tmp_path / "other").mkdir()
    with pytest.raises(Enough):
        _optimize(domain, tmp_path / "other", watches=(stop,))


def test_the_trace_ends_with_the_designs_own_figures(domain, tmp_path):
    design = _optimize(domain, tmp_path)
    last = dict(zip(TRACE, design.trace[-1], strict=True))
    assert last["frontal_nm_per_deg"] == pytest.approx(design.stiffness[1], rel=1e-9)
    assert last["sagittal_nm_per_deg"] == pytest.approx(design.stiffness[0], rel=1e-9)
    assert last["volume_fraction"] == pytest.approx(design.volume_fraction, abs=1e-12)


def test_the_first_generator_and_state_are_the_seeds(domain):
    one, two = (first_state(_problem(domain, seed=seed), "") for seed in (1, 2))
    assert one.generator != two.generator
    assert not np.array_equal(one.theta, two.theta)


def test_the_course_is_drawn_with_the_same_bytes(domain, tmp_path):
    design = _optimize(domain, tmp_path, segmentation_every=4)
    pictures = [tmp_path / "one.png", tmp_path / "two.png"]
    for path in pictures:
        write_history_picture(design, path)
    assert pictures[0].read_bytes() == pictures[1].read_bytes()
    assert pictures[0].read_bytes().startswith(b"\x89PNG")
