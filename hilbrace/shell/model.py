"""The shell model of a brace: geometry, unit-modulus stiffness and sparsity, built once per shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from hilbrace.errors import GeometryError, SolverError
from hilbrace.shell.assembly import Numbering, coupling_map, number, refill_map
from hilbrace.shell.directors import nodal_directors, tangent_basis
from hilbrace.shell.element import element_stiffness
from hilbrace.shell.loops import loop_centres, loop_motions

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
    _check_numbers(vertices, thickness_mm, poisson)
    _check_loops(upper_loop, lower_loop)
    _check_supported(len(vertices), triangles, upper_loop, lower_loop)
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
    _check_numbers(vertices, shell.thickness_mm, shell.poisson)
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
        vertices[triangles], directors[triangles], tangents[triangles], thickness_mm, poisson
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


def _check_numbers(vertices: Float[Array, "vertex 3"], thickness_mm: float, poisson: float) -> None:
    if not (thickness_mm > 0 and 0 <= poisson < 0.5):
        raise GeometryError(
            f"thickness {thickness_mm:g} mm and Poisson's ratio {poisson:g} make no shell",
            where="material.thickness_mm, material.poisson",
            hint="the thickness must be above 0, the ratio from 0 to below 0.5",
        )
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if bad.size:
        raise GeometryError(
            f"{bad.size} vertices have no finite position",
            where=f"vertex {bad[0]} of the shell",
            hint="check the frame of the motion that posed the surface",
        )


def _check_loops(upper_loop: Int[Array, " upper"], lower_loop: Int[Array, " lower"]) -> None:
    for name, loop in (("upper", upper_loop), ("lower", lower_loop)):
        if len(np.unique(loop)) < 3 or len(np.unique(loop)) != len(loop):
            raise GeometryError(
                f"the {name} loop is no loop: {len(loop)} vertices, {len(np.unique(loop))} of them different",
                where="domain",
                hint="a loop needs three vertices or more, each once",
            )
    shared = np.intersect1d(upper_loop, lower_loop)
    if shared.size:
        raise GeometryError(
            f"{shared.size} vertices lie on both loops",
            where=f"vertex {shared[0]} of the domain",
            hint="move the edges of the region apart",
        )


def _check_supported(
    vertices: int,
    triangles: Int[Array, "triangle 3"],
    upper_loop: Int[Array, " upper"],
    lower_loop: Int[Array, " lower"],
) -> None:
    loose = np.setdiff1d(np.arange(vertices), triangles)
    if loose.size:
        raise SolverError(
            f"{loose.size} vertices belong to no triangle, so nothing holds them",
            where=f"vertex {loose[0]} of the shell",
            hint="drop unused vertices from the surface",
        )
    part = _parts(triangles, vertices)
    on_loop = np.isin(triangles, np.concatenate([upper_loop, lower_loop]))
    part_and_vertex = np.stack([np.broadcast_to(part[:, None], triangles.shape), triangles], axis=-1)
    supports = np.unique(part_and_vertex[on_loop], axis=0)[:, 0]
    held = np.flatnonzero(np.bincount(supports, minlength=part.max() + 1) >= 2)
    floating = np.flatnonzero(~np.isin(part, held))
    if floating.size:
        raise SolverError(
            f"{floating.size} triangles are held by no edge of a loop",
            where=f"triangle {floating[0]} of the shell",
            hint="keep the one part of the surface that joins both loops, without flaps on single vertices",
        )


def _parts(triangles: Int[Array, "triangle 3"], vertices: int) -> Int[Array, " triangle"]:
    """Number of the part that each triangle belongs to; triangles hang together by shared edges."""
    start, end = triangles.ravel().astype(np.int64), np.roll(triangles, -1, axis=1).ravel()
    key = np.minimum(start, end) * vertices + np.maximum(start, end)
    edges, edge = np.unique(key, return_inverse=True)
    owner = np.repeat(np.arange(len(triangles)), 3)
    shape = (len(triangles), len(edges))
    incidence = sp.csr_array((np.ones(len(owner)), (owner, edge)), shape=shape)
    _, part = connected_components(incidence @ incidence.T, directed=False)
    return part
