"""Stiffness of a wall of finite thickness that is cut into cells: stretching, bending and twist.

A lattice does not bend like a solid of its stretching stiffness: struts that fold in their plane under
stretch must bend and twist out of it under curvature. So the wall is solved as the body that it is:
one mirrored unit cell, the upper half of its thickness, brick elements of the pixels' modulus. Under stretch
and bending the cell's sides stay plane and the displacement along them is free; under shear and twist the
displacement along them is prescribed and the one across is free. Both follow from the mirror symmetry and are
exact. At the middle plane the displacement is in the plane under stretch, normal to it under bending.

Elements: eight nodes with the nine incompatible modes of Taylor, Beresford & Wilson (1976, Int. J. Numer.
Methods Eng. 10), which bend and twist without locking.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu

Array = np.ndarray

LEAST_DENSITY = 1e-3
"""Pixels covered less than this are left out."""


@dataclass(frozen=True)
class WallCell:
    """Stiffness of a cellular wall relative to a solid one of unit modulus.

    Attributes:
        membrane: A / (E t), with ``(n11, n22, n12) = A (e11, e22, 2 e12)`` [-].
        bending: 12 D / (E t^3), with ``(m11, m22, m12) = D (k11, k22, 2 k12)`` [-].
    """

    membrane: Float[Array, "3 3"]
    bending: Float[Array, "3 3"]


def homogenize_wall(
    density: Float[Array, "row column"], poisson: float, thickness: float, layers: int = 3
) -> WallCell:
    """Effective stiffness of a wall cut into mirrored cells.

    Args:
        density: Covered part of each pixel of the unit cell, in [0, 1].
        poisson: Poisson's ratio of the base material [-].
        thickness: Thickness of the wall [cell sides].
        layers: Elements through half of the thickness; they get thinner towards the surface.
    """
    n = len(density)
    levels = 0.5 * thickness * np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, layers + 1))
    stiffness, points = _assemble(density, poisson, levels)
    x, y, z = points
    side_x, side_y = (np.isin(axis, (0.0, float(n))) for axis in (x, y))
    x, y, middle = x / n, y / n, z == 0.0
    zero = np.zeros_like(x)
    pinned = np.zeros_like(middle)
    pinned[0] = True

    sides = side_x | side_y
    stretch = _energy(stiffness, _held(side_x, side_y, middle), [(x, zero, zero), (zero, y, zero)])
    shear = _energy(stiffness, _held(side_y, side_x, middle | sides), [(y / 2, x / 2, zero)])
    bend = _energy(
        stiffness,
        _held(side_x | middle, side_y | middle, pinned),
        [(-x * z, zero, zero), (zero, -y * z, zero)],
    )
    twist = _energy(
        stiffness,
        _held(side_y | middle, side_x | middle, sides),
        [(-y * z / 2, -x * z / 2, x * y / 2)],
    )
    half = 2.0 / thickness
    return WallCell(half * _block(stretch, shear), half * 12.0 / thickness**2 * _block(bend, twist))


def _held(u: Bool[Array, " node"], v: Bool[Array, " node"], w: Bool[Array, " node"]) -> Bool[Array, " dof"]:
    return np.stack([u, v, w], axis=1).ravel()


def _block(normal: Float[Array, "2 2"], shear: Float[Array, "1 1"]) -> Float[Array, "3 3"]:
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[2:, 2:] = normal, shear
    return whole


def _energy(
    stiffness: sp.csr_array, held: Bool[Array, " dof"], cases: list[tuple[Array, Array, Array]]
) -> Float[Array, "case case"]:
    """Twice the mixed energies of the cases, each with its displacement prescribed where ``held``."""
    displacement = np.stack([np.stack(case, axis=1).ravel() for case in cases], axis=1)
    free, fixed = np.flatnonzero(~held), np.flatnonzero(held)
    rows = stiffness[free]
    factor = splu(
        rows[:, free].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    displacement[free] = factor.solve(-(rows[:, fixed] @ displacement[fixed]))
    return displacement.T @ (stiffness @ displacement)


def _assemble(
    density: Float[Array, "row column"], poisson: float, levels: Float[Array, " level"]
) -> tuple[sp.csr_array, Float[Array, "3 node"]]:
    """Stiffness of the covered bricks, and their nodes: pixel row and column, height [cell sides]."""
    n, layers = len(density), len(levels) - 1
    i, j = np.nonzero(density > LEAST_DENSITY)
    numbers = np.arange((n + 1) ** 2 * (layers + 1)).reshape(n + 1, n + 1, layers + 1)
    dofs, values = [], []
    for k in range(layers):
        corners = [numbers[i + a, j + b, k + c] for c in (0, 1) for b in (0, 1) for a in (0, 1)]
        dofs.append(np.stack(corners, axis=1))
        brick = _brick(poisson, np.array([1 / n, 1 / n, levels[k + 1] - levels[k]]))
        values.append(density[i, j][:, None] * brick.ravel())
    used, nodes = np.unique(np.concatenate(dofs), return_inverse=True)
    dof: Int[Array, "brick 24"] = (3 * nodes.reshape(-1, 8)[:, :, None] + np.arange(3)).reshape(-1, 24)
    rows, columns = np.repeat(dof, 24, axis=1).ravel(), np.tile(dof, (1, 24)).ravel()
    size = 3 * len(used)
    stiffness = sp.coo_array((np.concatenate(values).ravel(), (rows, columns)), shape=(size, size)).tocsr()
    row, column, level = np.unravel_index(used, numbers.shape)
    return stiffness, np.stack([row.astype(float), column.astype(float), levels[level]])


def _brick(poisson: float, sides: Float[Array, "3"]) -> Float[Array, "24 24"]:
    """Stiffness of a brick of unit modulus with its incompatible modes condensed."""
    shear = 0.5 / (1 + poisson)
    law = np.zeros((6, 6))
    law[:3, :3] = poisson / ((1 + poisson) * (1 - 2 * poisson))
    law[range(6), range(6)] += [2 * shear] * 3 + [shear] * 3
    signs = np.array([(a, b, c) for c in (-1, 1) for b in (-1, 1) for a in (-1, 1)], dtype=float)
    total = np.zeros((33, 33))
    for point in signs / np.sqrt(3):
        shape = (1 + signs * point) / 2
        slopes = np.stack(
            [signs[:, k] / sides[k] * shape[:, (k + 1) % 3] * shape[:, (k + 2) % 3] for k in range(3)]
        )
        modes = np.diag(-4 * point / sides)
        strain = np.concatenate([_strain(slopes), _strain(modes)], axis=1)
        total += strain.T @ law @ strain * sides.prod() / 8
    nodal, mixed, inner = total[:24, :24], total[:24, 24:], total[24:, 24:]
    return nodal - mixed @ np.linalg.solve(inner, mixed.T)


def _strain(slopes: Float[Array, "3 function"]) -> Float[Array, "6 component"]:
    """Strains (11, 22, 33, 23, 13, 12) of displacements (u, v, w) times each function, from its slopes."""
    strain = np.zeros((6, slopes.shape[1], 3))
    for k in range(3):
        strain[k, :, k] = slopes[k]
    for row, (a, b) in zip((3, 4, 5), ((1, 2), (0, 2), (0, 1)), strict=True):
        strain[row, :, a], strain[row, :, b] = slopes[b], slopes[a]
    return strain.reshape(6, -1)
