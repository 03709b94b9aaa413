"""What the wall of the shell is made of: its stiffness against stretching, bending and transverse shear.

All matrices are relative to a solid of unit modulus and of the wall's thickness t, so that one record serves
any modulus and thickness: forces and moments per width are

    N = E t membrane e,    M = E t^3 / 12 bending k,    Q = E t shear g

with the strains e = (e11, e22, 2 e12), the curvatures k alike and the shear angles g = (g13, g23). For a
uniform solid `membrane` and `bending` are the same plane-stress matrix; for a wall of ribs they are not.

Inside the element, the strain at +-t / (2 sqrt 3) from the middle splits into an even and an odd part through
the thickness; the energy there is ``|R_A e_even +- R_D e_odd|^2`` with the symmetric square roots of
`membrane` and `bending`. Both points together give the membrane and the bending energy. What remains is the
small coupling of the two by the curvature of the wall, of order t / radius: it is exact where both matrices
are equal (an isotropic section gives the isotropic element to the last digits) and stays positive definite,
and independent of the axes' choice, where they are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.errors import GeometryError

Array = np.ndarray

_LEAST_EIGENVALUE = 1e-9
"""Softest over stiffest direction of a section below which it counts as indefinite."""

_MANDEL = np.array([1.0, 1.0, np.sqrt(2.0)])
"""Scale of the shear component that makes a turn of the axes an orthogonal matrix."""


@dataclass(frozen=True)
class Section:
    """Relative stiffness of the wall, one for all elements or one for each, in its material axes.

    Attributes:
        membrane: Against stretching, A / (E t) [-].
        bending: Against bending, 12 D / (E t^3) [-].
        shear: Against transverse shear, with the shear correction factor [-].
        directions: Material axis 1 [any length]; its part tangential to the shell counts, axis 2 is a quarter
            turn from it about the director. None: along the first edge of each triangle, for sections that
            have no direction.
    """

    membrane: Float[Array, "stiffness 3 3"]
    bending: Float[Array, "stiffness 3 3"]
    shear: Float[Array, "stiffness 2 2"]
    directions: Float[Array, "direction 3"] | None = None


@dataclass(frozen=True)
class SectionRoots:
    """Square roots of a section's matrices as the element uses them, elements along the last axis.

    Attributes:
        mean: Half the sum of the roots of `membrane` and `bending`, applied to (e11, e22, 2 e12).
        difference: Half their difference; None where they are the same.
        shear: Root of `shear`.
    """

    mean: Float[Array, "3 3 stiffness"]
    difference: Float[Array, "3 3 stiffness"] | None
    shear: Float[Array, "2 2 stiffness"]


def isotropic(poisson: float) -> Section:
    """Section of a uniform isotropic solid in plane stress, shear correction factor 1 as in the publications.

    Args:
        poisson: Poisson's ratio [-].

    Raises:
        GeometryError: The ratio is out of its range.
    """
    if not 0.0 <= poisson < 0.5:
        raise GeometryError(
            f"Poisson's ratio {poisson:g} makes no shell",
            where="material.poisson",
            hint="the ratio must be from 0 to below 0.5",
        )
    plane = np.array([[1.0, poisson, 0.0], [poisson, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - poisson)]])
    plane = plane[None] / (1.0 - poisson**2)
    return Section(plane, plane, 0.5 / (1.0 + poisson) * np.eye(2)[None])


def orthotropic(
    membrane: Float[Array, "stiffness 3 3"],
    directions: Float[Array, "direction 3"],
    bending: Float[Array, "stiffness 3 3"] | None = None,
    shear: Float[Array, "stiffness 2 2"] | None = None,
) -> Section:
    """Section of a wall with two material axes.

    Args:
        membrane: Relative plane-stress stiffness in the material axes [-], as homogenization gives it.
        directions: Material axis 1 of each element, or of all [any length].
        bending: Relative bending stiffness [-]; that of a wall which is the same through its thickness, equal
            to `membrane`, if left out.
        shear: Relative transverse shear stiffness [-]; the in-plane shear modulus in both directions if left
            out.
    """
    if shear is None:
        shear = membrane[..., 2, 2, None, None] * np.eye(2)
    return Section(membrane, membrane if bending is None else bending, shear, directions)


def check_section(section: Section, triangles: int) -> None:
    """Refuse a section that does not fit the triangles.

    Raises:
        GeometryError: An array has neither one entry for all triangles nor one for each.
    """
    parts = (("membrane", (3, 3)), ("bending", (3, 3)), ("shear", (2, 2)), ("directions", (3,)))
    for name, each in parts:
        part = getattr(section, name)
        if part is not None and np.shape(part) not in ((1, *each), (triangles, *each)):
            raise GeometryError(
                f"{name} of shape {np.shape(part)} for {triangles} triangles",
                where="section of the wall",
                hint=f"give shape {(1, *each)} for all triangles alike, or {(triangles, *each)}",
            )


def map_directions(
    corners: Float[Array, "triangle 3 3"], corner_uv: Float[Array, "triangle 3 2"]
) -> Float[Array, "triangle 3"]:
    """Directions on the surface in which u grows and v stays: axis 1 of a microstructure laid along the map.

    Args:
        corners: Corner positions of each triangle, at rest or posed [mm].
        corner_uv: The flat map at the same corners.

    Returns:
        Change of position per u [mm].

    Raises:
        GeometryError: A triangle has no area in the map.
    """
    edges, flat = corners[:, 1:] - corners[:, :1], corner_uv[:, 1:] - corner_uv[:, :1]
    area = flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] * flat[:, 1, 0]
    lost = np.flatnonzero(~(np.abs(area) > 1e-12 * (flat**2).sum(axis=(1, 2))))
    if lost.size:
        raise GeometryError(
            f"{lost.size} triangles have no area in the flat map, so that nothing says where u grows",
            where=f"triangle {lost[0]} of the shell",
            hint="flatten the surface anew",
        )
    return (edges[:, 0] * flat[:, 1, 1, None] - edges[:, 1] * flat[:, 0, 1, None]) / area[:, None]


def map_rotations(
    corners: Float[Array, "triangle 3 3"], corner_uv: Float[Array, "triangle 3 2"]
) -> Float[Array, "triangle 3 3"]:
    """Rotations from the axes of the flat map to those of the surface (paper, Sec. 3.3.1).

    Args:
        corners: Corner positions of each triangle, at rest or posed [mm].
        corner_uv: The flat map at the same corners.

    Returns:
        Unit columns: where u grows (see `map_directions`), a quarter turn from it in the triangle, where v
        grows if the map is conformal, and the normal. Strains and sections that lie along the map go to the
        frame of the brace by them.

    Raises:
        GeometryError: A triangle has no area in the map.
    """
    along = map_directions(corners, corner_uv)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([along, np.cross(normal, along), normal], axis=-1)


def section_roots(section: Section) -> SectionRoots:
    """Square roots of the matrices of a section.

    Raises:
        GeometryError: A matrix is not symmetric and positive definite; the triangle is named.
    """
    membrane = _root(section.membrane, _MANDEL, "membrane")
    shear = _root(section.shear, np.ones(2), "transverse shear")
    if section.bending is section.membrane:
        return SectionRoots(membrane, None, shear)
    bending = _root(section.bending, _MANDEL, "bending")
    return SectionRoots(0.5 * (membrane + bending), 0.5 * (membrane - bending), shear)


def part_of(roots: SectionRoots, part: slice) -> SectionRoots:
    """The roots of a part of the elements; those of one section for all serve any part."""

    def chosen(root: Float[Array, "n n stiffness"]) -> Float[Array, "n n chosen"]:
        return root[..., part] if root.shape[-1] > 1 else root

    difference = None if roots.difference is None else chosen(roots.difference)
    return SectionRoots(chosen(roots.mean), difference, chosen(roots.shear))


def _root(
    matrices: Float[Array, "stiffness n n"], scale: Float[Array, " n"], name: str
) -> Float[Array, "n n stiffness"]:
    """Roots R with ``R^T R`` the matrix, symmetric in the scaled components; elements along the last axis."""
    scaled = matrices * np.outer(scale, scale)
    size = np.abs(scaled).max(axis=(1, 2), initial=0.0)
    skew = np.abs(scaled - scaled.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    usable = np.isfinite(size) & (skew <= 1e-9 * size)
    values, axes = np.linalg.eigh(np.where(usable[:, None, None], scaled, 0.0))
    wrong = np.flatnonzero(~(usable & (values[:, 0] > _LEAST_EIGENVALUE * values[:, -1])))
    if wrong.size:
        raise GeometryError(
            f"the {name} stiffness of {wrong.size} of {len(matrices)} sections is not symmetric and positive"
            " definite",
            where=f"section of triangle {wrong[0]}",
            hint="check the homogenized stiffness: every strain must cost energy",
        )
    root = (axes * np.sqrt(values)[:, None]) @ axes.transpose(0, 2, 1) / scale
    return np.ascontiguousarray(root.transpose(1, 2, 0))
