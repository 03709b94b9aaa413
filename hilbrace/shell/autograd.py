"""The shell's response as torch functions of the modulus, with exact discrete adjoints.

Notation: f and b are the free degrees of freedom and those of the loops, G the rigid motions of the loops,
``K_ff Z = K_fb G``, ``Psi = G - Z`` the static modes (the shape that the shell takes when a loop moves), and
``K_ff U = W`` the displacements under a unit force along each axis. All outputs come from three matrices,

    A = W^T U (3, 3),   B = Psi^T W (12, 3),   K_c = sum_e E_e Psi_e^T k0_e Psi_e (12, 12),

which are self-adjoint: with the element energies ``m_e(x, y) = x_e^T k0_e y_e`` their derivatives by E_e are
``-m_e(U, U)``, ``-m_e(Psi, U)`` and ``m_e(Psi, Psi)``, so that the gradient needs no further solve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch.autograd.function import once_differentiable

from hilbrace.errors import SolverError
from hilbrace.shell.element import NODE_DOFS
from hilbrace.shell.loads import LoadPattern
from hilbrace.shell.loops import LOOP_DOFS
from hilbrace.shell.model import ShellModel
from hilbrace.shell.solver import open_solver

Array = np.ndarray


@dataclass(frozen=True)
class ShellResponse:
    """What the shell answers to its loads and to motions of its loops.

    Attributes:
        compliance: Half the work of each frame's load, 1/2 F_t . u_t [N*mm].
        reactions: Force [N] and moment about the loop's centre [N*mm] by which the upper (0:6) and the lower
            loop (6:12) hold the brace in each frame; the limb feels the opposite.
        loop_stiffness: Condensed stiffness K_c between the rigid motions of the loops, in the same order
            [N/mm, N, N*mm/rad].
    """

    compliance: Float[torch.Tensor, " frame"]
    reactions: Float[torch.Tensor, "frame 12"]
    loop_stiffness: Float[torch.Tensor, "12 12"]


def shell_response(
    modulus: Float[torch.Tensor, " triangle"], shell: ShellModel, load: LoadPattern
) -> ShellResponse:
    """Compliance and reactions of every frame and the loop stiffness, differentiable by modulus and forces.

    One factorisation and 3 + 12 solves, whatever the number of frames (paper, Eq. 2: K U = F_acting;
    compliance here is 1/2 F . U).

    Args:
        modulus: Young's modulus of each triangle [MPa].
        shell: The shell.
        load: Shares of the vertices and forces of the frames.

    Raises:
        SolverError: The modulus is not positive and finite, or the stiffness is singular.
    """
    flexibility, sharing, stiffness = _Condensed.apply(modulus.double(), shell, load.shares)
    forces = load.forces.to(torch.float64)
    compliance = 0.5 * ((forces @ flexibility) * forces).sum(dim=1)
    return ShellResponse(compliance, -forces @ sharing.T, stiffness)


def loop_stiffness(
    modulus: Float[torch.Tensor, " triangle"], shell: ShellModel
) -> Float[torch.Tensor, "12 12"]:
    """The loop stiffness K_c alone [N/mm, N, N*mm/rad]; 12 solves. For posed shapes see `pose_shell`.

    Raises:
        SolverError: The modulus is not positive and finite, or the stiffness is singular.
    """
    _, _, stiffness = _Condensed.apply(modulus.double(), shell, None)
    return stiffness


def static_modes(modulus: Float[Array, " triangle"], shell: ShellModel) -> Float[Array, "dof 12"]:
    """Static modes Psi: displacements of the whole shell per unit rigid motion of a loop."""
    _, modes = _solve(modulus, shell, None)
    return modes


def displacements(
    modulus: Float[Array, " triangle"], shell: ShellModel, load: LoadPattern
) -> Float[Array, "frame vertex 3"]:
    """Displacement of every vertex in every frame [mm]."""
    unit, _ = _solve(modulus, shell, load.shares)
    moves = unit.reshape(-1, NODE_DOFS, 3)[:, :3]
    return np.einsum("vck,tk->tvc", moves, load.forces.detach().numpy())


class _Condensed(torch.autograd.Function):
    """(E) -> (A, B, K_c)."""

    @staticmethod
    def forward(ctx: Any, modulus: torch.Tensor, shell: ShellModel, shares: Array | None) -> Any:
        numbers = modulus.detach().numpy()
        unit, modes = _solve(numbers, shell, shares)
        loads = _unit_loads(shell, shares)
        energy = _element_energies(shell, np.concatenate([modes, unit], axis=1))
        ctx.energy = energy
        stiffness = np.tensordot(numbers, energy[:, :LOOP_DOFS, :LOOP_DOFS], axes=1)
        flexibility = loads.T @ unit
        return (
            torch.from_numpy(0.5 * (flexibility + flexibility.T)),
            torch.from_numpy(modes.T @ loads),
            torch.from_numpy(0.5 * (stiffness + stiffness.T)),
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        by_flexibility, by_sharing, by_stiffness = grad_outputs
        energy = ctx.energy
        weights = np.zeros(energy.shape[1:])
        weights[:LOOP_DOFS, :LOOP_DOFS] = by_stiffness.numpy()
        weights[:LOOP_DOFS, LOOP_DOFS:] = -by_sharing.numpy()
        weights[LOOP_DOFS:, LOOP_DOFS:] = -by_flexibility.numpy()
        return torch.from_numpy(energy.reshape(len(energy), -1) @ weights.ravel()), None, None


def _solve(
    modulus: Float[Array, " triangle"], shell: ShellModel, shares: Float[Array, " vertex"] | None
) -> tuple[Float[Array, "dof load"], Float[Array, "dof 12"]]:
    """Displacements under the unit loads (three columns, or none) and the static modes."""
    _check_modulus(modulus, shell)
    numbering = shell.numbering
    loads = _unit_loads(shell, shares)
    coupling = (shell.coupling @ modulus).reshape(-1, LOOP_DOFS)
    rhs = np.concatenate([loads[numbering.free], coupling], axis=1)
    with open_solver(numbering.sparsity) as solver:
        answer = solver.factor(shell.refill @ modulus).solve(rhs)
    unit = np.zeros_like(loads)
    unit[numbering.free] = answer[:, : loads.shape[1]]
    modes = shell.motions.copy()
    modes[numbering.free] -= answer[:, loads.shape[1] :]
    return unit, modes


def _unit_loads(shell: ShellModel, shares: Float[Array, " vertex"] | None) -> Float[Array, "dof load"]:
    """The pattern W on all degrees of freedom: one column per axis of the force; none without shares."""
    vertices = len(shell.vertices)
    if shares is None:
        return np.zeros((vertices * NODE_DOFS, 0))
    loads = np.zeros((vertices, NODE_DOFS, 3))
    for axis in range(3):
        loads[:, axis, axis] = shares
    return loads.reshape(-1, 3)


def _element_energies(
    shell: ShellModel, fields: Float[Array, "dof field"]
) -> Float[Array, "triangle field field"]:
    """Bilinear energies m_e(x, y) of all pairs of displacement fields for unit modulus."""
    local = fields[shell.numbering.element_dofs]
    return local.transpose(0, 2, 1) @ (shell.stiffness @ local)


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
