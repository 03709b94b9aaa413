"""The shell model of a brace: geometry, unit-modulus stiffness and sparsity, built once per shape."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError
from hilbrace.shell.assembly import Numbering, number
from hilbrace.shell.directors import nodal_directors, tangent_basis, triangle_normals
from hilbrace.shell.element import element_stiffness, element_stiffness_and_slope
from hilbrace.shell.foundation import Foundation, Ground, check_foundation, ground_stiffness
from hilbrace.shell.loops import loop_centres, loop_motions, rigid_motions
from hilbrace.shell.maps import StiffnessMaps, VertexPairs, stiffness_maps, vertex_pairs
from hilbrace.shell.mesh_checks import check_shape, check_surface, check_thickness
from hilbrace.shell.section import Section, check_section, isotropic

Array = np.ndarray


@dataclass(frozen=True)
class ShellModel:
    """A shell that is clamped at both loops, ready for any distribution of the modulus.

    At 10k triangles a model holds some 10 MB besides what all shapes of one brace share; the dense element
    stiffness is not kept, `unit_stiffness` computes it.

    Attributes:
        vertices: Positions [mm].
        triangles: Vertex indices, one orientation throughout.
        upper_loop: Vertices of the upper (proximal) loop.
        lower_loop: Vertices of the lower (distal) loop.
        thickness_mm: Thickness of each triangle [mm].
        section: What the wall is made of, relative to a solid of unit modulus.
        centres: Centres of the upper and the lower loop [mm], about which loop moments are taken.
        numbering: Degrees of freedom and sparsity; shared by all shapes of one brace.
        loop_motions: Rigid motions G of the loops on the clamped degrees of freedom.
        rigid: Rigid motions of the whole shell about the upper loop's centre on the free ones.
        maps: Contributions of the triangles to the stiffness.
        foundation: The skin under the brace, if it carries part of the load.
        ground: What the skin adds to the stiffness.
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    upper_loop: Int[Array, " upper"]
    lower_loop: Int[Array, " lower"]
    thickness_mm: Float[Array, " triangle"]
    section: Section
    centres: Float[Array, "2 3"]
    numbering: Numbering
    loop_motions: Float[Array, "clamped 12"]
    rigid: Float[Array, "free 6"]
    maps: StiffnessMaps
    foundation: Foundation | None = None
    ground: Ground | None = None

    @property
    def refill(self) -> sp.csr_array:
        """Matrix from the modulus to the stored triangle of the free stiffness."""
        return self.maps.refill

    @property
    def clamped(self) -> Int[Array, " clamped"]:
        """Degrees of freedom of the loops, ascending."""
        return np.flatnonzero(self.numbering.equation < 0)

    @property
    def motions(self) -> Float[Array, "dof 12"]:
        """Rigid motions G of the loops on all degrees of freedom, zero on free ones."""
        motions = np.zeros((len(self.numbering.equation), self.loop_motions.shape[1]))
        motions[self.clamped] = self.loop_motions
        return motions


def build_shell(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    upper_loop: Int[Array, " upper"],
    lower_loop: Int[Array, " lower"],
    thickness_mm: float | Float[Array, " triangle"],
    wall: float | Section,
) -> ShellModel:
    """Build the shell model of a surface that is clamped at two loops.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices, one orientation throughout.
        upper_loop: Vertices of the upper (proximal) loop.
        lower_loop: Vertices of the lower (distal) loop.
        thickness_mm: Thickness [mm], one for all or one for each triangle.
        wall: Poisson's ratio of a uniform isotropic wall [-], at least 0 and below 0.5, or the section of any
            other wall.

    Raises:
        GeometryError: The loops or the triangles make no shell.
        SolverError: A vertex or a part of the surface is held by nothing.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    triangles, upper_loop, lower_loop = (np.asarray(part) for part in (triangles, upper_loop, lower_loop))
    check_surface(vertices, triangles, upper_loop, lower_loop)
    thickness = np.array(thickness_mm, dtype=np.float64)
    if thickness.ndim == 0:
        thickness = np.full(len(triangles), float(thickness))
    _check_count(thickness, len(triangles))
    check_thickness(thickness)
    section = wall if isinstance(wall, Section) else isotropic(wall)
    check_section(section, len(triangles))
    numbering = number(len(vertices), triangles, np.concatenate([upper_loop, lower_loop]))
    shape = _Shape(vertices, triangles, upper_loop, lower_loop, thickness, section, numbering, None)
    return _assemble(shape, vertex_pairs(numbering.sparsity))


def pose_shell(shell: ShellModel, vertices: Float[Array, "vertex 3"]) -> ShellModel:
    """The same shell in another shape, stress-free there; numbering and sparsity are shared.

    Material directions of the wall are carried along with the triangles, as lines drawn on them.

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
    vertices = np.asarray(vertices, dtype=np.float64)
    check_shape(vertices, shell.triangles)
    section = _carried(shell.section, shell.triangles, shell.vertices, vertices)
    return _assemble(replace(_shape_of(shell), vertices=vertices, section=section), shell.maps.pairs)


