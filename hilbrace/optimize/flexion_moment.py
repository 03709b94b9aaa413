"""What flexion costs: the moment by which a brace resists it, from its energy and from its stiffness.

A worn brace is neither glued to the skin nor free of it. Two limits are computed along the motion:

* *held*: the brace follows the skin everywhere, as the paper's elastic energy takes it to (Eq. 4). Its wall
  then stores the neo-Hookean membrane energy ``W = sum_e E_e A_e t w(G_e)``, and the moment is
  ``dW / d flexion``.
* *free*: the brace moves with the bones at its two edges and lies as it likes in between. The moment is the
  integral of its stiffness ``K_c`` over flexion, each posture taken as free of stress.

Skin that stretches by half under a brace which sticks to it costs several times the moment of a brace which
slides. `stiffness_by_energy` ties the two together: for the shape that the free brace takes in a small
flexion, the same neo-Hookean energy gives the same moment as ``K_c``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.domain.deformation import deformation_gradients
from hilbrace.material.neo_hookean import energy_density
from hilbrace.optimize.design import Design
from hilbrace.optimize.joint_response import FLEXION
from hilbrace.optimize.problem import Problem
from hilbrace.shell import Section, ShellModel, build_shell, isotropic, static_modes
from hilbrace.shell.element import NODE_DOFS
from hilbrace.shell.loops import rotation_about
from hilbrace.shell.model import unit_stiffness
from hilbrace.units import DEG, MM_PER_M

Array = np.ndarray

STEP = np.deg2rad(5.0)
"""Distance between the flexions of a curve [rad]."""

SMALL = np.deg2rad(0.25)
"""Flexion at which the energy's moment is compared with the stiffness [rad]. At one degree the straight lines
along which the shell's displacements are laid already stretch it by a noticeable part of its strain."""

POWERS = (2, 3, 4, 5)
"""Powers of flexion in the energy of a brace that is held by the skin, beside a constant: none at first
power, since the neutral pose is the brace's rest."""

_NO_MEMBRANE = 1e-9


@dataclass(frozen=True)
class MomentCurves:
    """Moment against flexion of some braces on one domain.

    Attributes:
        flexion: Flexions from the smallest of the motion to the largest, the neutral pose among them [rad].
        held: Moment of each brace when it follows the skin everywhere [N*m].
        free: Moment when it is held at its edges alone [N*m].
    """

    flexion: Float[Array, " flexion"]
    held: Float[Array, "brace flexion"]
    free: Float[Array, "brace flexion"]


def moment_curves(
    problem: Problem,
    loads: JointLoads,
    moduli: Sequence[Float[Array, " triangle"]],
    stiffnesses: Sequence[Float[Array, "posture 3"]],
) -> MomentCurves:
    """Both moments of braces along the motion.

    Args:
        problem: The design task.
        loads: Kinematics that it was made of.
        moduli: Young's modulus of the triangles, for each brace [MPa].
        stiffnesses: Stiffness about the joint's axes in each posture, for each brace [N*m/rad].
    """
    domain, joint = problem.domain, loads.joints.index(problem.domain.joint)
    flexion = np.interp(domain.time, loads.time, loads.angles[:, joint, FLEXION])
    grid = flexion_grid(flexion)
    postures = np.array([posture.flexion for posture in problem.postures])
    held = [held_moment(grid, flexion, held_energy(problem, modulus)) for modulus in moduli]
    free = [free_moment(grid, postures, stiffness[:, FLEXION]) for stiffness in stiffnesses]
    return MomentCurves(grid, np.stack(held), np.stack(free))


def flexion_grid(flexion: Float[Array, " frame"]) -> Float[Array, " flexion"]:
    """Flexions of a curve [rad]: even steps from the neutral pose, and both ends of the motion.

    Args:
        flexion: Flexion in the frames of the design [rad].
    """
    low, high = min(0.0, float(flexion.min())), max(0.0, float(flexion.max()))
    steps = np.arange(np.ceil(low / STEP), np.floor(high / STEP) + 1) * STEP
    return np.unique(np.concatenate([[low, high, 0.0], steps]))


def held_energy(problem: Problem, modulus: Float[Array, " triangle"]) -> Float[Array, " frame"]:
    """Elastic energy of a brace that follows the skin, in each frame of the design [J].

    Args:
        problem: The design task.
        modulus: Young's modulus of the triangles [MPa].
    """
    shell = problem.postures[problem.rest_posture].shell
    volume = problem.areas.numpy() * shell.thickness_mm
    return energy_density(problem.domain.deformation, problem.poisson) @ (modulus * volume) / MM_PER_M


