"""The brace as a spring at the joint: its stiffness about the joint's axes, and its wrenches there.

The joint's centre has no default, since the stiffness about another one is another: a brace that is turned
about a distant centre is sheared as well. A domain has its origin at the joint.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from hilbrace.errors import GeometryError
from hilbrace.shell.geometry import ShellFamily
from hilbrace.shell.loops import rotation_about, wrench_shift
from hilbrace.shell.model import ShellModel

Array = np.ndarray


def joint_stiffness(
    loop_stiffness: Float[torch.Tensor, "12 12"],
    shell: ShellModel,
    axes: Float[Array, "axis 3"],
    centre: Float[Array, " xyz"],
) -> Float[torch.Tensor, "axis axis"]:
    """Stiffness of the brace against turning the lower loop about joint axes, the upper loop held [N*mm/rad].

    Small rotations about the shape of the shell; the joint fixes the centre of rotation. Entry (i, j) is the
    moment about axis i per radian about axis j. Differentiable by the loop stiffness.

    Args:
        loop_stiffness: Condensed stiffness of the loops.
        shell: The shell that it belongs to.
        axes: Unit directions of the joint's axes [-].
        centre: Joint centre [mm].

    Raises:
        GeometryError: The centre or an axis is no point or direction in space.
    """
    about = np.asarray(axes, dtype=float)
    if about.ndim != 2 or about.shape[1] != 3 or not np.isfinite(about).all():
        raise GeometryError(
            f"joint axes of shape {about.shape}, or not finite",
            where="joint of the brace",
            hint="give three finite components for each axis",
        )
    turn = torch.from_numpy(rotation_about(shell.centres, _point(centre), about))
    return turn.T @ loop_stiffness @ turn


def wrenches_at(
    reactions: Float[torch.Tensor, "frame 12"], shell: ShellModel, centre: Float[Array, " xyz"]
) -> Float[torch.Tensor, "frame 12"]:
    """Reactions with their moments taken about the joint centre instead of the loops' centres.

    Args:
        reactions: Forces [N] and moments [N*mm] at the upper and the lower loop.
        shell: The shell that they hold.
        centre: Joint centre [mm].

    Raises:
        GeometryError: The centre is no point in space.
    """
    return reactions @ torch.from_numpy(wrench_shift(shell.centres, _point(centre))).T


def family_wrenches_at(
    reactions: Float[torch.Tensor, "frame 12"],
    family: ShellFamily,
    centre: Float[Array, " xyz"],
) -> Float[torch.Tensor, "frame 12"]:
    """Reactions of a family with their moments taken about the joint centre, each frame in its own shape.

    Args:
        reactions: Forces [N] and moments [N*mm] at the upper and the lower loop.
        family: The shapes of the frames.
        centre: Joint centre [mm], where it stays in all frames.

    Raises:
        GeometryError: The centre is no point in space.
    """
    point = _point(centre)
    shifts = np.stack([wrench_shift(shell.centres, point) for shell in family.shells])
    return torch.einsum("tij,tj->ti", torch.from_numpy(shifts[family.shape_of_frame]), reactions)


def _point(centre: Float[Array, " xyz"]) -> Float[Array, " xyz"]:
    point = np.asarray(centre, dtype=float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise GeometryError(
            f"the joint centre {point.tolist()} is no point in space",
            where="joint of the brace",
            hint="give three finite coordinates in mm; the origin for a domain of hilbrace",
        )
    return point
