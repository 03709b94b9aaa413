"""What the displacements of a MITC3+ element do to it: sixteen modes of strain.

The covariant strains of a shell with one director V per corner are polynomials of the distance z from the
middle surface and of the bubble's slopes b_r, b_s at the point (Lee, Lee & Bathe 2014, eqs. 6-8):

    e_rr = rr0 + z rr1 + z^2 rr2 + b_r z (rB0 + z rB1)          (alike for ss and, with both bubbles, 2rs)
    2 e_rt / (t/2) = constant_r + twist (3s - 1)/3,  2 e_st / (t/2) = constant_s + twist (1 - 3r)/3

The coefficients depend neither on the point nor on the thickness t. Elements run along the last axis here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray

NODE_DOFS = 5
ELEMENT_DOFS = 3 * NODE_DOFS
ALL_DOFS = ELEMENT_DOFS + 2
"""Corner degrees of freedom, and the two rotations of the internal node."""

MODES = (
    *("rr0", "rr1", "rr2", "ss0", "ss1", "ss2", "rs0", "rs1", "rs2"),
    *("rB0", "rB1", "sB0", "sB1"),
    *("constant_r", "constant_s", "twist"),
)
BUBBLE_ROWS = slice(9, 13)
SHEAR_ROWS = slice(13, 16)

_TYING_OFFSET = 1e-4
"""Distance d of the tying points D, E, F from the centre (eq. 17 and below)."""

_COMPONENTS = ((0, 0, 1), (1, 1, 2), (2, 0, 2), (2, 1, 1))
"""Component (rr, ss, 2rs), base vector (r, s) and the corner whose motion, less the first one's, it meets."""


@dataclass(frozen=True)
class Geometry:
    """Shape of a chunk of elements.

    Attributes:
        edges: Base vectors along r and s on the middle surface [mm].
        spreads: Their growth per length along the director [-]: differences of directors.
        directors: Directors of the corners.
        turns: Change of each node's director per rotation about its two axes; the internal node is last.
    """

    edges: Float[Array, "2 3 element"]
    spreads: Float[Array, "2 3 element"]
    directors: Float[Array, "3 3 element"]
    turns: Float[Array, "3 4 2 element"]


def geometry_of(
    corners: Float[Array, "element 3 3"],
    directors: Float[Array, "element 3 3"],
    tangents: Float[Array, "element 3 2 3"],
) -> Geometry:
    """Shape of elements from corner positions [mm], unit directors and their tangents [-]."""
    position = np.ascontiguousarray(corners.transpose(1, 2, 0))
    director = np.ascontiguousarray(directors.transpose(1, 2, 0))
    axes = np.ascontiguousarray(tangents.transpose(3, 1, 2, 0))
    edges = position[1:] - position[0]
    middle = director.mean(axis=0)
    first = cross(middle, edges[0])
    first /= np.sqrt((first**2).sum(axis=0))
    second = cross(middle, first)
    second /= np.sqrt((second**2).sum(axis=0))
    turns = np.empty((3, 4, 2, len(corners)))
    turns[:, :3] = cross(axes, director.transpose(1, 0, 2)[:, :, None])
    turns[:, 3, 0], turns[:, 3, 1] = cross(first, middle), cross(second, middle)
    return Geometry(edges, director[1:] - director[0], director, turns)


def strain_modes(geometry: Geometry) -> Float[Array, "element 16 17"]:
    """Matrix R from the degrees of freedom of each element to its sixteen modes of strain."""
    elements = geometry.edges.shape[-1]
    modes = np.zeros((len(MODES), ALL_DOFS, elements))
    corner = modes[:, :ELEMENT_DOFS].reshape(len(MODES), 3, NODE_DOFS, elements)
    vectors = np.stack([geometry.edges, geometry.spreads], axis=1)
    # Base vectors dotted with how each node's director turns: (base vector, power of z, node, axis).
    turning = np.einsum("apke,knxe->apnxe", vectors, geometry.turns)
    for component, along, node in _COMPONENTS:
        for power in range(2):
            row = 3 * component + power
            corner[row, node, :3] += vectors[along, power]
            corner[row, 0, :3] -= vectors[along, power]
            corner[row + 1, node, 3:] += turning[along, power, node]
            corner[row + 1, 0, 3:] -= turning[along, power, 0]
    bubble = turning.reshape(4, 4, 2, elements)
    corner[BUBBLE_ROWS, :, 3:] = bubble[:, :3] / -3.0
    modes[BUBBLE_ROWS, ELEMENT_DOFS:] = bubble[:, 3]
    _tie_shear(modes, corner, turning[:, 0], geometry.directors)
    return np.ascontiguousarray(modes.reshape(-1, elements).T).reshape(elements, len(MODES), ALL_DOFS)


def bubble_slopes(points: Float[Array, "point 2"]) -> tuple[Float[Array, " point"], Float[Array, " point"]]:
    """Slopes of the bubble 27 r s (1 - r - s) along r and s (eq. 8)."""
    r, s = points.T
    return 27.0 * s * (1.0 - 2.0 * r - s), 27.0 * r * (1.0 - r - 2.0 * s)


def cross(a: Float[Array, "3 *rest"], b: Float[Array, "3 *other"]) -> Float[Array, "3 *both"]:
    """Cross product along the first axis."""
    return np.stack([a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)])


def _corner_functions(r: float, s: float) -> Float[Array, "3"]:
    return np.array([1.0 - r - s, r, s])


def _rotation_functions(r: float, s: float) -> Float[Array, "4"]:
    """Functions f of the rotations with the cubic bubble (eq. 8)."""
    bubble = 27.0 * r * s * (1.0 - r - s)
    return np.append(_corner_functions(r, s) - bubble / 3.0, bubble)


def _tying(functions: Callable[[float, float], Array]) -> Float[Array, "2 3 node"]:
    """Weights of the shear rt, st at the tying points in the assumed shear field (eqs. 15-17)."""
    d = _TYING_OFFSET
    a, b, c = functions(1 / 6, 2 / 3), functions(2 / 3, 1 / 6), functions(1 / 6, 1 / 6)
    at_d, at_e = functions(1 / 3 + d, 1 / 3 - 2 * d), functions(1 / 3 - 2 * d, 1 / 3 + d)
    at_f = functions(1 / 3 + d, 1 / 3 + d)
    by_rt = [(2 * b + c) / 3, (c - a) / 3, at_f - at_d]
    by_st = [(c - b) / 3, (2 * a + c) / 3, at_e - at_f]
    return np.array([by_rt, by_st])


_TYING_MOVES = _tying(_corner_functions)
_TYING_TURNS = _tying(_rotation_functions)


def _tie_shear(
    modes: Float[Array, "16 17 element"],
    corner: Float[Array, "16 3 5 element"],
    turning: Float[Array, "2 4 2 element"],
    directors: Float[Array, "3 3 element"],
) -> None:
    """Fill the rows of the assumed transverse shear, per half of the thickness."""
    for along, node in ((0, 1), (1, 2)):
        director = np.tensordot(_TYING_MOVES[along], directors, axes=1)
        corner[SHEAR_ROWS, node, :3] += director
        corner[SHEAR_ROWS, 0, :3] -= director
        weighted = _TYING_TURNS[along][:, :, None, None] * turning[along]
        corner[SHEAR_ROWS, :, 3:] += weighted[:, :3]
        modes[SHEAR_ROWS, ELEMENT_DOFS:] += weighted[:, 3]
