"""One optimizer iteration, by this package and by what a user would write otherwise.

The task is the same for all: the compliances 1/2 F_t . u_t of the frames of a motion on one brace, and the
gradient of their sum by the modulus of every triangle. What depends on the mesh alone is prepared outside of
the iteration. A program that goes frame by frame may measure fewer frames than the motion has; its time grows
with their number.

This package answers more than the task asks: the reactions of the loops and the loop stiffness come with it,
at 6 solves for each shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import splu, spsolve

from hilbrace.shell import (
    LoadPattern,
    NodalLoads,
    build_shell,
    family_response,
    geometry_mode,
    joint_line_shares,
    open_pool,
    shell_family,
    shell_response,
)
from hilbrace.shell.assembly import free_stiffness
from hilbrace.shell.model import unit_stiffness
from tests.bench.knee_brace import FRAMES, LOAD_WINDOW_MM, POISSON, THICKNESS_MM, KneeBrace, knee_brace, posed


@dataclass(frozen=True)
class Answer:
    """Compliance of the frames that were solved, and the gradient of their sum by the modulus."""

    compliance: np.ndarray
    gradient: np.ndarray


@dataclass(frozen=True)
class Contestant:
    """A way to do the task.

    Attributes:
        label: How the table calls it.
        start: From the brace to an iteration, which may be called many times.
        frames: Frames that one iteration solves.
    """

    label: str
    start: Callable[[KneeBrace], Callable[[], Answer]]
    frames: int = FRAMES


OWN_TASKS = {
    "pattern": "rest shape, one load pattern",
    "loads": "rest shape, 45 free loads",
    "clusters:9": "9 shapes for 45 frames",
    "frame": "45 shapes",
}
"""What this package is measured at, and how the table calls it."""


TORCH_FEM = {
    "torch_fem": ("torch-fem, as it chooses (CG with AMG), for each frame", "chosen"),
    "torch_fem_scipy": ("torch-fem, direct by scipy, for each frame", "scipy"),
    "torch_fem_pardiso": ("torch-fem, direct by pypardiso, for each frame", "pypardiso"),
}
"""How torch-fem is measured: what the table calls it, and its linear solver."""


def peers(frames: int = 3) -> dict[str, Contestant]:
    """The other programs; those that go frame by frame solve this many frames."""
    return {
        "spsolve": Contestant("scipy, spsolve for each frame", partial(spsolve_each, frames=frames), frames),
        "splu": Contestant("scipy, one well-ordered splu and 45 solves", splu_once),
        **{
            name: Contestant(label, partial(torch_fem_each, frames=frames, solver=solver), frames)
            for name, (label, solver) in TORCH_FEM.items()
        },
    }


def own(task: str, backend: str) -> Contestant:
    """This package at one of its tasks, with one of its solvers."""
    start = {"pattern": rest_pattern, "loads": rest_loads}.get(task) or partial(shapes, geometry=task)
    return Contestant(OWN_TASKS[task], partial(start, backend=backend))


def rest_pattern(brace: KneeBrace, backend: str) -> Callable[[], Answer]:
    """One shape, one load pattern: 3 + 6 solves for any number of frames."""
    return _rest(brace, LoadPattern(_shares(brace), torch.from_numpy(brace.forces)), backend)


def rest_loads(brace: KneeBrace, backend: str) -> Callable[[], Answer]:
    """One shape, a load of its own in every frame: 45 + 6 solves."""
    return _rest(brace, NodalLoads(torch.from_numpy(_nodal_forces(brace))), backend)


def shapes(brace: KneeBrace, backend: str, geometry: str) -> Callable[[], Answer]:
    """A shape for each frame or cluster of frames, with its own factorisation."""
    shell = _shell(brace)
    family = shell_family(shell, posed(brace), geometry_mode(geometry))
    load = LoadPattern(_shares(brace), torch.from_numpy(brace.forces))
    pool = open_pool(shell.numbering.sparsity, backend)
    return _differentiated(brace, lambda modulus: family_response(modulus, family, load, solvers=pool))


def spsolve_each(brace: KneeBrace, frames: int) -> Callable[[], Answer]:
    """Assembly from coordinates and scipy's spsolve for each frame."""
    shell = _shell(brace)
    unit, dofs, free = unit_stiffness(shell), shell.numbering.element_dofs, shell.numbering.free
    rows, columns = np.repeat(dofs, 15, axis=1).ravel(), np.tile(dofs, (1, 15)).ravel()
    size = len(shell.numbering.equation)
    loads = _loads(brace)[:, :frames]

    def iteration() -> Answer:
        moves = np.zeros(loads.shape)
        for frame in range(frames):
            values = (brace.modulus[:, None, None] * unit).ravel()
            matrix = sp.coo_array((values, (rows, columns)), shape=(size, size)).tocsr()
            moves[free, frame] = spsolve(matrix[free][:, free].tocsc(), loads[free, frame])
        return _answer(loads, moves, unit, dofs)

    return iteration


