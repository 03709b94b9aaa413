"""Exact gradients: every output by modulus, thickness and loads, for every way to give shapes to frames."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hilbrace.shell import (
    LoadPattern,
    NodalLoads,
    build_shell,
    element_energies,
    family_compliance,
    family_response,
    family_stiffness,
    geometry_mode,
    joint_line_shares,
    lay_on_skin,
    shell_family,
    shell_response,
    skin,
)
from tests.unit.shell_cases import bent_frames, tube

FRAMES = 5
SHELL = build_shell(*tube(8, 5, 30.0, 80.0, waviness=0.1, window=True), 3.0, 0.45)
POSED = bent_frames(SHELL.vertices, FRAMES)
SHARES = joint_line_shares(SHELL.vertices, SHELL.triangles, 30.0)
FAMILIES = {text: shell_family(SHELL, POSED, geometry_mode(text)) for text in ("rest", "clusters:2", "frame")}
BORNE = lay_on_skin(SHELL, skin(SHELL.vertices, 0.02, 0.3))
ON_SKIN = {text: shell_family(BORNE, POSED, geometry_mode(text)) for text in FAMILIES}
OUTPUTS = ("compliance", "reactions", "loop_stiffness", "energies")
STEP = 1e-4


def start():
    """Modulus, thickness, forces of a pattern and forces on single vertices; and a direction for each."""
    rng = np.random.default_rng(4)
    triangles, vertices = len(SHELL.triangles), len(SHELL.vertices)
    at = {
        "modulus": rng.uniform(0.2, 1.0, triangles),
        "thickness": rng.uniform(2.0, 4.0, triangles),
        "forces": rng.standard_normal((FRAMES, 3)),
        "nodal": rng.standard_normal((FRAMES, vertices, 3)),
    }
    along = {name: value * rng.uniform(-1.0, 1.0, value.shape) for name, value in at.items()}
    return {k: torch.from_numpy(v) for k, v in at.items()}, {k: torch.from_numpy(v) for k, v in along.items()}


def response(at, family):
    load = NodalLoads(at["nodal"]) if "nodal" in at else LoadPattern(SHARES, at["forces"])
    return family_response(at["modulus"], family, load, at.get("thickness"))


def output_of(answer, output):
    return element_energies(answer) if output == "energies" else getattr(answer, output)


def loss(at, family, output):
    """A curved function of an output, with generic weights."""
    value = output_of(response(at, family), output)
    weight = torch.from_numpy(np.random.default_rng(7).uniform(0.5, 1.5, value.shape))
    scale = 30.0 if output == "energies" else 300.0
    return (weight * torch.tanh(value / scale)).sum()


def moved(at, along, variable, step):
    return {**at, variable: at[variable] + step * along[variable]}


def slope(at, along, variable, family, output):
    at = {**at, variable: at[variable].clone().requires_grad_()}
    (gradient,) = torch.autograd.grad(loss(at, family, output), at[variable], allow_unused=True)
    return 0.0 if gradient is None else (gradient * along[variable]).sum().item()


def measured(at, along, variable, family, output):
    """Fourth-order central difference."""
    ahead, back, far, behind = (
        loss(moved(at, along, variable, step), family, output).item()
        for step in (STEP, -STEP, 2 * STEP, -2 * STEP)
    )
    return (8.0 * (ahead - back) - (far - behind)) / (12.0 * STEP)


CASES = [
    (mode, variable, output)
    for mode in FAMILIES
    for variable in ("modulus", "thickness", "forces", "nodal")
    for output in OUTPUTS
    if not (variable in ("forces", "nodal") and output == "loop_stiffness")
]


@pytest.mark.parametrize(("mode", "variable", "output"), CASES)
def test_gradient_matches_finite_differences(mode, variable, output):
    at, along = start()
    at.pop("forces" if variable == "nodal" else "nodal")
    if variable != "thickness":
        at.pop("thickness")
    args = (at, along, variable, FAMILIES[mode], output)
    assert slope(*args) == pytest.approx(measured(*args), rel=1e-6)


@pytest.mark.parametrize("mode", FAMILIES)
@pytest.mark.parametrize("variable", ["modulus", "thickness"])
@pytest.mark.parametrize("output", OUTPUTS)
def test_gradient_matches_finite_differences_for_nodal_loads(mode, variable, output):
    at, along = start()
    at.pop("forces")
    if variable != "thickness":
        at.pop("thickness")
    args = (at, along, variable, FAMILIES[mode], output)
    assert slope(*args) == pytest.approx(measured(*args), rel=1e-6)


@pytest.mark.parametrize(("mode", "variable", "output"), CASES)
def test_gradient_matches_finite_differences_on_skin(mode, variable, output):
    at, along = start()
    at.pop("forces" if variable == "nodal" else "nodal")
    if variable != "thickness":
        at.pop("thickness")
    args = (at, along, variable, ON_SKIN[mode], output)
    assert slope(*args) == pytest.approx(measured(*args), rel=1e-6)


@pytest.mark.parametrize("mode", FAMILIES)
@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("variable", ["modulus", "thickness", "forces"])
def test_taylor_remainder_falls_with_the_square_of_the_step(mode, variable, output):
    if (variable, output) == ("forces", "loop_stiffness"):
        return
    at, along = start()
    at.pop("nodal")
    family = FAMILIES[mode]
    value, gradient = loss(at, family, output).item(), slope(at, along, variable, family, output)
    steps = np.array([4e-2, 2e-2, 1e-2, 5e-3])
    remainder = [
        abs(loss(moved(at, along, variable, h), family, output).item() - value - h * gradient) for h in steps
    ]
    assert np.polyfit(np.log(steps), np.log(remainder), 1)[0] == pytest.approx(2.0, abs=0.1)


def test_gradient_through_all_outputs_at_once_is_the_sum_of_the_single_ones():
    at, _ = start()
    at.pop("nodal")
    family = FAMILIES["clusters:2"]
    at["modulus"].requires_grad_()
    answer = response(at, family)
    total = sum(output_of(answer, output).square().sum() for output in OUTPUTS)
    (together,) = torch.autograd.grad(total, at["modulus"])
    single = [
        torch.autograd.grad(output_of(response(at, family), output).square().sum(), at["modulus"])[0]
        for output in OUTPUTS
    ]
    torch.testing.assert_close(together, sum(single), rtol=1e-9, atol=1e-9 * together.abs().max().item())


@pytest.mark.parametrize("mode", FAMILIES)
def test_short_forms_agree_with_the_full_response_and_its_gradient(mode):
    at, _ = start()
    load = LoadPattern(SHARES, at["forces"])
    modulus, family = at["modulus"].requires_grad_(), FAMILIES[mode]
    full = family_response(modulus, family, load)
    for short, part in (
        (family_compliance(modulus, family, load), full.compliance),
        (family_stiffness(modulus, family.shells), full.loop_stiffness),
    ):
        torch.testing.assert_close(short, part, rtol=1e-9, atol=1e-9)
        by_short, by_part = (
            torch.autograd.grad(value.square().sum(), modulus, retain_graph=True)[0]
            for value in (short, part)
        )
        torch.testing.assert_close(by_short, by_part, rtol=1e-8, atol=1e-9 * by_part.abs().max().item())


def test_pattern_and_the_same_loads_on_single_vertices_give_one_answer():
    at, _ = start()
    nodal = torch.from_numpy(SHARES)[None, :, None] * at["forces"][:, None, :]
    pattern = shell_response(at["modulus"], SHELL, LoadPattern(SHARES, at["forces"]))
    single = shell_response(at["modulus"], SHELL, NodalLoads(nodal))
    for output in OUTPUTS:
        one, other = output_of(pattern, output), output_of(single, output)
        torch.testing.assert_close(other, one, rtol=1e-9, atol=1e-11 * one.abs().max().item())
