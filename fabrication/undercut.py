"""Undercuts: faces that a shell would run into on its way off, and reliefs that clear small ones."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from manifold3d import Manifold, OpType

from fabrication.bodies import body_of
from fabrication.seams import Surface

Array = np.ndarray

TOLERANCE_DEG = 1.0
"""Faces that lean less than this against the pull do not count as undercut: silicone and plastic give way."""

EMBED_MM = 5.0
"""How far a relief reaches beyond the parting, which bends between the corners of a face: into the room of
the next shell, of which it takes nothing [mm]."""

PRISM = np.array([[2, 1, 0], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]])
"""Triangles of the sweep of a face: its corners, then those below them."""

FLAT = 1e-6
"""Faces that lean less than this against the pull slide along the shell [-]."""


def hindering(
    surface: Surface, depth: Float[Array, " vertex"], pull: Float[Array, "3"]
) -> Bool[Array, " triangle"]:
    """Faces that look against a pull and have some of the shell below them.

    Args:
        surface: The surface that the shell lies on.
        depth: How far each vertex lies above the parting, along the pull [mm].
        pull: Unit direction in which the shell comes off.
    """
    return (surface.normals @ pull < -FLAT) & (depth[surface.triangles] > 0).any(axis=1)


def lean(
    normals: Float[Array, "triangle 3"],
    shell_of: Int[Array, " triangle"],
    pulls: Float[Array, "shell 3"],
) -> Float[Array, " triangle"]:
    """Angle by which faces hinder the shell on them, negative where they let it go [deg].

    Args:
        normals: Unit normals of the faces that shells lie on, outward.
        shell_of: The shell on each.
        pulls: Unit direction in which each shell comes off.
    """
    along = (normals * pulls[shell_of]).sum(axis=1)
    return np.degrees(np.arcsin(np.clip(-along, -1.0, 1.0)))


def undercut_areas(
    angle_deg: Float[Array, " triangle"],
    areas: Float[Array, " triangle"],
    shell_of: Int[Array, " triangle"],
    count: int,
) -> Float[Array, " shell"]:
    """Undercut area of each shell [mm^2]: faces that hinder it by more than `TOLERANCE_DEG`."""
    hindering = np.where(angle_deg > TOLERANCE_DEG, areas, 0.0)
    return np.bincount(shell_of, weights=hindering, minlength=count)


def relief(
    surface: Surface,
    faces: Bool[Array, " triangle"],
    depth: Float[Array, " vertex"],
    pull: Float[Array, "3"],
) -> Manifold:
    """What a shell must lack so that the faces that hinder it let it go.

    Hindering faces look against the pull. Whatever of the shell lies below them, down to the parting, would
    run into them: the faces swept against the pull. The sweep has the very triangles of the surface.

    Args:
        surface: The surface that the shell lies on.
        faces: Which of its triangles hinder the shell.
        depth: How far each vertex lies above the parting, along the pull [mm].
        pull: Unit direction in which the shell comes off.

    Returns:
        The sweep; an empty body where nothing hinders.
    """
    if not faces.any():
        return Manifold()
    corners = surface.triangles[faces]
    top = surface.vertices[corners]
    bottom = top - (np.maximum(depth[corners], 0.0) + EMBED_MM)[..., None] * pull
    prisms = 6 * np.arange(len(corners))[:, None, None] + PRISM
    points = np.concatenate([top, bottom], axis=1)
    swept = body_of(points.reshape(-1, 3), prisms.reshape(-1, 3), "relief of a shell")
    # Faces of a fold lie below one another: their sweeps overlap, and only a union of single ones is sound.
    return Manifold.batch_boolean(swept.decompose(), OpType.Add)
