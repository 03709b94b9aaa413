"""The MITC3+ triangular shell element, vectorised over elements.

Three corner nodes and one internal node that carries rotations only (a cubic bubble), condensed element by
element; assumed transverse shear strains. Lee, Lee & Bathe 2014, "The MITC3+ shell element and its
performance", Computers & Structures 138:12-23 (its equation numbers are quoted below). Plane stress, shear
correction factor 1, two integration points through the thickness and three in the plane.

Degrees of freedom of a corner: three translations along the global axes [mm] and two rotations about the
tangents of its director [rad]. The stiffness is that of unit modulus: multiply it by E [MPa].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray

NODE_DOFS = 5
ELEMENT_DOFS = 3 * NODE_DOFS
_ALL_DOFS = ELEMENT_DOFS + 2
_CHUNK = 1024
_TYING_OFFSET = 1e-4
"""Distance d of the tying points D, E, F from the centre (eq. 17 and below)."""

PlaneRule = tuple[Float[Array, "point 2"], Float[Array, " point"]]

THREE_POINTS: PlaneRule = (np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]]), np.full(3, 1 / 6))
"""In-plane rule that reproduces the published displacements."""

_THICKNESS_POINTS = (-1 / np.sqrt(3.0), 1 / np.sqrt(3.0))


@dataclass(frozen=True)
class _Geometry:
    """Corner positions and how the directors turn with the degrees of freedom, for a chunk of elements."""

    along_r: Float[Array, "element 3"]
    along_s: Float[Array, "element 3"]
    directors: Float[Array, "element 3 3"]
    turns: Float[Array, "element 4 3 17"]
    half: float


def element_stiffness(
    corners: Float[Array, "element 3 3"],
    directors: Float[Array, "element 3 3"],
    tangents: Float[Array, "element 3 2 3"],
    thickness: float,
    poisson: float,
) -> Float[Array, "element 15 15"]:
    """Stiffness of each element for unit modulus; times E [MPa] it is in N/mm, N and N*mm.

    Args:
        corners: Corner positions [mm].
        directors: Unit director at each corner [-].
        tangents: Two unit tangents of each director [-], the axes of the corner's rotations.
        thickness: Thickness of the shell [mm].
        poisson: Poisson's ratio [-].
    """
    out = np.empty((len(corners), ELEMENT_DOFS, ELEMENT_DOFS))
    for start in range(0, len(corners), _CHUNK):
        part = slice(start, start + _CHUNK)
        full = uncondensed_stiffness(corners[part], directors[part], tangents[part], thickness, poisson)
        out[part] = _condense(full)
    return out


def uncondensed_stiffness(
    corners: Float[Array, "element 3 3"],
    directors: Float[Array, "element 3 3"],
    tangents: Float[Array, "element 3 2 3"],
    thickness: float,
    poisson: float,
    rule: PlaneRule = THREE_POINTS,
) -> Float[Array, "element 17 17"]:
    """Stiffness with the two rotations of the internal node still present, as the last two rows.

    Args: as in `element_stiffness`, and
        rule: In-plane points and weights. The published eigenvalues were found with seven points.
    """
    geometry = _geometry(corners, directors, tangents, thickness)
    shear_tied = _tied_shear(geometry)
    elasticity = _plane_stress(poisson)
    stiffness = np.zeros((len(corners), _ALL_DOFS, _ALL_DOFS))
    for (r, s), weight in zip(*rule, strict=True):
        shear = shear_tied(r, s)
        for zeta in _THICKNESS_POINTS:
            strain, volume = _strain(geometry, shear, r, s, zeta)
            stress = elasticity @ strain
            stress *= (weight * volume)[:, None, None]
            stiffness += strain.transpose(0, 2, 1) @ stress
    return 0.5 * (stiffness + stiffness.transpose(0, 2, 1))


def _geometry(
    corners: Float[Array, "element 3 3"],
    directors: Float[Array, "element 3 3"],
    tangents: Float[Array, "element 3 2 3"],
    thickness: float,
) -> _Geometry:
    middle = directors.mean(axis=1)
    along_r = corners[:, 1] - corners[:, 0]
    first = np.cross(middle, along_r)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(middle, first)
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    turns = np.zeros((len(corners), 4, 3, _ALL_DOFS))
    for node in range(3):
        for axis in range(2):
            column = NODE_DOFS * node + 3 + axis
            turns[:, node, :, column] = np.cross(tangents[:, node, axis], directors[:, node])
    turns[:, 3, :, -2] = np.cross(first, middle)
    turns[:, 3, :, -1] = np.cross(second, middle)
    return _Geometry(along_r, corners[:, 2] - corners[:, 0], directors, turns, 0.5 * thickness)


def _corner_functions(r: float, s: float) -> Float[Array, " corner"]:
    return np.array([1.0 - r - s, r, s])


def _rotation_functions(r: float, s: float) -> Float[Array, " node"]:
    """Functions f of the rotations with the cubic bubble (eq. 8)."""
    bubble = 27.0 * r * s * (1.0 - r - s)
    return np.append(_corner_functions(r, s) - bubble / 3.0, bubble)


def _rotation_slopes(r: float, s: float) -> tuple[Float[Array, " node"], Float[Array, " node"]]:
    by_r = 27.0 * s * (1.0 - 2.0 * r - s)
    by_s = 27.0 * r * (1.0 - r - 2.0 * s)
    third = np.array([1.0, 1.0, 1.0, -3.0]) / 3.0
    return np.array([-1.0, 1.0, 0.0, 0.0]) - by_r * third, np.array([-1.0, 0.0, 1.0, 0.0]) - by_s * third


def _translation_slopes() -> tuple[Float[Array, "3 17"], Float[Array, "3 17"]]:
    """Derivatives of the mid-surface displacement along r and s: constant over the element."""
    by_r, by_s = np.zeros((2, 3, _ALL_DOFS))
    for slope, node in ((by_r, 1), (by_s, 2)):
        slope[:, :3] = -np.eye(3)
        slope[:, NODE_DOFS * node : NODE_DOFS * node + 3] = np.eye(3)
    return by_r, by_s


_SLOPE_R, _SLOPE_S = _translation_slopes()


def _dot(vector: Float[Array, "element 3"], matrix: Array) -> Float[Array, "element 17"]:
    return (vector[:, None, :] @ matrix)[:, 0]


def _blend(weights: Float[Array, " node"], fields: Array) -> Array:
    """Weighted sum over the node axis (the second)."""
    flat = fields.reshape(*fields.shape[:2], -1)
    return (weights @ flat).reshape(fields.shape[0], *fields.shape[2:])


def _covariant_shear(geometry: _Geometry, r: float, s: float) -> Float[Array, "2 element 17"]:
    """Rows 2 e_rt and 2 e_st of the displacement-based element on the mid-surface."""
    normal = geometry.half * _blend(_corner_functions(r, s), geometry.directors)
    turn = geometry.half * _blend(_rotation_functions(r, s), geometry.turns)
    return np.stack(
        [
            _dot(geometry.along_r, turn) + normal @ _SLOPE_R,
            _dot(geometry.along_s, turn) + normal @ _SLOPE_S,
        ]
    )


def _tied_shear(geometry: _Geometry) -> Callable[[float, float], Float[Array, "2 element 17"]]:
    """Assumed transverse shear field (eqs. 15-17) as a function of (r, s)."""
    d = _TYING_OFFSET
    at_a = _covariant_shear(geometry, 1 / 6, 2 / 3)
    at_b = _covariant_shear(geometry, 2 / 3, 1 / 6)
    at_c = _covariant_shear(geometry, 1 / 6, 1 / 6)
    at_d = _covariant_shear(geometry, 1 / 3 + d, 1 / 3 - 2 * d)
    at_e = _covariant_shear(geometry, 1 / 3 - 2 * d, 1 / 3 + d)
    at_f = _covariant_shear(geometry, 1 / 3 + d, 1 / 3 + d)
    common = (at_c[0] + at_c[1]) / 3.0
    constant_r = (2.0 * at_b[0] - at_b[1]) / 3.0 + common
    constant_s = (2.0 * at_a[1] - at_a[0]) / 3.0 + common
    twist = (at_f[0] - at_d[0]) - (at_f[1] - at_e[1])

    def shear(r: float, s: float) -> Float[Array, "2 element 17"]:
        return np.stack([constant_r + twist * (3 * s - 1) / 3, constant_s + twist * (1 - 3 * r) / 3])

    return shear


def _strain(
    geometry: _Geometry, shear: Float[Array, "2 element 17"], r: float, s: float, zeta: float
) -> tuple[Float[Array, "element 5 17"], Float[Array, " element"]]:
    """Local Cartesian strain rows (11, 22, 2*12, 2*13, 2*23) and the volume element at one point."""
    reach = zeta * geometry.half
    directors = geometry.directors
    base_r = geometry.along_r + reach * (directors[:, 1] - directors[:, 0])
    base_s = geometry.along_s + reach * (directors[:, 2] - directors[:, 0])
    base_t = geometry.half * _blend(_corner_functions(r, s), directors)
    slope_r, slope_s = _rotation_slopes(r, s)
    move_r = _SLOPE_R + reach * _blend(slope_r, geometry.turns)
    move_s = _SLOPE_S + reach * _blend(slope_s, geometry.turns)
    covariant = np.stack(
        [
            _dot(base_r, move_r),
            _dot(base_s, move_s),
            _dot(base_r, move_s) + _dot(base_s, move_r),
            shear[0],
            shear[1],
        ],
        axis=1,
    )
    base = np.stack([base_r, base_s, base_t], axis=1)
    return _to_cartesian(base) @ covariant, np.abs(np.linalg.det(base))


def _to_cartesian(base: Float[Array, "element 3 3"]) -> Float[Array, "element 5 5"]:
    """Matrix from covariant strains (rr, ss, 2rs, 2rt, 2st) to Cartesian ones, axis 3 along the director."""
    axis3 = base[:, 2] / np.linalg.norm(base[:, 2], axis=1, keepdims=True)
    axis1 = np.cross(base[:, 1], axis3)
    axis1 /= np.linalg.norm(axis1, axis=1, keepdims=True)
    axes = np.stack([axis1, np.cross(axis3, axis1), axis3], axis=1)
    direction = axes @ np.linalg.inv(base)
    r, s, t = direction[:, :, 0], direction[:, :, 1], direction[:, :, 2]
    matrix = np.empty((len(base), 5, 5))
    for row, (p, q) in enumerate(((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))):
        factor = 1.0 if p == q else 2.0
        matrix[:, row, 0] = factor * r[:, p] * r[:, q]
        matrix[:, row, 1] = factor * s[:, p] * s[:, q]
        matrix[:, row, 2] = 0.5 * factor * (r[:, p] * s[:, q] + s[:, p] * r[:, q])
        matrix[:, row, 3] = 0.5 * factor * (r[:, p] * t[:, q] + t[:, p] * r[:, q])
        matrix[:, row, 4] = 0.5 * factor * (s[:, p] * t[:, q] + t[:, p] * s[:, q])
    return matrix


def _plane_stress(poisson: float) -> Float[Array, "5 5"]:
    """Plane-stress elasticity with transverse shear for unit modulus, shear correction factor 1."""
    shear = 0.5 / (1.0 + poisson)
    matrix = np.diag([1.0, 1.0, 0.5 * (1.0 - poisson), 0.0, 0.0])
    matrix[0, 1] = matrix[1, 0] = poisson
    matrix /= 1.0 - poisson**2
    matrix[3, 3] = matrix[4, 4] = shear
    return matrix


def _condense(full: Float[Array, "element 17 17"]) -> Float[Array, "element 15 15"]:
    """Static condensation of the internal node's two rotations."""
    outer = full[:, :ELEMENT_DOFS, :ELEMENT_DOFS]
    mixed = full[:, :ELEMENT_DOFS, ELEMENT_DOFS:]
    inner = full[:, ELEMENT_DOFS:, ELEMENT_DOFS:]
    reduced = outer - mixed @ np.linalg.solve(inner, mixed.transpose(0, 2, 1))
    return 0.5 * (reduced + reduced.transpose(0, 2, 1))
