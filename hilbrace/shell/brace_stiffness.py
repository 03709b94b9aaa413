"""How stiff a brace is at the joint: four numbers for any brace mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError
from hilbrace.shell.boundary import end_loops
from hilbrace.shell.joint_stiffness import joint_stiffness
from hilbrace.shell.mesh_checks import check_sheet
from hilbrace.shell.model import build_shell
from hilbrace.shell.response import loop_stiffness
from hilbrace.shell.section import Section
from hilbrace.units import MM_PER_M

Array = np.ndarray


_ALONG = 0.25
"""Least cosine between the upward axis and the line through the centres of the ends: 75 degrees."""


@dataclass(frozen=True)
class BraceStiffness:
    """Stiffness of a brace against moving its lower end rigidly while its upper end stays.

    Small motions about the shape of the mesh, free of stress; the joint fixes the centre of rotation.

    Attributes:
        frontal_nm_per_deg: Moment per angle about the anterior axis (adduction) [N*m/deg].
        sagittal_nm_per_deg: About the lateral axis (flexion) [N*m/deg].
        axial_nm_per_deg: About the axis of the limb (rotation) [N*m/deg].
        stretch_n_per_mm: Force per distance along the axis of the limb [N/mm].
        loop_stiffness: The whole stiffness between the motions of both loops, about their own centres: upper
            translation and rotation, lower translation and rotation [N/mm, N, N*mm/rad].
        upper_loop: Vertices of the upper end.
        lower_loop: Vertices of the lower end.
    """

    frontal_nm_per_deg: float
    sagittal_nm_per_deg: float
    axial_nm_per_deg: float
    stretch_n_per_mm: float
    loop_stiffness: Float[Array, "12 12"]
    upper_loop: Int[Array, " upper"]
    lower_loop: Int[Array, " lower"]


def brace_stiffness(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    modulus_mpa: float | Float[Array, " triangle"],
    thickness_mm: float | Float[Array, " triangle"],
    wall: float | Section = 0.45,
    *,
    centre: Float[Array, " xyz"],
    axes: Float[Array, "3 3"] | None = None,
    loops: tuple[Int[Array, " upper"], Int[Array, " lower"]] | None = None,
) -> BraceStiffness:
    """Stiffness of a brace about the axes of its joint.

    The mesh is the surface of an open sleeve, with windows if it has any; both ends are clamped, the upper
    one to the proximal and the lower one to the distal segment of the limb. A straight tube of rubber:

    >>> import numpy as np
    >>> from hilbrace.shell import brace_stiffness
    >>> turn, height = np.meshgrid(np.linspace(0, 2 * np.pi, 40, endpoint=False), np.linspace(-150, 150, 41))
    >>> vertices = np.stack([60 * np.cos(turn), height, -60 * np.sin(turn)], axis=-1).reshape(-1, 3)
    >>> here = np.arange(40 * 40).reshape(40, 40)
    >>> right = np.roll(here, -1, axis=1)
    >>> lower, upper = np.stack([here, right, right + 40], -1), np.stack([here, right + 40, here + 40], -1)
    >>> triangles = np.concatenate([lower, upper]).reshape(-1, 3)
    >>> stiffness = brace_stiffness(vertices, triangles, 1.15, thickness_mm=4.0, centre=np.zeros(3))
    >>> print(f"{stiffness.frontal_nm_per_deg:.2f} N*m/deg, {stiffness.stretch_n_per_mm:.1f} N/mm")
    0.18 N*m/deg, 5.9 N/mm

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices, one orientation throughout.
        modulus_mpa: Young's modulus, one for all or one for each triangle [MPa].
        thickness_mm: Thickness, one for all or one for each triangle [mm].
        wall: Poisson's ratio of a uniform isotropic wall [-], or the section of any other.
        centre: Centre of the joint [mm]; the origin for a domain of hilbrace. About another centre the brace
            is stiffer or softer by its shear.
        axes: Unit vectors of the anterior, the upward and the lateral axis; x, y and z if left out.
        loops: Vertices of the upper and the lower end; found by themselves if left out.

    Raises:
        GeometryError: The mesh is no sleeve between two ends, the axes are no unit vectors, or the limb does
            not run along the upward one.
        SolverError: The modulus is not positive, or a part of the mesh is held by nothing.
    """
    frame = _axes(axes)
    vertices, triangles = np.asarray(vertices, dtype=float), np.asarray(triangles)
    if loops is None:
        check_sheet(vertices, triangles)
        loops = end_loops(vertices, triangles, frame[1])
    upper, lower = loops
    shell = build_shell(vertices, triangles, upper, lower, thickness_mm, wall)
    _check_upward(shell.centres, frame[1])
    modulus = np.array(modulus_mpa, dtype=float)
    if modulus.ndim == 0:
        modulus = np.full(len(triangles), float(modulus))
    stiffness = loop_stiffness(torch.from_numpy(modulus), shell)
    about = np.diag(joint_stiffness(stiffness, shell, frame, centre).numpy()) * np.deg2rad(1.0) / MM_PER_M
    between = stiffness.numpy()
    return BraceStiffness(
        frontal_nm_per_deg=float(about[0]),
        sagittal_nm_per_deg=float(about[2]),
        axial_nm_per_deg=float(about[1]),
        stretch_n_per_mm=float(frame[1] @ between[6:9, 6:9] @ frame[1]),
        loop_stiffness=between,
        upper_loop=upper,
        lower_loop=lower,
    )


def _axes(axes: Float[Array, "3 3"] | None) -> Float[Array, "3 3"]:
    frame = np.eye(3) if axes is None else np.asarray(axes, dtype=float)
    if frame.shape != (3, 3) or not np.allclose(np.linalg.norm(frame, axis=1), 1.0, atol=1e-6):
        raise GeometryError(
            "the axes of the joint are no three unit vectors",
            where="argument axes",
            hint="give three vectors of length one: anterior, upward, lateral",
        )
    return frame


def _check_upward(centres: Float[Array, "2 3"], upward: Float[Array, " xyz"]) -> None:
    """A mesh that stands on another axis would have its stiffnesses named wrongly."""
    along = centres[0] - centres[1]
    cosine = float(abs(along @ upward) / np.linalg.norm(along))
    if not cosine > _ALONG:
        raise GeometryError(
            f"the limb runs at {np.rad2deg(np.arccos(cosine)):.0f} degrees to the upward axis",
            where="argument axes",
            hint="give the anterior, the upward and the lateral axis in the frame of the mesh",
        )