def thicken_shell(shell: ShellModel, thickness_mm: Float[Array, " triangle"]) -> ShellModel:
    """The same shell with another thickness of each triangle [mm].

    Raises:
        GeometryError: A thickness is not positive, or more than the bend of the wall allows.
    """
    _check_count(thickness_mm, len(shell.triangles))
    check_thickness(thickness_mm)
    return _assemble(replace(_shape_of(shell), thickness_mm=thickness_mm), shell.maps.pairs)


def lay_on_skin(shell: ShellModel, foundation: Foundation) -> ShellModel:
    """The same shell, borne by the skin under it.

    Raises:
        GeometryError: The foundation belongs to another mesh, follows the wrong loops, or makes no skin.
    """
    check_foundation(foundation, len(shell.vertices), shell.upper_loop, shell.lower_loop)
    shape = replace(_shape_of(shell), foundation=foundation)
    return replace(shell, foundation=foundation, ground=_ground(shape, _directors(shape)))


def unit_stiffness(shell: ShellModel) -> Float[Array, "triangle 15 15"]:
    """Stiffness of each element for unit modulus."""
    shape = _shape_of(shell)
    return element_stiffness(*_wall(shape, _directors(shape)))


def thickness_slopes(shell: ShellModel) -> StiffnessMaps:
    """Derivatives of the contributions of the triangles, each by its own thickness [1/mm]."""
    shape = _shape_of(shell)
    _, slope = element_stiffness_and_slope(*_wall(shape, _directors(shape)))
    return stiffness_maps(shell.numbering, shell.maps.pairs, slope, shell.motions)


@dataclass(frozen=True)
class _Shape:
    """What a shell model is built from."""

    vertices: Array
    triangles: Array
    upper_loop: Array
    lower_loop: Array
    thickness_mm: Array
    section: Section
    numbering: Numbering
    foundation: Foundation | None


def _check_count(thickness: Float[Array, " given"], triangles: int) -> None:
    if thickness.shape != (triangles,):
        raise GeometryError(
            f"thickness of shape {thickness.shape} for {triangles} triangles",
            where="shell",
            hint="give one thickness per triangle",
        )


def _shape_of(shell: ShellModel) -> _Shape:
    return _Shape(**{part.name: getattr(shell, part.name) for part in fields(_Shape)})


def _assemble(shape: _Shape, pairs: VertexPairs) -> ShellModel:
    directors = _directors(shape)
    numbering, loops = shape.numbering, (shape.upper_loop, shape.lower_loop)
    tangents, centres = tangent_basis(directors), loop_centres(shape.vertices, *loops)
    motions = loop_motions(shape.vertices, tangents, *loops)
    return ShellModel(
        vertices=shape.vertices,
        triangles=shape.triangles,
        upper_loop=shape.upper_loop,
        lower_loop=shape.lower_loop,
        thickness_mm=shape.thickness_mm,
        section=shape.section,
        centres=centres,
        numbering=numbering,
        loop_motions=motions[numbering.equation < 0],
        rigid=rigid_motions(shape.vertices, tangents, centres[0])[numbering.free],
        maps=stiffness_maps(numbering, pairs, element_stiffness(*_wall(shape, directors)), motions),
        foundation=shape.foundation,
        ground=_ground(shape, directors),
    )


def _carried(
    section: Section,
    triangles: Int[Array, "triangle 3"],
    before: Float[Array, "vertex 3"],
    after: Float[Array, "vertex 3"],
) -> Section:
    """A section whose directions keep their components along two edges and the normal of each triangle."""
    if section.directions is None:
        return section
    rest, posed = (
        np.concatenate(
            [np.diff(shape[triangles], axis=1), triangle_normals(shape, triangles)[0][:, None]], axis=1
        )
        for shape in (before, after)
    )
    along = np.linalg.solve(rest.transpose(0, 2, 1), section.directions[:, :, None])
    return replace(section, directions=(posed.transpose(0, 2, 1) @ along)[:, :, 0])


def _directors(shape: _Shape) -> Float[Array, "vertex 3"]:
    return nodal_directors(shape.vertices, shape.triangles)


def _wall(
    shape: _Shape, directors: Float[Array, "vertex 3"]
) -> tuple[Array, Array, Array, Float[Array, " triangle"], Section]:
    """What the element needs: corners, directors, tangents, thickness and section."""
    corners = shape.triangles
    tangents = tangent_basis(directors)
    return (
        shape.vertices[corners],
        directors[corners],
        tangents[corners],
        shape.thickness_mm,
        shape.section,
    )


def _ground(shape: _Shape, directors: Float[Array, "vertex 3"]) -> Ground | None:
    if shape.foundation is None:
        return None
    centres = loop_centres(shape.vertices, shape.upper_loop, shape.lower_loop)
    return ground_stiffness(
        shape.foundation, shape.vertices, shape.triangles, directors, centres, shape.numbering
    )
