"""From the field's parameters to the losses: one forward pass of the design loop."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.field import project
from hilbrace.optimize import losses
from hilbrace.optimize.brace_response import BraceResponse, brace_response
from hilbrace.optimize.coupling import COUPLINGS, Prediction, brace_spring
from hilbrace.optimize.problem import Place, Problem, seam_pairs, width_limits
from hilbrace.shell import SolverPool

CONTRAST = 2.0
"""Change of the sigmoid's argument when all neurons around a point change by one [-]."""


@dataclass(frozen=True)
class Firmness:
    """The firm fraction at the two places where the field is sampled.

    Attributes:
        triangles: At triangle centres [-].
        vertices: At the cut vertices [-].
    """

    triangles: Float[Tensor, " triangle"]
    vertices: Float[Tensor, " cut_vertex"]


@dataclass(frozen=True)
class Material:
    """What a field means at the triangles.

    Attributes:
        d: Design variable [-].
        modulus: Effective Young's modulus [MPa].
        volume: Volume fraction [-].
    """

    d: Float[Tensor, " triangle"]
    modulus: Float[Tensor, " triangle"]
    volume: Float[Tensor, " triangle"]


@dataclass(frozen=True)
class Mechanics:
    """What a modulus does.

    Attributes:
        response: Compliance and reactions of every frame, and stiffness in every posture.
        prediction: What the brace does to the joint, by the coupling of the settings.
    """

    response: BraceResponse
    prediction: Prediction


@dataclass(frozen=True)
class Evaluation:
    """One forward pass.

    Attributes:
        material: The field's meaning.
        mechanics: Its consequences.
        stability: The two sums of L1.
        support: Stiffness of the brace about the prevented angles in each posture [N*m/rad].
        terms: L1..L5, not normalised.
    """

    material: Material
    mechanics: Mechanics
    stability: losses.Stability
    support: Float[Tensor, "posture angle"]
    terms: Float[Tensor, "5"]


def design_variable(
    problem: Problem,
    place: Place,
    firm: Float[Tensor, " point"],
    theta: Float[Tensor, "*layer"],
    bias: Float[Tensor, ""],
) -> Float[Tensor, " point"]:
    """The field, projected into the range that can be cast (paper, Sec. 6).

    Args:
        problem: The design task.
        place: Where to sample.
        firm: Firm fraction there.
        theta: Parameters of the field.
        bias: Level of the field.
    """
    low, high = width_limits(problem, place, firm)
    return low + (high - low) * project(place.field.logits(theta, CONTRAST), bias, problem.sharpness)


def material_of(
    problem: Problem, d: Float[Tensor, " triangle"], firm: Float[Tensor, " triangle"]
) -> Material:
    """Modulus and volume fraction of the triangles; the rims are solid."""
    modulus = problem.solid_modulus * problem.cells.modulus(d, firm)
    volume = problem.cells.volume(d, firm)
    solid = torch.full_like(d, problem.solid_modulus)
    return Material(
        d, torch.where(problem.rim, solid, modulus), torch.where(problem.rim, torch.ones_like(d), volume)
    )


def fraction_of(problem: Problem, material: Material) -> float:
    """Mean volume fraction of a brace [-]."""
    return float((material.volume * problem.areas).sum() / problem.areas.sum())


def mechanics_of(
    problem: Problem, modulus: Float[Tensor, " triangle"], solvers: SolverPool | None = None
) -> Mechanics:
    """Solve the shell and let the joint respond, by the coupling of the settings."""
    response = brace_response(problem, modulus, solvers)
    return Mechanics(response, COUPLINGS[problem.settings.coupling](problem, response))


def support_of(problem: Problem, response: BraceResponse) -> Float[Tensor, "posture angle"]:
    """Stiffness of a brace about the prevented angles in each posture [N*m/rad]."""
    about = torch.diagonal(brace_spring(problem, response.loops).stiffness, dim1=1, dim2=2)
    return about[:, list(problem.prevent)]


def evaluate(
    problem: Problem,
    firm: Firmness,
    theta: Float[Tensor, "*layer"],
    bias: Float[Tensor, ""],
    solvers: SolverPool | None = None,
) -> Evaluation:
    """Losses of a field.

    Args:
        problem: The design task.
        firm: The firm and soft map.
        theta: Parameters of the field.
        bias: Level of the field.
        solvers: Open solvers of the shell's sparsity; own ones if left out.
    """
    d = design_variable(problem, problem.triangles, firm.triangles, theta, bias)
    d_vertex = design_variable(problem, problem.vertices, firm.vertices, theta, bias)
    return evaluate_material(problem, material_of(problem, d, firm.triangles), d_vertex, solvers)


def evaluate_material(
    problem: Problem,
    material: Material,
    d_vertex: Float[Tensor, " cut_vertex"],
    solvers: SolverPool | None = None,
) -> Evaluation:
    """Losses of a brace whose material is given, whatever wrote it.

    Args:
        problem: The design task.
        material: Design variable, modulus and volume fraction of the triangles.
        d_vertex: Design variable at the cut vertices [-].
        solvers: Open solvers of the shell's sparsity; own ones if left out.
    """
    mechanics = mechanics_of(problem, material.modulus, solvers)
    stability = losses.joint_stability(
        problem.motion.angles, mechanics.prediction.change, problem.preserve, problem.prevent
    )
    terms = torch.stack(
        [
            stability.loss,
            losses.elastic_energy(material.modulus, problem.unit_energy, problem.areas),
            losses.compliance(mechanics.response.frames.compliance, problem.settings.p_norm),
            losses.volume(material.volume, problem.areas, problem.settings.volume_fraction),
            losses.seam(d_vertex, seam_pairs(problem.domain)),
        ]
    )
    return Evaluation(material, mechanics, stability, support_of(problem, mechanics.response), terms)
