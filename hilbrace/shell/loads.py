"""How the acting force reaches the shell: F_t = W f_t with one fixed pattern W.

Every vertex takes a share of the force: its tributary area times a Gaussian window about the joint line. The
shares sum to one, so the whole force arrives whatever the mesh. With the pattern fixed, three solves serve
any number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError, SolverError
from hilbrace.shell.directors import triangle_normals

Array = np.ndarray


@dataclass(frozen=True)
class LoadPattern:
    """Loads of all frames on one shell.

    Attributes:
        shares: Share of the force that each vertex takes [-]; they sum to one.
        forces: Force on the brace in each frame [N], in the rest frame of the domain.
    """

    shares: Float[Array, " vertex"]
    forces: Float[torch.Tensor, "frame 3"]


@dataclass(frozen=True)
class NodalLoads:
    """Loads of all frames, vertex by vertex.

    Attributes:
        forces: Force on each vertex in each frame [N]. What acts on a clamped vertex goes straight into the
            reaction of its loop.
    """

    forces: Float[torch.Tensor, "frame vertex 3"]


def check_loads(load: LoadPattern | NodalLoads, vertices: int, frames: int) -> None:
    """Refuse loads that do not fit the shell, or that are not finite.

    Args:
        load: The loads.
        vertices: Number of vertices of the shell.
        frames: Number of frames.

    Raises:
        SolverError: The frame or the vertex is named.
    """
    pattern = isinstance(load, LoadPattern)
    expected = (frames, 3) if pattern else (frames, vertices, 3)
    fits = not pattern or load.shares.shape == (vertices,)
    if tuple(load.forces.shape) != expected or not fits:
        raise SolverError(
            f"loads of shape {tuple(load.forces.shape)} for {frames} frames and {vertices} vertices",
            where="loads of the shell",
            hint="give one force per frame and one share per vertex, or a force per frame and vertex",
        )
    if pattern and not np.isfinite(load.shares).all():
        raise SolverError(
            "a share of the load is not finite",
            where=f"vertex {np.flatnonzero(~np.isfinite(load.shares))[0]} of the load pattern",
            hint="compute the shares by joint_line_shares",
        )
    known = np.isfinite(load.forces.detach().numpy())
    lost = np.flatnonzero(~known.all(axis=tuple(range(1, known.ndim))))
    if lost.size:
        raise SolverError(
            f"the loads of {lost.size} frames are not finite",
            where=f"frame {lost[0]}",
            hint="check the joint loads of this frame",
        )


def joint_line_shares(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    window_mm: float,
    centre: Float[Array, " xyz"] | None = None,
    axis: Float[Array, " xyz"] | None = None,
) -> Float[Array, " vertex"]:
    """Share of the acting force that each vertex takes [-], summing to one.

    A triangle weighs its area times ``exp(-(h / window)^2)`` with h its centre's height over the joint line,
    and gives a third to each corner.

    Args:
        vertices: Rest positions [mm].
        triangles: Vertex indices.
        window_mm: Width of the window [mm].
        centre: Point of the joint line [mm]; the origin, where the domain puts the joint, if left out.
        axis: Direction of the limb; y, as in the neutral pose, if left out.

    Raises:
        GeometryError: No part of the surface lies near the joint line, or the window or the axis is none.
    """
    along = np.array([0.0, 1.0, 0.0]) if axis is None else np.asarray(axis, dtype=float)
    length = float(np.linalg.norm(along))
    if not (window_mm > 0.0 and 0.0 < length < np.inf):
        raise GeometryError(
            f"a window of {window_mm:g} mm along an axis of length {length:g}",
            where="load window of the shell",
            hint="give a width above 0 and a direction of the limb",
        )
    along = along / length
    origin = np.zeros(3) if centre is None else np.asarray(centre)
    _, area = triangle_normals(vertices, triangles)
    height = (vertices[triangles].mean(axis=1) - origin) @ along
    weight = area * np.exp(-((height / window_mm) ** 2))
    shares = np.bincount(triangles.ravel(), np.repeat(weight / 3.0, 3), minlength=len(vertices))
    if not shares.sum() > 1e-9 * area.sum():
        raise GeometryError(
            "no part of the brace lies near the joint line",
            where=f"load window of {window_mm:g} mm, nearest triangle {np.abs(height).min():.0f} mm away",
            hint="let the domain reach over the joint, or widen optimize.load_window_mm",
        )
    return shares / shares.sum()
