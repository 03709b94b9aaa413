"""The shell model of a brace: geometry, unit-modulus stiffness and sparsity, built once per shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError
from hilbrace.shell.assembly import Numbering, coupling_map, number, refill_map
from hilbrace.shell.directors import nodal_directors, tangent_basis
from hilbrace.shell.element import element_stiffness
from hilbrace.shell.loops import loop_centres, loop_motions
from hilbrace.shell.mesh_checks import check_shape, check_surface, check_thickness
from hilbrace.shell.section import isotropic

Array = np.ndarray


@dataclass(frozen=True)
class ShellModel:
    """A shell that is clamped at both loops, ready for any distribution of the modulus.

    Attributes:
        vertices: Positions [mm].
        triangles: Vertex indices, one orientation throughout.
        upper_loop: Vertices of the upper (proximal) loop.
        lower_loop: Vertices of the lower (distal) loop.
        thickness_mm: Thickness [mm].
        poisson: Poisson's ratio [-].
        centres: Centres of the upper and the lower loop [mm], about which loop moments are taken.
        numbering: Degrees of freedom and sparsity; shared by all shapes of one brace.
        stiffness: Unit-modulus stiffness of each element.
        motions: Rigid motions G of the loops on all degrees of freedom.
        refill: Matrix from the modulus to the values of the free stiffness.
        coupling: Matrix from the modulus to the flattened K_fb G.
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    upper_loop: Int[Array, " upper"]
    lower_loop: Int[Array, " lower"]
    thickness_mm: float
    poisson: float
    centres: Float[Array, "2 3"]
    numbering: Numbering
    stiffness: Float[Array, "triangle 15 15"]
    motions: Float[Array, "dof 12"]
    refill: sp.csr_array
    coupling: sp.csr_array


def build_shell(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    upper_loop: Int[Array, " upper"],
    lower_loop: Int[Array, " lower"],
    thickness_mm: float,
    poisson: float,
) -> ShellModel:
    """Build the shell model of a surface that is clamped at two loops.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices, one orientation throughout.
        upper_loop: Vertices of the upper (proximal) loop.
        lower_loop: Vertices of the lower (distal) loop.
        thickness_mm: Thickness [mm].
        poisson: Poisson's ratio [-], at least 0 and below 0.5.

    Raises:
        GeometryError: The loops or the triangles make no shell.
        SolverError: A vertex or a part of the surface is held by nothing.
    """
    check_surface(vertices, triangles, upper_loop, lower_loop)
    check_thickness(np.full(len(triangles), float(thickness_mm)))
    numbering = number(len(vertices), triangles, np.concatenate([upper_loop, lower_loop]))
    return _assemble(vertices, triangles, upper_loop, lower_loop, thickness_mm, poisson, numbering)


def pose_shell(shell: ShellModel, vertices: Float[Array, "vertex 3"]) -> ShellModel:
    """The same shell in another shape, stress-free there; numbering and sparsity are shared.

    Args:
        shell: The shell in one shape.
        vertices: Positions in the other shape [mm].

    Raises:
        GeometryError: The shape has folds or triangles without area.
    """
    if vertices.shape != shell.vertices.shape:
        raise GeometryError(
            f"{len(vertices)} posed vertices for a shell of {len(shell.vertices)}",
            where="posed shape of the shell",
            hint="pose the vertices of the same domain",
        )
    check_shape(vertices, shell.triangles)
    return _assemble(
        vertices,
        shell.triangles,
        shell.upper_loop,
        shell.lower_loop,
        shell.thickness_mm,
        shell.poisson,
        shell.numbering,
    )


def _assemble(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    upper_loop: Int[Array, " upper"],
    lower_loop: Int[Array, " lower"],
    thickness_mm: float,
    poisson: float,
    numbering: Numbering,
) -> ShellModel:
    directors = nodal_directors(vertices, triangles)
    tangents = tangent_basis(directors)
    stiffness = element_stiffness(
        vertices[triangles],
        directors[triangles],
        tangents[triangles],
        np.full(len(triangles), float(thickness_mm)),
        isotropic(poisson),
    )
    motions = loop_motions(vertices, tangents, upper_loop, lower_loop)
    return ShellModel(
        vertices=vertices,
        triangles=triangles,
        upper_loop=upper_loop,
        lower_loop=lower_loop,
        thickness_mm=thickness_mm,
        poisson=poisson,
        centres=loop_centres(vertices, upper_loop, lower_loop),
        numbering=numbering,
        stiffness=stiffness,
        motions=motions,
        refill=refill_map(numbering, stiffness),
        coupling=coupling_map(numbering, stiffness, motions),
    )
