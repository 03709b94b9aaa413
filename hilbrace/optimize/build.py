"""The optimize stage: from loads and domain to the design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.config import MaterialSettings, OptimizeSettings, PatternSettings
from hilbrace.domain.domain import Domain
from hilbrace.optimize.brace_response import posture_stiffness
from hilbrace.optimize.coupling import brace_spring
from hilbrace.optimize.design import Design
from hilbrace.optimize.evaluate import Material, design_variable, fraction_of
from hilbrace.optimize.flexion_moment import moment_curves, stiffness_by_energy
from hilbrace.optimize.history import Watch
from hilbrace.optimize.loop import Outcome, run_loop
from hilbrace.optimize.predictions import predict
from hilbrace.optimize.problem import Problem, build_problem
from hilbrace.optimize.pulls import pulls
from hilbrace.optimize.state import measure_of
from hilbrace.optimize.uniform import uniform_design
from hilbrace.run.processors import processors
from hilbrace.run.progress import Report, silent
from hilbrace.shell import SolverPool, open_pool
from hilbrace.units import DEG

Array = np.ndarray


def optimize_design(
    loads: JointLoads,
    domain: Domain,
    settings: OptimizeSettings,
    material: MaterialSettings,
    pattern: PatternSettings,
    checkpoint: Path,
    key: str = "",
    progress: Report = silent,
    watches: Sequence[Watch] = (),
) -> tuple[Design, float]:
    """Optimize the distribution of the microstructures.

    Args:
        loads: Kinematics and loads of the joints.
        domain: The brace's surface and its motion.
        settings: The optimizer's settings.
        material: The rubber and its microstructures.
        pattern: Scale, limits of casting and rims.
        checkpoint: File that an interrupted run goes on from.
        key: What the checkpoint must belong to.
        progress: Called with (iterations done, iterations in all).
        watches: Called with a snapshot of the loop after every iteration.

    Returns:
        The design, and the median time of an iteration [s].

    Raises:
        SolverError: A loss is not finite, or no field has the wanted volume.
    """
    problem = build_problem(loads, domain, settings, material, pattern)
    sparsity = problem.shapes.shells[0].numbering.sparsity
    with open_pool(sparsity, settings.solver, processors()) as solvers:
        done = run_loop(problem, checkpoint, key, progress, solvers, watches)
        return _design(loads, done, _compared(done, solvers)), done.seconds


@dataclass(frozen=True)
class _Comparison:
    """What the finished loop is set beside: the field at vertices, the uniform brace, the losses' pulls."""

    d_vertex: Float[Tensor, " cut_vertex"]
    uniform: Material
    loops: Float[Tensor, "posture 12 12"]
    pulls: Float[Array, "loss triangle"]
    solver: str


def _compared(done: Outcome, solvers: SolverPool) -> _Comparison:
    problem, state, firm, last = done.problem, done.state, done.firm, done.evaluation
    with torch.no_grad():
        d_vertex = design_variable(problem, problem.vertices, firm.vertices, *state.tensors())
    uniform = uniform_design(problem, fraction_of(problem, last.material))
    loops = posture_stiffness(problem, uniform.modulus, solvers)
    wanted = pulls(problem, firm, last.material.d.numpy(), d_vertex.numpy(), measure_of(state), solvers)
    return _Comparison(d_vertex, uniform, loops, wanted, solvers.name)


def _design(loads: JointLoads, done: Outcome, beside: _Comparison) -> Design:
    problem, state, firm, last = done.problem, done.state, done.firm, done.evaluation
    settings, domain = problem.settings, problem.domain
    d_vertex, uniform = beside.d_vertex, beside.uniform
    response = last.mechanics.response
    stiffness, stiffness_uniform = _per_degree(problem, response.loops), _per_degree(problem, beside.loops)
    moduli = (last.material.modulus.numpy(), uniform.modulus.numpy())
    curves = moment_curves(problem, loads, moduli, (stiffness / DEG, stiffness_uniform / DEG))
    predicted = predict(problem, loads, response)
    reactions = response.frames.reactions.numpy()
    return Design(
        seed=settings.seed,
        iterations=state.iteration,
        solver=beside.solver,
        shapes=len(problem.shapes.shells),
        parameters=state.theta,
        d_triangle=last.material.d.numpy(),
        d_vertex=d_vertex.numpy(),
        width_triangle=problem.cells.width(last.material.d, firm.triangles).numpy(),
        width_vertex=problem.cells.width(d_vertex, firm.vertices).numpy(),
        youngs_modulus=last.material.modulus.numpy(),
        volume_fraction_triangle=last.material.volume.numpy(),
        firm_triangle=firm.triangles.numpy(),
        firm_vertex=_closed(firm.vertices.numpy(), domain),
        rim=problem.rim.numpy(),
        energy_density=problem.unit_energy.numpy(),
        pulls=beside.pulls,
        history=state.history,
        trace=state.trace,
        film=state.film,
        film_iterations=state.film_iterations,
        losses_initial=state.losses_initial,
        losses_final=last.terms.numpy(),
        stiffness=stiffness[problem.rest_posture],
        stiffness_uniform=stiffness_uniform[problem.rest_posture],
        stiffness_flexions=np.array([posture.flexion for posture in problem.postures]),
        stiffness_posed=stiffness,
        stiffness_posed_uniform=stiffness_uniform,
        stiffness_by_energy=stiffness_by_energy(problem, moduli[0]) * DEG,
        moment_flexions=curves.flexion,
        moment_held=curves.held,
        moment_free=curves.free,
        coupling=settings.coupling,
        angle_changes=predicted.angle_change,
        contact_force_change=predicted.contact_force_change,
        contact_moment_change=predicted.contact_moment_change,
        passive_levels=predicted.levels,
        passive_sensitivity=predicted.sensitivity,
        reaction_upper=reactions[:, 0:3],
        reaction_lower=reactions[:, 6:9],
        volume_fraction=fraction_of(problem, last.material),
        volume_fraction_uniform=fraction_of(problem, uniform),
    )


def _per_degree(problem: Problem, loops: Float[Tensor, "posture 12 12"]) -> Float[Array, "posture 3"]:
    """Diagonal of the brace's stiffness about the joint's axes in each posture [N*m/deg]."""
    spring = brace_spring(problem, loops)
    return torch.diagonal(spring.stiffness, dim1=1, dim2=2).numpy() * DEG


def _closed(at_cut_vertices: Float[Array, " cut_vertex"], domain: Domain) -> Float[Array, " vertex"]:
    """Values of the closed mesh's vertices; copies along the seam hold the same value."""
    closed = np.zeros(len(domain.vertices))
    closed[domain.weld] = at_cut_vertices
    return closed
