"""The loss table, term by term, against the formulas written out, and gradients against differences."""

from __future__ import annotations

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
    assert float(stability.relieved) == pytest.approx((0.2**2 + 0.1**2) / 2 - float(stability.prevented))
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
