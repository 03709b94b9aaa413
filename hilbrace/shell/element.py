"""The MITC3+ triangular shell element, vectorised over elements.

Three corner nodes and one internal node that carries rotations only (a cubic bubble), condensed element by
element; assumed transverse shear strains. Lee, Lee & Bathe 2014, "The MITC3+ shell element and its
performance", Computers & Structures 138:12-23 (its equation numbers are quoted below). Plane stress, shear
correction factor 1, two integration points through the thickness and three in the plane.

Degrees of freedom of a corner: three translations along the global axes [mm] and two rotations about the
tangents of its director [rad]. The stiffness is that of unit modulus: multiply it by E [MPa].

The strain at an integration point is ``Q R d``. R, 16 rows (`hilbrace.shell.strain_modes`), holds what the
displacements d of the element do, wherever one looks; Q holds what a point at the distance z from the middle
surface sees of it, in Cartesian axes along its material, times the root of its weight and elasticity. So
``K = R^T (Q^T Q) R``, and only Q knows the thickness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Num

from hilbrace.errors import GeometryError
from hilbrace.shell.section import Section, SectionRoots, section_roots
from hilbrace.shell.strain_modes import (
    BUBBLE_ROWS,
    ELEMENT_DOFS,
    MODES,
    NODE_DOFS,
    SHEAR_ROWS,
    Geometry,
    bubble_slopes,
    geometry_of,
    strain_modes,
)

__all__ = [
    "ELEMENT_DOFS",
    "NODE_DOFS",
    "THREE_POINTS",
    "element_stiffness",
    "element_stiffness_and_slope",
    "uncondensed_stiffness",
]

Array = np.ndarray

PlaneRule = tuple[Float[Array, "point 2"], Float[Array, " point"]]

THREE_POINTS: PlaneRule = (np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]]), np.full(3, 1 / 6))
"""In-plane rule that reproduces the published displacements."""

_LAYERS = np.array([1.0, -1.0]) / np.sqrt(3.0)
"""Integration points through the thickness, in halves of it: upper, lower."""

_CHUNK = 256
"""Elements at a time: what one of them needs, some 2 k numbers, stays in the cache."""

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
        GeometryError: A director leans away from its triangle, the wall is thicker than its bend allows, or
            a section is not positive definite.
    """
    roots = section_roots(section)
    out = np.empty((len(corners), ELEMENT_DOFS, ELEMENT_DOFS))
    for part in _chunks(len(corners)):
        geometry = geometry_of(corners[part], directors[part], tangents[part])
        modes = strain_modes(geometry)
        rows = _rows_of(geometry, thickness[part], section, roots, part, THREE_POINTS)
        full = modes.transpose(0, 2, 1) @ (_gram(rows) @ modes)
        out[part], _ = _condense(full)
    return out


def element_stiffness_and_slope(
    corners: Float[Array, "element 3 3"],
    directors: Float[Array, "element 3 3"],
    tangents: Float[Array, "element 3 2 3"],
    thickness: Float[Array, " element"],
    section: Section,
) -> tuple[Float[Array, "element 15 15"], Float[Array, "element 15 15"]]:
    """Stiffness of each element and its derivative by the element's own thickness, both for unit modulus.

    The derivative is exact: a complex step through the integration points, and the chain rule through the
    condensation. Modulus and section are held.

    Args: as in `element_stiffness`.

    Raises:
        GeometryError: As in `element_stiffness`.
    """
    roots = section_roots(section)
    out = np.empty((2, len(corners), ELEMENT_DOFS, ELEMENT_DOFS))
    for part in _chunks(len(corners)):
        geometry = geometry_of(corners[part], directors[part], tangents[part])
        modes = strain_modes(geometry)
        step = _COMPLEX_STEP * thickness[part]
        rows = _rows_of(geometry, thickness[part] + 1j * step, section, roots, part, THREE_POINTS)
        gram, gram_slope = _gram_and_slope(rows, step)
        full = modes.transpose(0, 2, 1) @ (gram @ modes)
        full_slope = modes.transpose(0, 2, 1) @ (gram_slope @ modes)
        out[0, part], held = _condense(full)
        out[1, part] = _condensed_slope(full_slope, held)
    return out[0], out[1]


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
    geometry = geometry_of(corners, directors, tangents)
    modes = strain_modes(geometry)
    everything = slice(0, len(corners))
    rows = _rows_of(geometry, thickness, section, section_roots(section), everything, rule)
    full = modes.transpose(0, 2, 1) @ (_gram(rows) @ modes)
    return 0.5 * (full + full.transpose(0, 2, 1))


def _chunks(elements: int) -> list[slice]:
    return [slice(start, min(start + _CHUNK, elements)) for start in range(0, elements, _CHUNK)]


