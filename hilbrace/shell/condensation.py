"""One shell at one modulus, condensed onto its loads and the motions of its loops, and the exact adjoint.

Notation: f are the free degrees of freedom, G the rigid motions of the loops, Q = K_ff's coupling K_fb G,
F the loads. One factorisation of K_ff gives ``U = K_ff^-1 F`` and ``Z = K_ff^-1 Q``; the static modes are
``Psi = G - Z``, the shapes that the shell takes when a loop moves. From them

    A = F^T U          flexibility: work of one load on the displacements of another,
    B = Psi^T F        sharing: the wrenches that loads and loops balance by,
    K_c = Psi^T K Psi  stiffness between the motions of the loops.

They are stationary in U and Z, so that their derivatives by the stiffness need no further solve:
``dA = -U^T dK U``, ``dB = -Psi^T dK U``, ``dK_c = Psi^T dK Psi``. By the loads, ``dA = U^T dF + dF^T U`` and
``dB = Psi^T dF``. A loss on U itself costs one solve more for each load.

Six solves give all twelve static modes: when both loops follow one rigid motion R, so does the whole shell,
so that ``Psi_upper = R - Psi_lower T`` with T the lower loop's part in that motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.shell.blocks import times, transposed_times
from hilbrace.shell.loops import carry_motion
from hilbrace.shell.maps import Assembled, StiffnessMaps, assemble, contract
from hilbrace.shell.model import ShellModel
from hilbrace.shell.solver import Solver

Array = np.ndarray


@dataclass(frozen=True)
class Condensed:
    """One shell at one modulus.

    Attributes:
        fields: Free part of the static modes, -Z (the first `modes` columns), and of the displacements U.
        modes: Number of static modes: 12, or none where only the loads were asked for.
        flexibility: A [N*mm for loads in N].
        sharing: B.
        loop_stiffness: K_c.
    """

    fields: Float[Array, "free field"]
    modes: int
    flexibility: Float[Array, "load load"]
    sharing: Float[Array, "mode load"]
    loop_stiffness: Float[Array, "mode mode"]

    @property
    def displacements(self) -> Float[Array, "free load"]:
        """Displacements U of the free degrees of freedom."""
        return self.fields[:, self.modes :]


@dataclass(frozen=True)
class Weights:
    """Derivatives of a loss by what a condensation gave.

    Attributes:
        flexibility: By A.
        sharing: By B.
        loop_stiffness: By K_c.
        displacements: By U, if the loss sees the displacements.
    """

    flexibility: Float[Array, "load load"]
    sharing: Float[Array, "mode load"]
    loop_stiffness: Float[Array, "mode mode"]
    displacements: Float[Array, "free load"] | None = None


def stiffness_of(shell: ShellModel, modulus: Float[Array, " triangle"]) -> Assembled:
    """The stiffness of a shell for the modulus of each triangle [MPa], with the skin under it."""
    part = assemble(shell.numbering, shell.maps, modulus)
    ground = shell.ground
    if ground is None:
        return part
    part.values[ground.entries] += ground.values
    return Assembled(part.values, part.coupling + ground.coupling, part.ends + ground.ends)


def condense(
    shell: ShellModel,
    modulus: Float[Array, " triangle"],
    loads: Float[Array, "dof load"],
    modes: int,
    solver: Solver,
) -> Condensed:
    """Condense a shell onto loads and, with `modes` = 12, onto the motions of its loops.

    Args:
        shell: The shell.
        modulus: Young's modulus of each triangle [MPa].
        loads: Forces [N] and moments [N*mm] on all degrees of freedom; fastest with one load after the
            other in memory.
        modes: 12, or 0 for the loads alone.
        solver: A solver of the shell's sparsity.

    Raises:
        SolverError: The stiffness is not positive definite.
    """
    stiffness = stiffness_of(shell, modulus)
    count, lower = loads.shape[1], modes // 2
    rhs = np.empty((len(shell.numbering.free), lower + count), order="F")
    rhs[:, :lower] = -stiffness.coupling[:, lower:modes]
    np.take(loads.T, shell.numbering.free, axis=1, out=rhs[:, lower:].T, mode="clip")
    fields = np.empty((len(rhs), modes + count), order="F")
    fields[:, lower:] = solver.factor(stiffness.values).solve(rhs)
    if modes:
        fields[:, :lower] = shell.rigid - times(fields[:, lower:modes], carry_motion(shell.centres))
    free_modes, moves = fields[:, :modes], fields[:, modes:]
    coupling = stiffness.coupling[:, :modes]
    on_loops = transposed_times(shell.loop_motions[:, :modes], loads[shell.clamped])
    flexibility = transposed_times(rhs[:, lower:], moves)
    ends = stiffness.ends[:modes, :modes] + transposed_times(coupling, free_modes)
    return Condensed(
        fields=fields,
        modes=modes,
        flexibility=0.5 * (flexibility + flexibility.T),
        sharing=on_loops - transposed_times(coupling, moves),
        loop_stiffness=0.5 * (ends + ends.T),
    )


def follow_displacements(
    shell: ShellModel,
    modulus: Float[Array, " triangle"],
    weights: Float[Array, "free load"],
    solver: Solver,
) -> Float[Array, "free load"]:
    """Adjoint displacements of a loss on U: one more factorisation and one solve for each load."""
    return solver.factor(stiffness_of(shell, modulus).values).solve(weights)


def by_stiffness(
    shell: ShellModel,
    maps: StiffnessMaps,
    state: Condensed,
    weights: Weights,
    adjoint: Float[Array, "free load"] | None = None,
) -> Float[Array, " triangle"]:
    """Derivative of a loss by a factor on each triangle's contribution to the stiffness.

    Args:
        shell: The shell.
        maps: Contributions: the shell's own for the derivative by the modulus.
        state: What the condensation gave.
        weights: Derivatives of the loss by it.
        adjoint: Adjoint displacements, if the loss sees the displacements.
    """
    modes = state.modes
    loads = state.fields.shape[1] - modes
    fields = state.fields if adjoint is None else np.concatenate([state.fields, adjoint], axis=1)
    pairing = np.zeros((fields.shape[1], fields.shape[1]))
    moved = slice(modes, modes + loads)
    pairing[:modes, :modes] = 0.5 * (weights.loop_stiffness + weights.loop_stiffness.T)
    pairing[:modes, moved] = -0.5 * weights.sharing
    pairing[moved, :modes] = -0.5 * weights.sharing.T
    pairing[moved, moved] = -0.5 * (weights.flexibility + weights.flexibility.T)
    if adjoint is not None:
        half = -0.5 * np.eye(loads)
        pairing[moved, modes + loads :] = half
        pairing[modes + loads :, moved] = half
    return contract(shell.numbering, maps, fields, pairing, modes)


def by_loads(
    shell: ShellModel, state: Condensed, weights: Weights, adjoint: Float[Array, "free load"] | None = None
) -> Float[Array, "dof load"]:
    """Derivative of a loss by the loads on all degrees of freedom. Arguments as in `by_stiffness`."""
    moves = times(state.displacements, weights.flexibility + weights.flexibility.T)
    moves += times(state.fields[:, : state.modes], weights.sharing)
    if adjoint is not None:
        moves += adjoint
    out = np.zeros((len(shell.numbering.equation), moves.shape[1]))
    out[shell.numbering.free] = moves
    out[shell.clamped] = times(shell.loop_motions[:, : state.modes], weights.sharing)
    return out


def expand(
    shell: ShellModel, free: Float[Array, "free field"], motions: bool = False
) -> Float[Array, "dof field"]:
    """Displacements of all degrees of freedom; with `motions`, of unit motions of the loops."""
    out = np.zeros((len(shell.numbering.equation), free.shape[1]))
    out[shell.numbering.free] = free
    if motions:
        out[shell.clamped] = shell.loop_motions
    return out
