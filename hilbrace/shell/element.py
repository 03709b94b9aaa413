"""The MITC3+ triangular shell element, vectorised over elements.

Three corner nodes and one internal node that carries rotations only (a cubic bubble), condensed element by
element; assumed transverse shear strains. Lee, Lee & Bathe 2014, "The MITC3+ shell element and its
performance", Computers & Structures 138:12-23 (its equation numbers are quoted below). Plane stress, shear
correction factor 1, two integration points through the thickness and three in the plane.

Degrees of freedom of a corner: three translations along the global axes [mm] and two rotations about the
tangents of its director [rad]. The stiffness is that of unit modulus: multiply it by E [MPa].

The strain at all integration points is ``Q R d``. R, 16 rows (`hilbrace.shell.strain_modes`), holds what
the displacements d do to the element, wherever one looks; Q (`hilbrace.shell.strain_points`) holds what each
point sees of it in the material axes, times the root of its weight and elasticity. So ``K = R^T (Q^T Q) R``,
and only Q knows the thickness. All functions are pure and spend their time in numpy, which lets threads run.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from hilbrace.shell.section import Section, part_of, section_roots
from hilbrace.shell.strain_modes import ELEMENT_DOFS, NODE_DOFS, SHEAR_ROWS, geometry_of, strain_modes
from hilbrace.shell.strain_points import PlaneRule, PointRows, material_frames, point_rows

__all__ = [
    "ELEMENT_DOFS",
    "NODE_DOFS",
    "THREE_POINTS",
    "element_stiffness",
    "element_stiffness_and_slope",
    "uncondensed_stiffness",
]

Array = np.ndarray

THREE_POINTS: PlaneRule = (np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]]), np.full(3, 1 / 6))
"""In-plane rule that reproduces the published displacements."""

_CHUNK = 360
"""Elements at a time: few enough for the cache, and no power of two, whose strides share its lines."""

_COMPLEX_STEP = 1e-30
"""Imaginary part of the thickness relative to it; its square is lost, so that the derivative is exact."""


def element_stiffness(
    corners: Float[Array, "element 3 3"],
    directors: Float[Array, "element 3 3"],
    tangents: Float[Array, "element 3 2 3"],
    thickness: Float[Array, " element"],
    section: Section,
) -> Float[Array, "element 15 15"]:
    """Stiffness of each element for unit modulus; times E [MPa] it is in N/mm, N and N*mm.

    Args:
        corners: Corner positions [mm].
        directors: Unit director at each corner [-].
        tangents: Two unit tangents of each director [-], the axes of the corner's rotations.
        thickness: Thickness of each element [mm].
        section: What the wall is made of.

    Raises:
        GeometryError: A director leans away from its triangle, the wall is thicker than its bend allows, a
            material direction stands upright, or a section is not positive definite; the triangle is named.
    """
    out = np.empty((len(corners), ELEMENT_DOFS, ELEMENT_DOFS))
    for part, modes, rows in _chunks(corners, directors, tangents, thickness, section, THREE_POINTS):
        out[part], _ = _condense(_between(modes, _gram(rows)))
    return out


def element_stiffness_and_slope(
    corners: Float[Array, "element 3 3"],
    directors: Float[Array, "element 3 3"],
    tangents: Float[Array, "element 3 2 3"],
    thickness: Float[Array, " element"],
    section: Section,
) -> tuple[Float[Array, "element 15 15"], Float[Array, "element 15 15"]]:
    """Stiffness of each element and its derivative by the element's own thickness, both for unit modulus.

    The derivative [per mm] is exact: a complex step through the integration points, and the chain rule
    through the condensation. Modulus, section and directors are held.

    Args: as in `element_stiffness`.

    Raises:
        GeometryError: As in `element_stiffness`.
    """
    value = np.empty((len(corners), ELEMENT_DOFS, ELEMENT_DOFS))
    slope = np.empty_like(value)
    stepped = thickness * (1.0 + 1j * _COMPLEX_STEP)
    for part, modes, rows in _chunks(corners, directors, tangents, stepped, section, THREE_POINTS):
        real = PointRows(*(np.ascontiguousarray(np.real(one)) for one in (rows.in_plane, rows.shear)))
        step = stepped[part].imag[:, None, None]
        imaginary = PointRows(np.imag(rows.in_plane) / step, np.imag(rows.shear) / step)
        value[part], held = _condense(_between(modes, _gram(real)))
        slope[part] = _condensed_slope(_between(modes, _gram_slope(real, imaginary)), held)
    return value, slope


def uncondensed_stiffness(
    corners: Float[Array, "element 3 3"],
    directors: Float[Array, "element 3 3"],
    tangents: Float[Array, "element 3 2 3"],
    thickness: Float[Array, " element"],
    section: Section,
    rule: PlaneRule = THREE_POINTS,
) -> Float[Array, "element 17 17"]:
    """Stiffness with the two rotations of the internal node still present, as the last two rows.

    Args: as in `element_stiffness`, and
        rule: In-plane points and weights. The published eigenvalues were found with seven points.
    """
    chunks = _chunks(corners, directors, tangents, thickness, section, rule)
    full = np.concatenate([_between(modes, _gram(rows)) for _, modes, rows in chunks])
    return 0.5 * (full + full.transpose(0, 2, 1))


def _chunks(
    corners: Array, directors: Array, tangents: Array, thickness: Array, section: Section, rule: PlaneRule
) -> Iterator[tuple[slice, Float[Array, "element 16 17"], PointRows]]:
    """R and Q of the elements, a cacheful at a time."""
    roots = section_roots(section)
    directions = section.directions
    if directions is not None:
        directions = np.broadcast_to(directions, (len(corners), 3))
    for start in range(0, len(corners), _CHUNK):
        part = slice(start, start + _CHUNK)
        geometry = geometry_of(corners[part], directors[part], tangents[part])
        frames = material_frames(geometry, None if directions is None else directions[part], rule, start)
        yield part, strain_modes(geometry), point_rows(frames, thickness[part], part_of(roots, part), start)


def _gram(rows: PointRows) -> Float[Array, "element 16 16"]:
    """Q^T Q."""
    gram = rows.in_plane @ rows.in_plane.transpose(0, 2, 1)
    gram[:, SHEAR_ROWS, SHEAR_ROWS] += rows.shear @ rows.shear.transpose(0, 2, 1)
    return gram


def _gram_slope(rows: PointRows, slopes: PointRows) -> Float[Array, "element 16 16"]:
    """Derivative of Q^T Q."""
    half = slopes.in_plane @ rows.in_plane.transpose(0, 2, 1)
    half[:, SHEAR_ROWS, SHEAR_ROWS] += slopes.shear @ rows.shear.transpose(0, 2, 1)
    return half + half.transpose(0, 2, 1)


def _between(
    modes: Float[Array, "element 16 17"], gram: Float[Array, "element 16 16"]
) -> Float[Array, "element 17 17"]:
    """R^T gram R."""
    return modes.transpose(0, 2, 1) @ (gram @ modes)


def _condense(
    full: Float[Array, "element 17 17"],
) -> tuple[Float[Array, "element 15 15"], Float[Array, "element 2 15"]]:
    """Static condensation of the internal node's rotations, and how they follow the corners, negated."""
    outer = full[:, :ELEMENT_DOFS, :ELEMENT_DOFS]
    mixed = full[:, ELEMENT_DOFS:, :ELEMENT_DOFS]
    a, b, c = full[:, -2, -2], full[:, -1, -2], full[:, -1, -1]
    inverse = np.stack([np.stack([c, -b], 1), np.stack([-b, a], 1)], 1) / (a * c - b * b)[:, None, None]
    held = inverse @ mixed
    reduced = outer - mixed.transpose(0, 2, 1) @ held
    return 0.5 * (reduced + reduced.transpose(0, 2, 1)), held


def _condensed_slope(
    slope: Float[Array, "element 17 17"], held: Float[Array, "element 2 15"]
) -> Float[Array, "element 15 15"]:
    """P^T K' P, with P the motion of all nodes per motion of the corners."""
    outer = slope[:, :ELEMENT_DOFS, :ELEMENT_DOFS]
    mixed = slope[:, ELEMENT_DOFS:, :ELEMENT_DOFS]
    inner = slope[:, ELEMENT_DOFS:, ELEMENT_DOFS:]
    half = 0.5 * outer - held.transpose(0, 2, 1) @ (mixed - 0.5 * inner @ held)
    return half + half.transpose(0, 2, 1)
