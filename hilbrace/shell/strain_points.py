"""What the integration points of an element see of its strain modes: Q of `hilbrace.shell.element`.

At a point the base vectors are ``g_r = a_r + z D_r``, ``g_s = a_s + z D_s`` and the interpolated director V,
along which no in-plane axis points. So the dual base in the plane comes from a 2 x 2 inverse, and transverse
shear enters the in-plane strain only where g_r and g_s lean towards the director. Elements run along the last
axis. Everything is a smooth function of the thickness, and takes a complex one for its derivative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Num

from hilbrace.errors import GeometryError
from hilbrace.shell.section import SectionRoots
from hilbrace.shell.strain_modes import BUBBLE_ROWS, MODES, SHEAR_ROWS, Geometry, bubble_slopes, cross

Array = np.ndarray

PlaneRule = tuple[Float[Array, "point 2"], Float[Array, " point"]]

_LAYERS = np.array([1.0, -1.0]) / np.sqrt(3.0)
"""Integration points through the thickness, in halves of it: upper, lower."""


@dataclass(frozen=True)
class PointRows:
    """Q transposed: rows of in-plane strain, and of transverse shear, which see the last three modes only."""

    in_plane: Num[Array, "element 16 row"]
    shear: Num[Array, "element 3 shear_row"]


@dataclass(frozen=True)
class Frames:
    """How the middle surface lies in the material axes at the in-plane points.

    Attributes:
        base: Base vectors along r and s, in the axes (material 1, material 2, director) [mm].
        spread: Their growth per length along the director [-].
        length: Length of the interpolated director [-].
        points: The points (r, s).
        weights: Their weights.
    """

    base: Float[Array, "2 point 3 element"]
    spread: Float[Array, "2 point 3 element"]
    length: Float[Array, "point element"]
    points: Float[Array, "point 2"]
    weights: Float[Array, " point"]


def material_frames(
    geometry: Geometry, directions: Float[Array, "element 3"] | None, rule: PlaneRule, first: int
) -> Frames:
    """Axes at each point: 3 along the director, 1 along the tangential part of the element's direction.

    Args:
        geometry: Shape of a chunk of elements.
        directions: Material axis 1 of each [any length]; the first edge if left out.
        rule: In-plane points and weights.
        first: Number of the chunk's first element, to name one in an error.

    Raises:
        GeometryError: A direction stands upright on the shell, or is none.
    """
    r, s = rule[0].T
    director = np.tensordot(np.stack([1.0 - r - s, r, s], axis=1), geometry.directors, axes=1)
    length = np.sqrt((director**2).sum(axis=1))
    director /= length[:, None]
    given = geometry.edges[0] if directions is None else directions.T
    along = given - (director * given).sum(axis=1)[:, None] * director
    size = np.sqrt((along**2).sum(axis=1))
    lost = np.flatnonzero(~(size > 1e-6 * np.sqrt((given**2).sum(axis=0))).all(axis=0))
    if lost.size:
        raise GeometryError(
            f"the material direction of {lost.size} triangles stands upright on the shell, or is none",
            where=f"triangle {first + lost[0]} of the shell",
            hint="give each triangle a direction along the surface",
        )
    along /= size[:, None]
    across = cross(director.transpose(1, 0, 2), along.transpose(1, 0, 2)).transpose(1, 0, 2)
    axes = np.stack([along, across, director], axis=1)
    base = np.einsum("vke,pake->vpae", geometry.edges, axes)
    spread = np.einsum("vke,pake->vpae", geometry.spreads, axes)
    return Frames(base, spread, length, *rule)


def point_rows(
    frames: Frames, thickness: Num[Array, " element"], roots: SectionRoots, first: int
) -> PointRows:
    """Strain rows of all integration points, times the root of weight and elasticity.

    Args:
        frames: How the middle surface lies at the in-plane points.
        thickness: Thickness of each element [mm].
        roots: Roots of the elements' sections, or of the one of all.
        first: Number of the chunk's first element, to name one in an error.

    Raises:
        GeometryError: An element folds over within its thickness, or its directors lean away from it.
    """
    half = 0.5 * thickness
    height = _LAYERS[:, None, None] * half
    (r1, r2, r3), (s1, s2, s3) = (
        [base[:, axis] + height * spread[:, axis] for axis in range(3)]
        for base, spread in zip(frames.base, frames.spread, strict=True)
    )
    stretch = r1 * s2 - r2 * s1
    _refuse_folds(np.real(stretch), first)
    # Components e_a . g^alpha of the dual base: a = 1, 2 down the rows, alpha = r, s along them.
    dual = np.stack([np.stack([s2, -r2]), np.stack([-s1, r1])]) / stretch
    lean = np.stack([r3, s3]) / frames.length
    weight = np.sqrt(frames.weights[:, None] * half * frames.length * stretch)
    strain = _to_cartesian(dual)
    rows = _in_plane(weight * _apply(roots.mean, strain), height, lean, frames.points)
    if roots.difference is not None:
        opposite = _apply(roots.difference, strain)[:, :, ::-1]
        rows += _in_plane(weight * opposite, height[::-1], lean[:, ::-1], frames.points)
    shear = _with_twist(weight / frames.length * _apply(roots.shear, dual), frames.points)
    return PointRows(_element_first(rows), _element_first(shear))


def _to_cartesian(dual: Num[Array, "2 2 layer point element"]) -> Num[Array, "3 3 layer point element"]:
    """Matrix from the covariant strains (rr, ss, 2rs) to (11, 22, 2*12)."""
    (r1, s1), (r2, s2) = dual
    return np.stack(
        [
            np.stack([r1 * r1, s1 * s1, r1 * s1]),
            np.stack([r2 * r2, s2 * s2, r2 * s2]),
            np.stack([2 * r1 * r2, 2 * s1 * s2, r1 * s2 + s1 * r2]),
        ]
    )


def _apply(
    root: Float[Array, "n n stiffness"], rows: Num[Array, "n m layer point element"]
) -> Num[Array, "n m layer point element"]:
    """Product of a section's root with rows of strain at every point."""
    total = root[:, 0, None, None, None] * rows[0]
    for k in range(1, len(rows)):
        total += root[:, k, None, None, None] * rows[k]
    return total