@dataclass(frozen=True)
class _Frames:
    """How the surface lies in the material axes at the in-plane points; elements along the last axis."""

    middle: Float[Array, "along point axis element"]
    """Base vectors along r and s on the middle surface, in the axes (material 1, 2, director)."""
    spread: Float[Array, "along point axis element"]
    """Their growth per mm along the director."""
    length: Float[Array, "point element"]
    """Length of the interpolated director."""


@dataclass(frozen=True)
class _Rows:
    """Q transposed, its in-plane strains and its transverse shear strains, which see the last modes only."""

    in_plane: Num[Array, "element 16 row"]
    shear: Num[Array, "element 3 shear_row"]


def _rows_of(
    geometry: Geometry,
    thickness: Num[Array, " element"],
    section: Section,
    roots: SectionRoots,
    part: slice,
    rule: PlaneRule,
) -> _Rows:
    """Q of the in-plane and of the transverse shear strains, transposed, for a chunk of elements."""
    chosen = SectionRoots(*(_pick(root, part) for root in (roots.mean, roots.difference, roots.shear)))
    if section.directions is None:
        direction = geometry.edges[0]
    else:
        given = section.directions
        direction = given[part].T if len(given) > 1 else np.repeat(given.T, len(thickness), axis=1)
    frames = _frames(geometry, direction, rule[0], part.start)
    return _weighted_rows(frames, 0.5 * thickness, chosen, rule, part.start)


def _pick(root: Float[Array, "row column stiffness"], part: slice) -> Float[Array, "row column chosen"]:
    return root[..., part] if root.shape[-1] > 1 else root


def _frames(
    geometry: Geometry, direction: Float[Array, "3 element"], points: Float[Array, "point 2"], first: int
) -> _Frames:
    """Axes at each in-plane point: 3 along the director, 1 along the tangential part of the direction."""
    r, s = points.T
    corner = np.stack([1.0 - r - s, r, s], axis=1)
    director = np.tensordot(corner, geometry.directors, axes=1)
    length = np.sqrt((director**2).sum(axis=1))
    axis3 = director / length[:, None]
    axis1 = direction - (axis3 * direction).sum(axis=1)[:, None] * axis3
    size = np.sqrt((axis1**2).sum(axis=1))
    lost = ~(size > 1e-6 * np.sqrt((direction**2).sum(axis=0))).all(axis=0)
    if lost.any():
        raise GeometryError(
            f"the material direction of {int(lost.sum())} triangles stands upright on the shell, or is zero",
            where=f"triangle {first + int(np.flatnonzero(lost)[0])} of the shell",
            hint="give a direction that lies along the surface",
        )
    axis1 /= size[:, None]
    axis2 = np.stack(
        [axis3[:, k - 2] * axis1[:, k - 1] - axis3[:, k - 1] * axis1[:, k - 2] for k in range(3)], 1
    )
    axes = np.stack([axis1, axis2, axis3], axis=1)

    def seen(vectors: Float[Array, "along xyz element"]) -> Float[Array, "along point axis element"]:
        return sum(vectors[:, None, None, k] * axes[None, :, :, k] for k in range(3))  # pyright: ignore[reportReturnType]

    return _Frames(seen(geometry.edges), seen(geometry.spreads), length)


def _weighted_rows(
    frames: _Frames,
    half: Num[Array, " element"],
    roots: SectionRoots,
    rule: PlaneRule,
    first: int,
) -> _Rows:
    points, weights = rule
    height = _LAYERS[:, None] * half
    base = frames.middle[:, None] + height[:, None, None] * frames.spread[:, None]
    (r1, r2, r3), (s1, s2, s3) = (np.moveaxis(one, 2, 0) for one in base)
    stretch = r1 * s2 - r2 * s1
    if not (np.real(stretch) > 0).all():
        _refuse_folded(np.real(stretch), first)
    root_weight = np.sqrt(weights[:, None] * half * frames.length * stretch)
    # Components e_a . g^alpha of the dual base: a = 1, 2 along the first axis, alpha = r, s along the second.
    dual = np.stack([np.stack([s2, -r2]), np.stack([-s1, r1])]) / stretch
    tilt = np.stack([r3, s3]) / frames.length
    mean, difference = roots.mean[:, :, None, None], roots.difference[:, :, None, None]
    to_strain = _to_cartesian(dual)
    own = _apply(mean, to_strain)
    other = _apply(difference, to_strain)[:, :, ::-1]
    rows = _in_plane_rows(own, height, tilt, points) + _in_plane_rows(
        other, height[::-1], tilt[:, ::-1], points
    )
    rows *= root_weight
    shear = np.stack([dual[0] / frames.length, dual[1] / frames.length])
    shear_rows = _with_twist(_apply(roots.shear[:, :, None, None], shear) * root_weight, points)
    return _Rows(_element_first(rows), _element_first(shear_rows))


def _apply(
    matrix: Array, fields: Num[Array, "inner column layer point element"]
) -> Num[Array, "outer column layer point element"]:
    return sum(matrix[:, k, None] * fields[k] for k in range(matrix.shape[1]))  # pyright: ignore[reportReturnType]


