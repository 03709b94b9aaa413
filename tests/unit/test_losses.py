"""The loss table, term by term, against the formulas written out, and gradients against differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.optimize import losses

DOUBLE = torch.float64


def test_joint_stability_is_the_table_row():
    angles = torch.tensor([[1.0, 0.2, 0.0], [0.5, -0.1, 0.0]], dtype=DOUBLE)
    change = torch.tensor([[0.1, -0.05, 0.3], [0.0, 0.05, 0.3]], dtype=DOUBLE)
    stability = losses.joint_stability(angles, change, preserve=(0,), prevent=(1,))
    assert float(stability.preserved) == pytest.approx((0.1**2 + 0.0) / 2)
    assert float(stability.prevented) == pytest.approx((0.15**2 + 0.05**2) / 2)
    assert float(stability.effect) == pytest.approx((2 * 0.2 * 0.05 + 0.05**2 + 2 * 0.1 * 0.05 + 0.05**2) / 2)
    assert float(stability.loss) == pytest.approx(float(stability.preserved + stability.prevented))


def test_elastic_energy_does_not_depend_on_the_mesh():
    modulus, energy = torch.tensor([2.0, 3.0], dtype=DOUBLE), torch.tensor([0.1, 0.4], dtype=DOUBLE)
    coarse = losses.elastic_energy(modulus, energy, torch.tensor([4.0, 4.0], dtype=DOUBLE))
    assert float(coarse) == pytest.approx(2.0 * 0.1 + 3.0 * 0.4)
    halves = torch.tensor([2.0] * 4, dtype=DOUBLE)
    fine = losses.elastic_energy(modulus.repeat_interleave(2), energy.repeat_interleave(2), halves)
    assert float(fine) / 4 == pytest.approx(float(coarse) / 2)


@given(st.lists(st.floats(1e-3, 1e6), min_size=1, max_size=30), st.floats(1.0, 60.0))
def test_compliance_lies_between_the_largest_and_the_root_of_the_count(values, exponent):
    energies = torch.tensor(values, dtype=DOUBLE)
    loss = float(losses.compliance(energies, exponent))
    assert loss >= max(values) * (1 - 1e-12)
    assert loss <= max(values) * len(values) ** (1 / exponent) * (1 + 1e-12)


def test_compliance_is_the_table_row():
    energies = torch.tensor([1.0, 2.0, 4.0], dtype=DOUBLE)
    assert float(losses.compliance(energies, 3.0)) == pytest.approx(
        0.5 * (2.0**3 + 4.0**3 + 8.0**3) ** (1 / 3)
    )


def test_volume_is_zero_at_the_target_only():
    areas = torch.tensor([1.0, 3.0], dtype=DOUBLE)
    assert float(losses.volume(torch.tensor([0.7, 0.3], dtype=DOUBLE), areas, 0.4)) == pytest.approx(
        0, abs=1e-30
    )
    assert float(losses.volume(torch.tensor([0.44, 0.44], dtype=DOUBLE), areas, 0.4)) == pytest.approx(0.01)


def test_seam_counts_jumps():
    d = torch.tensor([0.2, 0.5, 0.25, 0.5], dtype=DOUBLE)
    assert float(losses.seam(d, torch.tensor([[0, 2], [1, 3]]))) == pytest.approx(0.0025)


def _stability(*sums: float) -> losses.Stability:
    return losses.Stability(*(torch.tensor(value, dtype=DOUBLE) for value in sums))


def _start() -> tuple[losses.Stability, torch.Tensor, losses.Scales]:
    stability = _stability(0.02, 0.9, 0.1)
    terms = torch.tensor([0.92, 5.0, 7.0, 0.0, 0.0], dtype=DOUBLE)
    return stability, terms, losses.scales(stability, terms, seam_pairs=10)


def test_every_loss_that_is_not_zero_starts_at_one():
    stability, terms, scale = _start()
    np.testing.assert_allclose(
        losses.normalised(stability, terms, scale).numpy(), [1, 1, 1, 0, 0], atol=1e-12
    )


def test_volume_and_seam_are_measured_by_a_five_per_cent_error():
    stability, terms, scale = _start()
    terms = terms.clone()
    terms[3], terms[4] = losses.TOLERANCE**2, 10 * losses.TOLERANCE**2
    np.testing.assert_allclose(losses.normalised(stability, terms, scale).numpy(), [1, 1, 1, 1, 1])


def test_a_unit_of_support_takes_its_share_off_the_stability_loss():
    _, _, scale = _start()
    better = _stability(0.02, 0.9 - losses.SUPPORT_UNIT * 0.1, 0.2)
    assert float(losses.relative_stability(better, scale)) == pytest.approx(losses.PRESERVED_SHARE)
    worse = _stability(0.08, 0.9, 0.1)
    assert float(losses.relative_stability(worse, scale)) == pytest.approx(1 + 3 * losses.PRESERVED_SHARE)


def test_with_the_papers_coupling_the_stability_loss_is_divided_by_its_start():
    stability, terms, _ = _start()
    scale = losses.scales(stability, terms, seam_pairs=10, coupling="paper")
    assert float(losses.relative_stability(stability, scale)) == pytest.approx(1.0)
    other = _stability(0.05, 0.3, 0.7)
    assert float(losses.relative_stability(other, scale)) == pytest.approx((0.05 + 0.3) / (0.02 + 0.9))


@pytest.mark.parametrize("term", ["elastic_energy", "compliance", "volume", "seam"])
def test_gradients_are_those_of_finite_differences(term: str):
    generator = torch.Generator().manual_seed(1)
    values = torch.rand(6, generator=generator, dtype=DOUBLE) + 0.1
    areas = torch.rand(6, generator=generator, dtype=DOUBLE) + 0.5
    functions = {
        "elastic_energy": lambda x: losses.elastic_energy(x, areas, areas.flip(0)),
        "compliance": lambda x: losses.compliance(x, 20.0),
        "volume": lambda x: losses.volume(x, areas, 0.4),
        "seam": lambda x: losses.seam(x, torch.tensor([[0, 1], [2, 5]])),
    }
    assert torch.autograd.gradcheck(functions[term], (values.requires_grad_(),), eps=1e-6, atol=1e-7)