def _in_plane(
    matrix: Num[Array, "3 3 layer point element"],
    height: Num[Array, "layer 1 element"],
    lean: Num[Array, "2 layer point element"],
    points: Float[Array, "point 2"],
) -> Num[Array, "16 3 layer point element"]:
    """What ``matrix @ (e_rr, e_ss, 2 e_rs)`` at a height sees of each strain mode."""
    rr, ss, rs = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    by_r, by_s = (slope[:, None] for slope in bubble_slopes(points))
    rows = np.empty((len(MODES), *rr.shape), dtype=matrix.dtype)
    for at, component in zip((0, 3, 6), (rr, ss, rs), strict=True):
        rows[at] = component
        np.multiply(height, component, out=rows[at + 1])
        np.multiply(height, rows[at + 1], out=rows[at + 2])
    # The first power of z of each component is at hand: it is what the bubble's slopes weigh.
    z_rr, z_ss, z_rs = rows[1], rows[4], rows[7]
    bubble = rows[BUBBLE_ROWS]
    bubble[0] = by_r * z_rr + by_s * z_rs
    bubble[2] = by_s * z_ss + by_r * z_rs
    np.multiply(height, bubble[0::2], out=bubble[1::2])
    # Where the surface leans towards the director, transverse shear has a part in the plane.
    along_r, along_s = -(lean[0] * rr + lean[1] * rs), -(lean[1] * ss + lean[0] * rs)
    rows[SHEAR_ROWS] = _with_twist(np.stack([along_r, along_s], axis=1), points)
    return rows


def _with_twist(
    fields: Num[Array, "n 2 layer point element"], points: Float[Array, "point 2"]
) -> Num[Array, "3 n layer point element"]:
    """Coefficients of the assumed shear field (eqs. 15-17): constant along r, constant along s, twist."""
    r, s = points.T[:, :, None]
    along_r, along_s = fields[:, 0], fields[:, 1]
    return np.stack([along_r, along_s, along_r * (s - 1 / 3) + along_s * (1 / 3 - r)])


def _element_first(rows: Num[Array, "mode n layer point element"]) -> Num[Array, "element mode row"]:
    flat = rows.reshape(-1, rows.shape[-1])
    return np.ascontiguousarray(flat.T).reshape(rows.shape[-1], len(rows), -1)


def _refuse_folds(stretch: Float[Array, "layer point element"], first: int) -> None:
    folded = np.flatnonzero(~(stretch > 0).all(axis=(0, 1)))
    if folded.size:
        raise GeometryError(
            f"{folded.size} or more triangles fold over within the thickness of the wall",
            where=f"triangle {first + folded[0]} of the shell",
            hint="smooth the surface there, or take a wall thinner than its radius; both are in mm",
        )
