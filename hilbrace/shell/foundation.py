"""The skin under the brace as an elastic foundation: springs that share the load with the loops.

Winkler's foundation: the skin pushes back by a constant stiffness per area against the motion of the brace
relative to the limb, along the normal and, by a share of it, along the surface. Each vertex takes its
tributary area. The limb is two rigid segments; the skin of each follows the loop on it, so that the brace and
the limb may move together at no cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError
from hilbrace.shell.assembly import Numbering
from hilbrace.shell.directors import triangle_normals
from hilbrace.shell.element import NODE_DOFS
from hilbrace.shell.loops import LOOP_DOFS

Array = np.ndarray


@dataclass(frozen=True)
class Foundation:
    """The skin under the brace.

    Attributes:
        normal: Stiffness per area against motion along the normal [N/mm^3].
        tangential: The same along the surface [N/mm^3].
        lower: Share by which the skin under each vertex follows the lower loop, the rest the upper one [-].
    """

    normal: float
    tangential: float
    lower: Float[Array, " vertex"]


@dataclass(frozen=True)
class Ground:
    """Constant part of the stiffness in one shape.

    Attributes:
        springs: Spring of each vertex against motion relative to the limb [N/mm].
        limb: Motion of the skin under each vertex per motion of the loops.
        entries: Stored entries of the free stiffness that the springs add to.
        values: What they add there.
        coupling: What they add to the forces on the free nodes per motion of the loops.
        ends: What they add to the stiffness between the motions of the loops.
    """

    springs: Float[Array, "vertex 3 3"]
    limb: Float[Array, "vertex 3 12"]
    entries: Int[Array, " added"]
    values: Float[Array, " added"]
    coupling: Float[Array, "free 12"]
    ends: Float[Array, "12 12"]


def skin(
    vertices: Float[Array, "vertex 3"],
    stiffness_n_per_mm3: float,
    tangential_share: float = 0.0,
    centre: Float[Array, " xyz"] | None = None,
    axis: Float[Array, " xyz"] | None = None,
) -> Foundation:
    """A foundation of constant stiffness; skin below the joint line follows the lower loop.

    Args:
        vertices: Rest positions of the brace [mm].
        stiffness_n_per_mm3: Stiffness per area along the normal [N/mm^3].
        tangential_share: Stiffness along the surface over that along the normal [-].
        centre: Point of the joint line [mm]; the origin, where the domain puts the joint, if left out.
        axis: Direction of the limb, upwards; y, as in the neutral pose, if left out.

    Raises:
        GeometryError: The stiffness or the share is negative or not finite, or no part of the brace lies
                above or below the joint line.
    """
    if not (0.0 <= stiffness_n_per_mm3 < np.inf and 0.0 <= tangential_share < np.inf):
        raise GeometryError(
            f"stiffness {stiffness_n_per_mm3:g} N/mm^3, tangential share {tangential_share:g}: no skin",
            where="skin foundation of the shell",
            hint="give finite values of at least zero",
        )
    along = np.array([0.0, 1.0, 0.0]) if axis is None else np.asarray(axis)
    origin = np.zeros(3) if centre is None else np.asarray(centre)
    height = (vertices - origin) @ along
    if not (height.min() < 0.0 < height.max()):
        raise GeometryError(
            "no part of the brace lies on the other side of the joint line",
            where=f"skin foundation of the shell, heights {height.min():.0f} to {height.max():.0f} mm",
            hint="give the centre of the joint and the direction of the limb in the frame of the mesh",
        )
    lower = (height < 0.0).astype(float)
    return Foundation(stiffness_n_per_mm3, tangential_share * stiffness_n_per_mm3, lower)


def check_foundation(
    foundation: Foundation,
    vertices: int,
    upper_loop: Int[Array, " upper"],
    lower_loop: Int[Array, " lower"],
) -> None:
    """Refuse a foundation that does not fit a shell.

    Args:
        foundation: The skin.
        vertices: Number of vertices of the shell.
        upper_loop: Vertices of its upper loop.
        lower_loop: Vertices of its lower loop.

    Raises:
        GeometryError: It has another number of vertices, values that make no skin, or follows the upper loop
            more at the lower one.
    """
    share = foundation.lower
    if share.shape != (vertices,):
        raise GeometryError(
            f"a foundation of {len(share)} vertices under a shell of {vertices}",
            where="skin foundation of the shell",
            hint="make the foundation from the vertices of the shell",
        )
    lost = np.flatnonzero(~((share >= 0.0) & (share <= 1.0)))
    stiff = np.array([foundation.normal, foundation.tangential])
    if lost.size or not (np.isfinite(stiff) & (stiff >= 0.0)).all():
        raise GeometryError(
            f"stiffnesses {stiff[0]:g} and {stiff[1]:g} N/mm^3, {lost.size} shares"
            " that are not between 0 and 1: no skin",
            where=f"vertex {lost[0]} of the skin foundation" if lost.size else "skin foundation of the shell",
            hint="give finite stiffnesses of at least zero and shares from 0 to 1",
        )
    if share[lower_loop].mean() < share[upper_loop].mean():
        raise GeometryError(
            "the skin at the lower loop follows the upper one",
            where="skin foundation of the shell",
            hint="swap the loops of the shell, or turn the axis of the skin upwards",
        )


def ground_stiffness(
    foundation: Foundation,
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    directors: Float[Array, "vertex 3"],
    centres: Float[Array, "2 3"],
    numbering: Numbering,
) -> Ground:
    """Stiffness of a foundation under one shape. Vertices on the loops move with the limb and need no spring.

    Args:
        foundation: The skin.
        vertices: Positions [mm].
        triangles: Vertex indices.
        directors: Normals of the vertices [-].
        centres: Centres of the upper and the lower loop [mm].
        numbering: Degrees of freedom.

    """
    equation = numbering.equation.reshape(-1, NODE_DOFS)[:, :3]
    _, area = triangle_normals(vertices, triangles)
    tributary = np.bincount(triangles.ravel(), np.repeat(area / 3.0, 3), minlength=len(vertices))
    tributary[equation[:, 0] < 0] = 0.0
    across = directors[:, :, None] * directors[:, None, :]
    springs = foundation.tangential * np.eye(3) + (foundation.normal - foundation.tangential) * across
    springs *= tributary[:, None, None]
    limb = _limb_motion(foundation.lower, vertices, centres)
    pull = springs @ limb
    coupling = np.zeros((numbering.sparsity.size, LOOP_DOFS))
    free = equation[:, 0] >= 0
    coupling[equation[free]] = -pull[free]
    entries, values = _on_diagonal(springs[free], equation[free], numbering)
    return Ground(springs, limb, entries, values, coupling, np.tensordot(limb, pull, axes=((0, 1), (0, 1))))


def _limb_motion(
    lower: Float[Array, " vertex"], vertices: Float[Array, "vertex 3"], centres: Float[Array, "2 3"]
) -> Float[Array, "vertex 3 12"]:
    motion = np.zeros((len(vertices), 3, LOOP_DOFS))
    for side, share in enumerate((1.0 - lower, lower)):
        arm = vertices - centres[side]
        for axis, direction in enumerate(np.eye(3)):
            motion[:, axis, 6 * side + axis] = share
            motion[:, :, 6 * side + 3 + axis] = share[:, None] * np.cross(direction, arm)
    return motion


def _on_diagonal(
    springs: Float[Array, "free_vertex 3 3"], equation: Int[Array, "free_vertex 3"], numbering: Numbering
) -> tuple[Int[Array, " added"], Float[Array, " added"]]:
    """The springs in the stored triangle; a column starts with the degrees of freedom of its own vertex."""
    start = numbering.sparsity.start
    row, column = np.tril_indices(3)
    return (start[equation[:, column]] + (row - column)).ravel(), springs[:, row, column].ravel()