def held_moment(
    grid: Float[Array, " flexion"], flexion: Float[Array, " frame"], energy: Float[Array, " frame"]
) -> Float[Array, " flexion"]:
    """Slope of the energy against flexion [N*m].

    The frames differ in adduction and rotation as well, and come and go through the same flexion; the curve
    is the slope of a polynomial through all of them by least squares, see `POWERS`.

    Args:
        grid: Flexions wanted [rad].
        flexion: Flexion of each frame [rad].
        energy: Energy of each frame [J].
    """
    largest = float(np.abs(flexion).max())
    if largest == 0.0:
        return np.zeros(len(grid))
    powers = np.array((0, *POWERS))
    factor, *_ = np.linalg.lstsq((flexion[:, None] / largest) ** powers, energy, rcond=1e-9)
    slopes = powers[1:] * (grid[:, None] / largest) ** (powers[1:] - 1)
    return slopes @ factor[1:] / largest


def free_moment(
    grid: Float[Array, " flexion"], postures: Float[Array, " posture"], sagittal: Float[Array, " posture"]
) -> Float[Array, " flexion"]:
    """Integral of the stiffness over flexion from the neutral pose [N*m], exact for its linear course.

    Args:
        grid: Flexions wanted [rad], the neutral pose among them.
        postures: Flexions of the postures [rad], rising.
        sagittal: Stiffness about the flexion axis in each of them [N*m/rad].
    """
    fine = np.unique(np.concatenate([grid, postures]))
    stiffness = np.interp(fine, postures, sagittal)
    steps = 0.5 * (stiffness[1:] + stiffness[:-1]) * np.diff(fine)
    moment = np.concatenate([[0.0], np.cumsum(steps)])
    return np.interp(grid, fine, moment - np.interp(0.0, fine, moment))


def stiffness_by_energy(problem: Problem, modulus: Float[Array, " triangle"]) -> float:
    """Moment of a small flexion over its angle, from the energy of the free brace [N*m/rad].

    The brace takes the shape of `hilbrace.shell.static_modes`. Its energy there is the neo-Hookean one of the
    stretched wall and that of its bending, and the moment the energy's slope.

    Args:
        problem: The design task.
        modulus: Young's modulus of the triangles [MPa].
    """
    rest = problem.postures[problem.rest_posture]
    shell = rest.shell
    turn = rotation_about(shell.centres, np.zeros(3), rest.axes[FLEXION : FLEXION + 1])
    per_radian = (static_modes(modulus, shell) @ turn).reshape(-1, NODE_DOFS)
    angles = SMALL * np.array([0.99, 1.01])
    posed = shell.vertices + angles[:, None, None] * per_radian[:, :3]
    gradients = deformation_gradients(shell.vertices, posed, shell.triangles)
    volume = problem.areas.numpy() * shell.thickness_mm
    stretching = energy_density(gradients, problem.poisson) @ (modulus * volume)
    energy = stretching + 0.5 * angles**2 * _bending(shell, modulus, problem.poisson, per_radian)
    return float(np.diff(energy)[0] / np.diff(angles)[0] / SMALL / MM_PER_M)


def moment_figures(design: Design) -> dict[str, Any]:
    """The moment curves of a design and of the uniform brace in figures that people read.

    Args:
        design: The finished design.
    """
    columns = {
        "held_nm": design.moment_held[0],
        "free_nm": design.moment_free[0],
        "held_uniform_nm": design.moment_held[1],
        "free_uniform_nm": design.moment_free[1],
    }
    return {
        "stiffness_sagittal_by_energy_nm_per_deg": float(f"{design.stiffness_by_energy:.6g}"),
        "flexion_moment": [
            {
                "flexion_deg": round(float(flexion / DEG), 2),
                **{name: float(f"{moment[row]:.4g}") for name, moment in columns.items()},
            }
            for row, flexion in enumerate(design.moment_flexions)
        ],
    }


def _bending(
    shell: ShellModel,
    modulus: Float[Array, " triangle"],
    poisson: float,
    per_radian: Float[Array, "vertex dof"],
) -> float:
    """Stiffness of a wall that costs nothing to stretch, against displacements per radian [N*mm/rad]."""
    wall = isotropic(poisson)
    unstretched = Section(_NO_MEMBRANE * wall.membrane, wall.bending, wall.shear)
    limp = build_shell(
        shell.vertices,
        shell.triangles,
        shell.upper_loop,
        shell.lower_loop,
        shell.thickness_mm,
        unstretched,
    )
    moved = per_radian[shell.triangles].reshape(len(shell.triangles), -1)
    return float(np.einsum("e,ei,eij,ej->", modulus, moved, unit_stiffness(limp), moved, optimize=True))
