"""What a brace answers to the loads of a motion and to motions of its loops.

One shell may stand for all frames (its rest shape), or a family of shapes may take the frames between them
(`hilbrace.shell.geometry`). All answers are torch functions of the modulus, of the forces and, where it is
given, of the thickness, with exact gradients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from hilbrace.errors import GeometryError
from hilbrace.shell.autograd import SolvedShell, condense_shells, field_energy
from hilbrace.shell.element import NODE_DOFS
from hilbrace.shell.geometry import ShellFamily
from hilbrace.shell.loads import LoadPattern, NodalLoads, check_loads
from hilbrace.shell.model import ShellModel
from hilbrace.shell.pool import SolverPool

Array = np.ndarray


@dataclass(frozen=True)
class FrameShare:
    """The frames that one shape stands for, and the loads that were solved for them.

    Attributes:
        frames: Frames that use the shape, ascending.
        solved: The shape, condensed onto its loads.
        combination: How the load of each frame is made of them; None where each frame has its own.
    """

    frames: Int[Array, " used"]
    solved: SolvedShell
    combination: Float[Tensor, "used load"] | None


@dataclass(frozen=True)
class ShellResponse:
    """What one shell answers to its loads and to motions of its loops.

    Attributes:
        compliance: Half the work of each frame's load, 1/2 F_t . u_t [N*mm].
        reactions: Force [N] and moment about the loop's centre [N*mm] by which the upper (0:6) and the lower
            segment (6:12) of the limb hold the brace in each frame: through the loop and, with a foundation,
            through the skin; the limb feels the opposite.
        loop_stiffness: Condensed stiffness K_c between the rigid motions of the loops, in the same order
            [N/mm, N, N*mm/rad].
        shares: What `element_energies` needs.
    """

    compliance: Float[Tensor, " frame"]
    reactions: Float[Tensor, "frame 12"]
    loop_stiffness: Float[Tensor, "12 12"]
    shares: tuple[FrameShare, ...]


@dataclass(frozen=True)
class FamilyResponse:
    """What a brace answers whose shape changes from frame to frame.

    Attributes:
        compliance: As in `ShellResponse` [N*mm].
        reactions: As in `ShellResponse`; moments about the centres of the loops in the frame's own shape.
        loop_stiffness: K_c of every shape.
        shares: What `element_energies` needs.
    """

    compliance: Float[Tensor, " frame"]
    reactions: Float[Tensor, "frame 12"]
    loop_stiffness: Float[Tensor, "shape 12 12"]
    shares: tuple[FrameShare, ...]


@dataclass(frozen=True)
class SkinReaction:
    """What the skin does to the brace while the loops stay where they are.

    Attributes:
        forces: Force of the skin on each vertex [N].
        wrenches: Force and moment of the skin of the upper (0:6) and the lower segment (6:12) about the
            centres of the loops [N, N*mm]: the part of `ShellResponse.reactions` that is not the loops'.
    """

    forces: Float[Array, "frame vertex 3"]
    wrenches: Float[Array, "frame 12"]


def shell_response(
    modulus: Float[Tensor, " triangle"],
    shell: ShellModel,
    load: LoadPattern | NodalLoads,
    thickness: Float[Tensor, " triangle"] | None = None,
    solvers: SolverPool | None = None,
) -> ShellResponse:
    """Compliance and reactions of every frame and the loop stiffness, for one shape.

    One factorisation, and 3 + 6 solves for a load pattern or one for each frame + 6 for nodal loads; the
    gradient needs no more (paper, Eq. 2: K U = F_acting; compliance here is 1/2 F . U).

    Args:
        modulus: Young's modulus of each triangle [MPa].
        shell: The shell.
        load: Loads of the frames.
        thickness: Thickness of each triangle [mm], to differentiate by it; that of the shell if left out.
        solvers: Open solvers of the shell's sparsity, which save its analysis; own ones if left out.

    Raises:
        SolverError: Modulus, thickness or loads are not usable, or the stiffness is singular.
    """
    family = ShellFamily((shell,), np.zeros(_frames(load), dtype=np.int64))
    answer = family_response(modulus, family, load, thickness, solvers)
    return ShellResponse(answer.compliance, answer.reactions, answer.loop_stiffness[0], answer.shares)


def family_response(
    modulus: Float[Tensor, " triangle"],
    family: ShellFamily,
    load: LoadPattern | NodalLoads,
    thickness: Float[Tensor, " triangle"] | None = None,
    solvers: SolverPool | None = None,
) -> FamilyResponse:
    """Compliance and reactions of every frame in its shape, and the loop stiffness of every shape.

    For each shape one factorisation, 6 solves for its loops, and as many for loads as it has frames, but no
    more than 3 for a load pattern. Arguments and errors as in `shell_response`.
    """
    shares = _solve(modulus, family, load, True, thickness, solvers)
    return FamilyResponse(
        compliance=_in_order([_compliance(share) for share in shares], shares),
        reactions=_in_order([_reactions(share) for share in shares], shares),
        loop_stiffness=torch.stack([share.solved.loop_stiffness for share in shares]),
        shares=shares,
    )


def family_compliance(
    modulus: Float[Tensor, " triangle"],
    family: ShellFamily,
    load: LoadPattern | NodalLoads,
    thickness: Float[Tensor, " triangle"] | None = None,
    solvers: SolverPool | None = None,
) -> Float[Tensor, " frame"]:
    """Compliance of every frame in its shape alone [N*mm]; spares each shape the 6 solves for its loops."""
    shares = _solve(modulus, family, load, False, thickness, solvers)
    return _in_order([_compliance(share) for share in shares], shares)


def family_stiffness(
    modulus: Float[Tensor, " triangle"],
    shells: Sequence[ShellModel],
    thickness: Float[Tensor, " triangle"] | None = None,
    solvers: SolverPool | None = None,
) -> Float[Tensor, "shape 12 12"]:
    """Loop stiffness K_c of several shapes of one brace alone [N/mm, N, N*mm/rad]; 6 solves for each."""
    nothing = torch.zeros((0, len(shells[0].vertices), 3), dtype=torch.float64)
    loads = [nothing] * len(shells)
    solved = condense_shells(modulus, shells, loads, True, thickness, solvers)
    return torch.stack([one.loop_stiffness for one in solved])


def loop_stiffness(
    modulus: Float[Tensor, " triangle"],
    shell: ShellModel,
    thickness: Float[Tensor, " triangle"] | None = None,
    solvers: SolverPool | None = None,
) -> Float[Tensor, "12 12"]:
    """The loop stiffness K_c of one shell [N/mm, N, N*mm/rad]; 6 solves. For posed shapes see `pose_shell`.

    Raises:
        SolverError: The modulus is not positive and finite, or the stiffness is singular.
    """
    return family_stiffness(modulus, [shell], thickness, solvers)[0]


def element_energies(response: ShellResponse | FamilyResponse) -> Float[Tensor, "frame triangle"]:
    """Twice the strain energy of every triangle in every frame, E_e u^T k0 u [N*mm], as the paper's W_c.

    Their sum over the triangles is twice the compliance. A loss on single energies costs one factorisation
    of each shape and one solve for each of its loads in the gradient.

    Args:
        response: The response whose loads bend the shell.
    """
    parts = []
    for share in response.shares:
        moves = share.solved.displacements
        parts.append(
            field_energy(share.solved, moves if share.combination is None else moves @ share.combination.T)
        )
    return _in_order(parts, response.shares)


def static_modes(modulus: Float[Array, " triangle"], shell: ShellModel) -> Float[Array, "dof 12"]:
    """Static modes Psi: displacements of the whole shell per unit rigid motion of a loop."""
    nothing = torch.zeros((0, len(shell.vertices), 3), dtype=torch.float64)
    (solved,) = condense_shells(torch.from_numpy(modulus), [shell], [nothing], True)
    modes = shell.motions
    modes[shell.numbering.free] = solved.modes
    return modes


def displacements(
    modulus: Float[Array, " triangle"], shell: ShellModel, load: LoadPattern | NodalLoads
) -> Float[Array, "frame vertex 3"]:
    """Displacement of every vertex in every frame [mm]."""
    family = ShellFamily((shell,), np.zeros(_frames(load), dtype=np.int64))
    (share,) = _solve(torch.from_numpy(modulus), family, load, False, None, None)
    free = share.solved.displacements.detach()
    if share.combination is not None:
        free = free @ share.combination.detach().T
    moves = np.zeros((len(shell.vertices) * NODE_DOFS, len(share.frames)))
    moves[shell.numbering.free] = free.numpy()
    return np.ascontiguousarray(moves.reshape(-1, NODE_DOFS, len(share.frames))[:, :3].transpose(2, 0, 1))


def skin_reaction(
    modulus: Float[Array, " triangle"], shell: ShellModel, load: LoadPattern | NodalLoads
) -> SkinReaction:
    """How much of the load the skin under the brace takes.

    Raises:
        GeometryError: The shell lies on no skin.
    """
    if shell.ground is None:
        raise GeometryError(
            "the shell lies on no skin", where="skin foundation of the shell", hint="lay it on by lay_on_skin"
        )
    moves = displacements(modulus, shell, load)
    forces = -np.einsum("vij,tvj->tvi", shell.ground.springs, moves)
    return SkinReaction(forces, np.einsum("vim,tvi->tm", shell.ground.limb, forces))


def _frames(load: LoadPattern | NodalLoads) -> int:
    return len(load.forces)


def _solve(
    modulus: Float[Tensor, " triangle"],
    family: ShellFamily,
    load: LoadPattern | NodalLoads,
    modes: bool,
    thickness: Float[Tensor, " triangle"] | None,
    solvers: SolverPool | None,
) -> tuple[FrameShare, ...]:
    """Condense every shape onto the loads of its frames."""
    check_loads(load, len(family.shells[0].vertices), len(family.shape_of_frame))
    frames = [np.flatnonzero(family.shape_of_frame == shape) for shape in range(len(family.shells))]
    pairs = [_columns(load, used) for used in frames]
    solved = condense_shells(modulus, family.shells, [loads for loads, _ in pairs], modes, thickness, solvers)
    return tuple(
        FrameShare(used, one, combination)
        for used, one, (_, combination) in zip(frames, solved, pairs, strict=True)
    )


def _columns(
    load: LoadPattern | NodalLoads, frames: Int[Array, " used"]
) -> tuple[Float[Tensor, "load vertex 3"], Float[Tensor, "used load"] | None]:
    """Loads to solve for, and how the frames combine them: a pattern needs no more than three."""
    forces = load.forces[torch.from_numpy(frames)].to(torch.float64)
    if isinstance(load, NodalLoads):
        return forces, None
    shares = torch.from_numpy(load.shares)[None, :, None]
    if len(frames) < 3:
        return shares * forces[:, None, :], None
    return shares * torch.eye(3, dtype=torch.float64)[:, None, :], forces


def _compliance(share: FrameShare) -> Float[Tensor, " used"]:
    flexibility, combination = share.solved.flexibility, share.combination
    if combination is None:
        return 0.5 * torch.diagonal(flexibility)
    return 0.5 * ((combination @ flexibility) * combination).sum(dim=1)


def _reactions(share: FrameShare) -> Float[Tensor, "used 12"]:
    sharing, combination = share.solved.sharing, share.combination
    return -sharing.T if combination is None else -combination @ sharing.T


def _in_order(parts: list[Tensor], shares: tuple[FrameShare, ...]) -> Tensor:
    """Rows of the shapes in the order of the frames."""
    order = np.argsort(np.concatenate([share.frames for share in shares]), kind="stable")
    return torch.cat(parts)[torch.from_numpy(order)]
