"""Rigid motions of the two clamped loops, and the wrenches that belong to them.

Twelve numbers describe the loops: for the upper, then the lower loop, a translation [mm] and a rotation [rad]
about the loop's centre. Conjugate to them are a force [N] and a moment about that centre [N*mm].
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from hilbrace.shell.element import NODE_DOFS

Array = np.ndarray

LOOP_DOFS = 12


def loop_centres(
    vertices: Float[Array, "vertex 3"], upper_loop: Int[Array, " upper"], lower_loop: Int[Array, " lower"]
) -> Float[Array, "2 3"]:
    """Mean of the vertices of the upper and of the lower loop [mm]."""
    return np.stack([vertices[upper_loop].mean(axis=0), vertices[lower_loop].mean(axis=0)])


def rigid_motions(
    vertices: Float[Array, "vertex 3"],
    tangents: Float[Array, "vertex 2 3"],
    centre: Float[Array, " xyz"],
) -> Float[Array, "dof 6"]:
    """Displacements of all degrees of freedom in translations and in rotations about a centre."""
    motions = np.zeros((len(vertices), NODE_DOFS, 6))
    for axis, direction in enumerate(np.eye(3)):
        motions[:, axis, axis] = 1.0
        motions[:, :3, 3 + axis] = np.cross(direction, vertices - centre)
        motions[:, 3:, 3 + axis] = tangents[:, :, axis]
    return motions.reshape(-1, 6)


def carry_motion(centres: Float[Array, "2 3"]) -> Float[Array, "6 6"]:
    """Motion of the lower loop when it follows a rigid motion that is given about the upper loop's centre."""
    motion = np.eye(6)
    motion[:3, 3:] = np.cross(np.eye(3), centres[1] - centres[0]).T
    return motion


def loop_motions(
    vertices: Float[Array, "vertex 3"],
    tangents: Float[Array, "vertex 2 3"],
    upper_loop: Int[Array, " upper"],
    lower_loop: Int[Array, " lower"],
) -> Float[Array, "dof 12"]:
    """Displacements of all degrees of freedom when one loop moves rigidly and everything else stays."""
    motions = np.zeros((len(vertices), NODE_DOFS, LOOP_DOFS))
    centres = loop_centres(vertices, upper_loop, lower_loop)
    for side, loop in enumerate((upper_loop, lower_loop)):
        rigid = rigid_motions(vertices[loop], tangents[loop], centres[side])
        motions[loop, :, 6 * side : 6 * side + 6] = rigid.reshape(-1, NODE_DOFS, 6)
    return motions.reshape(-1, LOOP_DOFS)


def rotation_about(
    centres: Float[Array, "2 3"], point: Float[Array, " xyz"], axes: Float[Array, "axis 3"]
) -> Float[Array, "12 axis"]:
    """Loop motion per radian when the lower loop turns about axes through a point and the upper one stays.

    Args:
        centres: Centres of the upper and the lower loop [mm].
        point: Common point of the axes, the joint centre [mm].
        axes: Unit directions of the axes [-].
    """
    motion = np.zeros((LOOP_DOFS, len(axes)))
    motion[6:9] = np.cross(axes, centres[1] - point).T
    motion[9:12] = np.asarray(axes).T
    return motion


def wrench_shift(centres: Float[Array, "2 3"], point: Float[Array, " xyz"]) -> Float[Array, "12 12"]:
    """Matrix that moves the moments of both loops' wrenches from their centres to one point [mm]."""
    shift = np.eye(LOOP_DOFS)
    for side in range(2):
        arm = centres[side] - point
        for axis, direction in enumerate(np.eye(3)):
            shift[6 * side + 3 : 6 * side + 6, 6 * side + axis] = np.cross(arm, direction)
    return shift
