"""Condensed shells as torch functions of modulus, thickness and loads, with exact discrete adjoints.

The mathematics of one shell is in `hilbrace.shell.condensation`. Here several shells of one sparsity, the
shapes of a brace in the frames of a motion, are condensed side by side for one and the same modulus.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from hilbrace.errors import SolverError
from hilbrace.shell.condensation import (
    Condensed,
    Weights,
    by_loads,
    by_stiffness,
    condense,
    follow_displacements,
)
from hilbrace.shell.element import NODE_DOFS
from hilbrace.shell.loops import LOOP_DOFS
from hilbrace.shell.maps import field_energies, field_forces
from hilbrace.shell.model import ShellModel, thicken_shell, thickness_slopes
from hilbrace.shell.pool import SolverPool, open_pool, side_by_side
from hilbrace.shell.solver import Solver

Array = np.ndarray


@dataclass(frozen=True)
class SolvedShell:
    """One condensed shell; tensors that remember how they depend on modulus, thickness and loads.

    Attributes:
        shell: The shell, at the thickness it was solved with.
        modulus: Young's modulus of each triangle [MPa].
        thickness: Thickness of each triangle [mm], if it is a variable.
        flexibility: Work of one load on the displacements of another [N*mm].
        sharing: Wrench of each load that the loops balance [N, N*mm]; empty without static modes.
        loop_stiffness: Stiffness between the motions of the loops; empty without static modes.
        displacements: Displacements of the free degrees of freedom under each load [mm, rad].
        modes: Displacements of the same per unit motion of a loop; plain numbers.
    """

    shell: ShellModel
    modulus: Float[Tensor, " triangle"]
    thickness: Float[Tensor, " triangle"] | None
    flexibility: Float[Tensor, "load load"]
    sharing: Float[Tensor, "mode load"]
    loop_stiffness: Float[Tensor, "mode mode"]
    displacements: Float[Tensor, "free load"]
    modes: Float[Array, "free mode"]


def condense_shells(
    modulus: Float[Tensor, " triangle"],
    shells: Sequence[ShellModel],
    loads: Sequence[Float[Tensor, "_ vertex 3"]],
    modes: bool,
    thickness: Float[Tensor, " triangle"] | None = None,
    solvers: SolverPool | None = None,
) -> list[SolvedShell]:
    """Condense shells of one sparsity onto their loads and the motions of their loops.

    Args:
        modulus: Young's modulus of each triangle [MPa].
        shells: The shells.
        loads: Forces on the vertices of each shell [N].
        modes: Whether the motions of the loops are wanted as well; six solves more for each shell.
        thickness: Thickness of each triangle [mm]; that of the shells if left out. With it the element
            stiffness is computed anew each time, the dearest part by far.
        solvers: Solvers of the shells' sparsity; opened for this call alone if left out.

    Raises:
        SolverError: The modulus is not positive and finite, or a stiffness is singular.
        GeometryError: The thickness makes no shell.
    """
    _check_modulus(modulus.detach().numpy(), shells[0])
    variable = None if thickness is None else thickness.double()
    plan = _Plan(tuple(shells), LOOP_DOFS if modes else 0, solvers, [])
    flat = _Condense.apply(modulus.double(), variable, plan, *(load.double() for load in loads))
    return [
        SolvedShell(
            shell=shell,
            modulus=modulus.double(),
            thickness=variable,
            flexibility=flat[4 * k],
            sharing=flat[4 * k + 1],
            loop_stiffness=flat[4 * k + 2],
            displacements=flat[4 * k + 3],
            modes=modes,
        )
        for k, (shell, modes) in enumerate(plan.solved)
    ]


def field_energy(
    shape: SolvedShell, displacements: Float[Tensor, "free field"]
) -> Float[Tensor, "field triangle"]:
    """Twice the strain energy of every triangle in displacement fields, E_e u^T k0 u [N*mm].

    Args:
        shape: A condensed shell.
        displacements: Displacements of its free degrees of freedom, with the loops in place [mm, rad].
    """
    return _Energies.apply(shape.modulus, shape.thickness, displacements, shape.shell)


@dataclass(frozen=True)
class _Plan:
    """What the tensors do not say.

    `solved` is filled: the shells at the thickness that they were solved with, and their static modes.
    """

    shells: tuple[ShellModel, ...]
    modes: int
    solvers: SolverPool | None
    solved: list[tuple[ShellModel, Array]]


class _Condense(torch.autograd.Function):
    """(E, t, loads of each shell) -> (A, B, K_c, U) of each shell."""

    @staticmethod
    def forward(ctx: Any, modulus: Tensor, thickness: Tensor | None, plan: _Plan, *loads: Tensor) -> Any:
        ctx.set_materialize_grads(False)
        numbers = modulus.detach().numpy().copy()
        wall = None if thickness is None else thickness.detach().numpy().copy()

        def job(shell: ShellModel, load: Tensor, solver: Solver) -> tuple[ShellModel, Condensed]:
            at = shell if wall is None else thicken_shell(shell, wall)
            return at, condense(at, numbers, _on_dofs(load), plan.modes, solver)

        with _borrow(plan.solvers, plan.shells[0]) as pool:
            pairs = zip(plan.shells, loads, strict=True)
            answers = pool.run([partial(job, shell, load) for shell, load in pairs])
        plan.solved.extend((shell, state.fields[:, : plan.modes]) for shell, state in answers)
        ctx.plan, ctx.modulus, ctx.answers = plan, numbers, answers
        return tuple(
            torch.from_numpy(part)
            for _, state in answers
            for part in (state.flexibility, state.sharing, state.loop_stiffness, state.displacements)
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        wants_modulus, wants_thickness, _, *wants_loads = ctx.needs_input_grad

        def job(k: int, solver: Solver | None) -> _Gradient:
            shell, state = ctx.answers[k]
            return _pull_back(
                shell,
                state,
                ctx.modulus,
                _weights(state, grad_outputs[4 * k : 4 * k + 4]),
                (wants_modulus, wants_thickness, wants_loads[k]),
                solver,
            )

        jobs = [partial(job, k) for k in range(len(ctx.answers))]
        if all(gradient is None for gradient in grad_outputs[3::4]):
            parts = side_by_side([partial(job, None) for job in jobs], _threads(ctx.plan.solvers))
        else:
            with _borrow(ctx.plan.solvers, ctx.plan.shells[0]) as pool:
                parts = pool.run(jobs)
        return (
            _total([part.modulus for part in parts]),
            _total([part.thickness for part in parts]),
            None,
            *(part.loads for part in parts),
        )


class _Energies(torch.autograd.Function):
    """(E, t, u) -> E_e u^T k0 u."""

    @staticmethod
    def forward(
        ctx: Any, modulus: Tensor, thickness: Tensor | None, displacements: Tensor, shell: ShellModel
    ) -> Any:
        fields, numbers = displacements.detach().numpy(), modulus.detach().numpy().copy()
        unit = field_energies(shell.numbering, shell.maps, fields)
        ctx.shell, ctx.modulus, ctx.fields, ctx.unit = shell, numbers, fields, unit
        return torch.from_numpy(unit * numbers)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        (weights,) = (gradient.numpy() for gradient in grad_outputs)
        by_modulus = by_thickness = by_fields = None
        if ctx.needs_input_grad[0]:
            by_modulus = torch.from_numpy((weights * ctx.unit).sum(axis=0))
        if ctx.needs_input_grad[1]:
            slopes = thickness_slopes(ctx.shell)
            change = field_energies(ctx.shell.numbering, slopes, ctx.fields)
            by_thickness = torch.from_numpy((weights * change).sum(axis=0) * ctx.modulus)
        if ctx.needs_input_grad[2]:
            scale = 2.0 * weights * ctx.modulus
            by_fields = torch.from_numpy(field_forces(ctx.shell.numbering, ctx.shell.maps, scale, ctx.fields))
        return by_modulus, by_thickness, by_fields, None


@dataclass(frozen=True)
class _Gradient:
    """What one shell contributes to the gradient; None where it is not wanted."""

    modulus: Float[Array, " triangle"] | None
    thickness: Float[Array, " triangle"] | None
    loads: Float[Tensor, "load vertex 3"] | None


def _pull_back(
    shell: ShellModel,
    state: Condensed,
    modulus: Float[Array, " triangle"],
    weights: Weights,
    wanted: tuple[bool, bool, bool],
    solver: Solver | None,
) -> _Gradient:
    """Gradient of a loss by modulus, thickness and loads of one shell; losses on U need a solver."""
    adjoint = None
    if weights.displacements is not None and solver is not None:
        adjoint = follow_displacements(shell, modulus, weights.displacements, solver)
    by_modulus = by_thickness = on_vertices = None
    if wanted[0]:
        by_modulus = by_stiffness(shell, shell.maps, state, weights, adjoint)
    if wanted[1]:
        by_thickness = modulus * by_stiffness(shell, thickness_slopes(shell), state, weights, adjoint)
    if wanted[2]:
        moves = by_loads(shell, state, weights, adjoint)
        moves = moves.T.reshape(moves.shape[1], len(shell.vertices), NODE_DOFS)
        on_vertices = torch.from_numpy(np.ascontiguousarray(moves[:, :, :3]))
    return _Gradient(by_modulus, by_thickness, on_vertices)


def _weights(state: Condensed, gradients: Sequence[Tensor | None]) -> Weights:
    """Derivatives of the loss by A, B, K_c and U; zero where the loss does not see them."""
    seen = (state.flexibility, state.sharing, state.loop_stiffness)
    known = [
        np.zeros_like(value) if gradient is None else gradient.numpy()
        for value, gradient in zip(seen, gradients[:3], strict=True)
    ]
    return Weights(*known, displacements=None if gradients[3] is None else gradients[3].numpy())


def _total(parts: Sequence[Float[Array, " triangle"] | None]) -> Tensor | None:
    """Sum in the order of the shells, so that it does not depend on which thread is first."""
    found = [part for part in parts if part is not None]
    return torch.from_numpy(np.sum(found, axis=0)) if found else None


def _on_dofs(loads: Float[Tensor, "load vertex 3"]) -> Float[Array, "dof load"]:
    """Forces on the vertices as loads on all degrees of freedom, one load after the other in memory."""
    count, vertices, _ = loads.shape
    out = np.zeros((count, vertices, NODE_DOFS))
    out[:, :, :3] = loads.detach().numpy()
    return out.reshape(count, NODE_DOFS * vertices).T


def _threads(solvers: SolverPool | None) -> int:
    return torch.get_num_threads() if solvers is None else solvers.threads


@contextmanager
def _borrow(solvers: SolverPool | None, shell: ShellModel) -> Iterator[SolverPool]:
    """The caller's solvers, or ones that live for one call."""
    if solvers is None:
        with open_pool(shell.numbering.sparsity) as pool:
            yield pool
    elif solvers.sparsity is not shell.numbering.sparsity:
        raise SolverError(
            "the solvers belong to another shell",
            where="shell solver",
            hint="open the pool with the sparsity of this shell's numbering",
        )
    else:
        yield solvers


def _check_modulus(modulus: Float[Array, " triangle"], shell: ShellModel) -> None:
    if modulus.shape != (len(shell.triangles),):
        raise SolverError(
            f"modulus of shape {modulus.shape} for {len(shell.triangles)} triangles",
            where="shell",
            hint="give one Young's modulus per triangle",
        )
    wrong = np.flatnonzero(~((modulus > 0) & np.isfinite(modulus)))
    if wrong.size:
        raise SolverError(
            f"Young's modulus of {wrong.size} triangles is not positive and finite",
            where=f"triangle {wrong[0]}, E = {modulus[wrong[0]]:g} MPa",
            hint="keep the design variable inside the range of the material curve",
        )