def _to_cartesian(
    dual: Num[Array, "2 2 layer point element"],
) -> Num[Array, "3 3 layer point element"]:
    """Matrix from the covariant strains (rr, ss, 2rs) to (11, 22, 2*12)."""
    (r1, s1), (r2, s2) = dual
    return np.stack(
        [
            np.stack([r1 * r1, s1 * s1, r1 * s1]),
            np.stack([r2 * r2, s2 * s2, r2 * s2]),
            np.stack([2 * r1 * r2, 2 * s1 * s2, r1 * s2 + s1 * r2]),
        ]
    )


def _in_plane_rows(
    matrix: Num[Array, "3 3 layer point element"],
    height: Num[Array, "layer element"],
    tilt: Num[Array, "2 layer point element"],
    points: Float[Array, "point 2"],
) -> Num[Array, "mode 3 layer point element"]:
    """What the strain ``matrix @ covariant`` at a height sees of each strain mode."""
    z = height[:, None]
    by_r, by_s = (slope[:, None] for slope in bubble_slopes(points))
    rows = np.empty((len(MODES), *matrix[0].shape), dtype=matrix.dtype)
    for component in range(3):
        at = 3 * component
        rows[at] = matrix[:, component]
        rows[at + 1] = z * rows[at]
        rows[at + 2] = z * rows[at + 1]
    rr, ss, rs = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    bubble = rows[BUBBLE_ROWS]
    bubble[0] = z * (by_r * rr + by_s * rs)
    bubble[1] = z * bubble[0]
    bubble[2] = z * (by_s * ss + by_r * rs)
    bubble[3] = z * bubble[2]
    # Where the director leans over the surface, transverse shear has a part in the plane.
    lean = np.stack([-(tilt[0] * rr + tilt[1] * rs), -(tilt[1] * ss + tilt[0] * rs)], axis=1)
    rows[SHEAR_ROWS] = _with_twist(lean, points)
    return rows


def _with_twist(
    fields: Num[Array, "row 2 layer point element"], points: Float[Array, "point 2"]
) -> Num[Array, "3 row layer point element"]:
    """Coefficients of the assumed shear field (eqs. 15-17): constant along r, constant along s, twist."""
    r, s = points.T[:, :, None]
    along_r, along_s = fields[:, 0], fields[:, 1]
    return np.stack([along_r, along_s, along_r * (3 * s - 1) / 3 + along_s * (1 - 3 * r) / 3])


def _element_first(rows: Num[Array, "mode row layer point element"]) -> Num[Array, "element mode all_rows"]:
    flat = rows.reshape(-1, rows.shape[-1])
    return np.ascontiguousarray(flat.T).reshape(rows.shape[-1], len(rows), -1)


def _gram(rows: _Rows) -> Float[Array, "element 16 16"]:
    """Q^T Q."""
    gram = rows.in_plane @ rows.in_plane.transpose(0, 2, 1)
    gram[:, SHEAR_ROWS, SHEAR_ROWS] += rows.shear @ rows.shear.transpose(0, 2, 1)
    return gram


def _gram_and_slope(
    rows: _Rows, step: Float[Array, " element"]
) -> tuple[Float[Array, "element 16 16"], Float[Array, "element 16 16"]]:
    """Q^T Q and its derivative, from rows at a thickness with an imaginary step."""
    value = _Rows(np.ascontiguousarray(np.real(rows.in_plane)), np.ascontiguousarray(np.real(rows.shear)))
    half = (np.imag(rows.in_plane) / step[:, None, None]) @ value.in_plane.transpose(0, 2, 1)
    half[:, SHEAR_ROWS, SHEAR_ROWS] += (np.imag(rows.shear) / step[:, None, None]) @ value.shear.transpose(
        0, 2, 1
    )
    return _gram(value), half + half.transpose(0, 2, 1)


def _condense(
    full: Float[Array, "element 17 17"],
) -> tuple[Float[Array, "element 15 15"], Float[Array, "element 2 15"]]:
    """Static condensation of the internal node's rotations; and how they follow the corners, negated."""
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
    """P^T K' P with P the motion of all nodes per motion of the corners."""
    outer = slope[:, :ELEMENT_DOFS, :ELEMENT_DOFS]
    mixed = slope[:, ELEMENT_DOFS:, :ELEMENT_DOFS]
    inner = slope[:, ELEMENT_DOFS:, ELEMENT_DOFS:]
    half = 0.5 * outer - held.transpose(0, 2, 1) @ (mixed - 0.5 * inner @ held)
    return half + half.transpose(0, 2, 1)


def _refuse_folded(stretch: Float[Array, "layer point element"], first: int) -> None:
    wrong = np.flatnonzero(~(stretch > 0).all(axis=(0, 1)))
    raise GeometryError(
        f"{wrong.size} or more triangles fold over within the thickness of the wall",
        where=f"triangle {first + int(wrong[0])} of the shell",
        hint="smooth the surface there, or take a wall thinner than its radius of curvature",
    )