def splu_once(brace: KneeBrace) -> Callable[[], Answer]:
    """The best of plain scipy: refill by a sparse product, one splu for symmetric matrices, all solves."""
    shell = _shell(brace)
    unit, dofs, free = unit_stiffness(shell), shell.numbering.element_dofs, shell.numbering.free
    loads = _loads(brace)

    def iteration() -> Answer:
        matrix = free_stiffness(shell.numbering, shell.refill, brace.modulus)
        options = {"SymmetricMode": True}
        lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        moves = np.zeros(loads.shape)
        moves[free] = lu.solve(np.asfortranarray(loads[free]))
        return _answer(loads, moves, unit, dofs)

    return iteration


def torch_fem_each(brace: KneeBrace, frames: int, solver: str) -> Callable[[], Answer]:
    """torch-fem's flat-facet shell and its autograd, frame by frame."""
    shares = _shares(brace)
    method = _torch_fem_method(solver)
    _wake_torch_fem(method)

    def iteration() -> Answer:
        modulus = torch.from_numpy(brace.modulus).requires_grad_()
        gradient = torch.zeros_like(modulus)
        compliance = []
        for force in brace.forces[:frames]:
            one = torch_fem_compliance(brace, modulus, shares[:, None] * force, method)
            gradient += torch.autograd.grad(one, modulus)[0]
            compliance.append(one.item())
        return Answer(np.array(compliance), gradient.numpy())

    return iteration


MATCHED = {"transverse_kappa": 1.0, "drill_penalty": 1e-2}
"""Settings of torch-fem's shell next to ours: MITC3+ takes 1 for the shear factor, and it has no drilling
rotation, which torch-fem ties by a spring; tied by its default of 1e-3 the shell is up to 0.5 % softer."""


def torch_fem_compliance(
    brace: KneeBrace,
    modulus: torch.Tensor,
    load: np.ndarray,
    method: str | None,
    settings: dict[str, Any] = MATCHED,
) -> torch.Tensor:
    """Compliance of the brace under nodal forces (vertex, 3), by torch-fem, with float64 torch's default."""
    from torchfem import Shell
    from torchfem.materials import IsotropicElasticityPlaneStress

    shell = Shell(
        torch.from_numpy(brace.vertices),
        torch.from_numpy(brace.triangles),
        IsotropicElasticityPlaneStress(modulus, POISSON),
        thickness=THICKNESS_MM,
        **settings,
    )
    shell.forces[:, :3] = torch.from_numpy(load)
    shell.constraints[np.concatenate([brace.upper_loop, brace.lower_loop])] = True
    moves = shell.solve(method=method, differentiable_parameters=modulus)[0]
    return 0.5 * (moves[:, :3] * shell.forces[:, :3]).sum()


def _torch_fem_method(solver: str) -> str | None:
    """What torch-fem calls a solver. Its direct one is pypardiso where that is installed, else scipy's."""
    from torchfem import sparse

    if solver == "scipy":
        sparse.available_backends[:] = ["scipy"]
    elif solver == "pypardiso" and solver not in sparse.available_backends:
        raise ModuleNotFoundError("pypardiso is not installed")
    return None if solver == "chosen" else "direct"


def _wake_torch_fem(method: str | None) -> None:
    """Solve a small brace, so that imports and what is compiled at the first call stay out of the time."""
    torch.set_default_dtype(torch.float64)
    small = knee_brace(300)
    modulus = torch.from_numpy(small.modulus).requires_grad_()
    load = _shares(small)[:, None] * small.forces[0]
    torch.autograd.grad(torch_fem_compliance(small, modulus, load, method or "cg"), modulus)


def _rest(brace: KneeBrace, load: Any, backend: str) -> Callable[[], Answer]:
    shell = _shell(brace)
    pool = open_pool(shell.numbering.sparsity, backend)
    return _differentiated(brace, lambda modulus: shell_response(modulus, shell, load, solvers=pool))


def _differentiated(brace: KneeBrace, respond: Callable[[torch.Tensor], Any]) -> Callable[[], Answer]:
    def iteration() -> Answer:
        modulus = torch.from_numpy(brace.modulus).requires_grad_()
        compliance = respond(modulus).compliance
        (gradient,) = torch.autograd.grad(compliance.sum(), modulus)
        return Answer(compliance.detach().numpy(), gradient.numpy())

    return iteration


def _answer(loads: np.ndarray, moves: np.ndarray, unit: np.ndarray, dofs: np.ndarray) -> Answer:
    """Compliances, and -1/2 u . k0 u of each triangle: compliance is its own adjoint."""
    local = moves[dofs]
    gradient = -0.5 * np.einsum("eit,eit->e", local, unit @ local)
    return Answer(0.5 * (loads * moves).sum(axis=0), gradient)


def _shell(brace: KneeBrace) -> Any:
    loops = brace.upper_loop, brace.lower_loop
    return build_shell(brace.vertices, brace.triangles, *loops, THICKNESS_MM, POISSON)


def _shares(brace: KneeBrace) -> np.ndarray:
    return joint_line_shares(brace.vertices, brace.triangles, LOAD_WINDOW_MM)


def _nodal_forces(brace: KneeBrace) -> np.ndarray:
    return brace.forces[:, None, :] * _shares(brace)[:, None]


def _loads(brace: KneeBrace) -> np.ndarray:
    """Loads on all degrees of freedom, one column per frame."""
    forces = _nodal_forces(brace)
    padded = np.concatenate([forces, np.zeros((*forces.shape[:2], 2))], axis=2)
    return padded.reshape(len(forces), -1).T
