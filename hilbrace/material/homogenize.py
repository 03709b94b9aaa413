"""Effective stiffness of a microstructure, from its mirrored unit cell.

Because every pattern is made of mirrored cells, the periodic cell problem splits into problems on one unit
cell: under normal strains the normal displacement is prescribed on all four sides, under shear the
tangential one is, and the rest is free of traction. That is exact, needs a fourth of the unknowns, and
leaves ``C16 = C26 = 0``. Square four-node elements in plane stress, one per pixel, modulus proportional to
the covered part of the pixel (numerical homogenization as in Andreassen & Andreasen 2014, Comput. Mater.
Sci. 83).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csc_array, csr_array
from scipy.sparse.linalg import splu

from hilbrace.material.cells import skeleton_distance

Array = np.ndarray

VOID = 1e-7
"""Relative modulus of an empty pixel; keeps the equations regular."""


def subpixel_distance(name: str, pixels: int, subpixels: int = 4) -> Float[Array, "row column"]:
    """Distance field of a cell at the centres of a grid, ``pixels * subpixels`` per side [cell sides]."""
    count = pixels * subpixels
    ticks = (np.arange(count) + 0.5) / count
    points = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)
    return skeleton_distance(name, points).reshape(count, count)


def coverage(
    distance: Float[Array, "row column"], width: float, pixels: int
) -> Float[Array, "pixel_row pixel_column"]:
    """Covered part of each pixel where ``distance <= width``; soft subpixels make it vary smoothly."""
    subpixels = len(distance) // pixels
    inside = np.clip(0.5 + (width - distance) * len(distance), 0.0, 1.0)
    return inside.reshape(pixels, subpixels, pixels, subpixels).mean(axis=(1, 3))


def homogenize(density: Float[Array, "row column"], poisson: float) -> Float[Array, "3 3"]:
    """Effective plane-stress stiffness of the mirrored cell for a base material of unit modulus.

    Args:
        density: Covered part of each pixel of the unit cell, in [0, 1].
        poisson: Poisson's ratio of the base material [-].

    Returns:
        Stiffness ``C`` with ``(s11, s22, s12) = C (e11, e22, 2 e12)``, relative to the base modulus.
    """
    n = len(density)
    modulus = (VOID + (1 - VOID) * density).ravel()
    stiffness = _assemble(modulus, n, _element_stiffness(poisson))
    ticks = np.arange(n + 1) / n
    x, y = (axis.ravel() for axis in np.meshgrid(ticks, ticks, indexing="ij"))
    sides_x, sides_y = np.flatnonzero((x == 0) | (x == 1)), np.flatnonzero((y == 0) | (y == 1))

    stretch = np.zeros((2 * len(x), 2))
    stretch[0::2, 0], stretch[1::2, 1] = x, y
    shear = np.zeros((2 * len(x), 1))
    shear[0::2, 0], shear[1::2, 0] = y / 2, x / 2

    effective = np.zeros((3, 3))
    effective[:2, :2] = _energy(stiffness, stretch, np.concatenate([2 * sides_x, 2 * sides_y + 1]))
    effective[2:, 2:] = _energy(stiffness, shear, np.concatenate([2 * sides_x + 1, 2 * sides_y]))
    return effective


def directional_modulus(
    stiffness: Float[Array, "3 3"], angle: Float[Array, " angle"]
) -> Float[Array, " angle"]:
    """Young's modulus under uniaxial stress along a direction [relative to the base material].

    Args:
        stiffness: Orthotropic plane-stress stiffness in its own axes.
        angle: Directions from the first axis [rad].
    """
    compliance = np.linalg.inv(stiffness)
    c, s = np.cos(angle), np.sin(angle)
    return 1.0 / (
        compliance[0, 0] * c**4
        + compliance[1, 1] * s**4
        + (2 * compliance[0, 1] + compliance[2, 2]) * (c * s) ** 2
    )


def mean_modulus(stiffness: Float[Array, "3 3"]) -> float:
    """Young's modulus averaged over all directions: the scalar that stands for the cell in the shell."""
    return float(directional_modulus(stiffness, np.arange(180) * np.pi / 180).mean())


def poisson_ratio(stiffness: Float[Array, "3 3"]) -> float:
    """Poisson's ratio under uniaxial stress along a direction, averaged over all directions [-].

    The mean ratio weighs the strains, not the quotients: mean strain across over mean strain along.
    """
    compliance = np.linalg.inv(stiffness)
    normal, mixed = compliance[0, 0] + compliance[1, 1], compliance[0, 1]
    along = 3 * normal + 2 * mixed + compliance[2, 2]
    across = normal + 6 * mixed - compliance[2, 2]
    return float(-across / along)


def with_poisson(
    stiffness: Float[Array, "*cell 3 3"], from_poisson: float, to_poisson: float
) -> Float[Array, "*cell 3 3"]:
    """Stiffness of the same perforated sheet made of a material of another Poisson's ratio.

    Where holes are empty, a change of the ratio at held Young's modulus adds to the effective compliance what
    it adds to the material's own (Cherkaev, Lurie & Milton 1992, Proc. R. Soc. Lond. A 438); Young's modulus
    of the sheet stays as it is in every direction.

    Args:
        stiffness: Effective plane-stress stiffness, relative to the material's Young's modulus.
        from_poisson: Ratio of the material that it was computed for [-].
        to_poisson: Ratio of the new material [-].
    """
    shift = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]) * (to_poisson - from_poisson)
    return np.linalg.inv(np.linalg.inv(stiffness) + shift)


def homogenize_shear(density: Float[Array, "row column"]) -> Float[Array, "2 2"]:
    """Effective transverse shear stiffness of a wall cut into mirrored cells, relative to a solid wall.

    The displacement normal to a wall of straight holes obeys Laplace's equation in its cross-section.

    Args:
        density: Covered part of each pixel of the unit cell, in [0, 1].
    """
    n = len(density)
    modulus = (VOID + (1 - VOID) * density).ravel()
    corner = np.array([[4, -1, -2, -1], [-1, 4, -1, -2], [-2, -1, 4, -1], [-1, -2, -1, 4]]) / 6
    nodes = _pixel_corners(n)
    rows, columns = np.repeat(nodes, 4, axis=1).ravel(), np.tile(nodes, (1, 4)).ravel()
    values = (modulus[:, None] * corner.ravel()).ravel()
    stiffness = coo_array((values, (rows, columns)), shape=((n + 1) ** 2,) * 2).tocsc()
    ticks = np.arange(n + 1) / n
    effective = np.zeros((2, 2))
    for k, axis in enumerate(np.meshgrid(ticks, ticks, indexing="ij")):
        place = axis.ravel()
        sides = np.flatnonzero((place == 0) | (place == 1))
        effective[k, k] = _energy(stiffness, place[:, None], sides)[0, 0]
    return effective


def _element_stiffness(poisson: float) -> Float[Array, "8 8"]:
    law = np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]]) / (1 - poisson**2)
    stiffness = np.zeros((8, 8))
    for a in (-1, 1) / np.sqrt(3):
        for b in (-1, 1) / np.sqrt(3):
            # derivatives in the unit square: twice those in [-1, 1]^2
            dx = np.array([-(1 - b), 1 - b, 1 + b, -(1 + b)]) / 2
            dy = np.array([-(1 - a), -(1 + a), 1 + a, 1 - a]) / 2
            strain = np.zeros((3, 8))
            strain[0, 0::2], strain[1, 1::2] = dx, dy
            strain[2, 0::2], strain[2, 1::2] = dy, dx
            stiffness += strain.T @ law @ strain / 4
    return stiffness


def _assemble(modulus: Float[Array, " pixel"], n: int, element: Float[Array, "8 8"]) -> csc_array:
    dofs = _pixel_dofs(n)
    rows = np.repeat(dofs, 8, axis=1).ravel()
    columns = np.tile(dofs, (1, 8)).ravel()
    values = (modulus[:, None] * element.ravel()).ravel()
    size = 2 * (n + 1) ** 2
    return coo_array((values, (rows, columns)), shape=(size, size)).tocsc()


def _pixel_dofs(n: int) -> Int[Array, "pixel 8"]:
    corners = _pixel_corners(n)
    return np.stack([2 * corners, 2 * corners + 1], axis=2).reshape(-1, 8)


def _pixel_corners(n: int) -> Int[Array, "pixel 4"]:
    i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    node = i * (n + 1) + j
    return np.stack([node, node + n + 1, node + n + 2, node + 1], axis=1)


def _energy(
    stiffness: csc_array, displacement: Float[Array, "dof case"], fixed: Int[Array, " fixed"]
) -> Array:
    """Twice the mixed elastic energies of the cases, each with its displacement prescribed at ``fixed``."""
    held = np.zeros(displacement.shape[0], dtype=bool)
    held[fixed] = True
    free, fixed = np.flatnonzero(~held), np.flatnonzero(held)
    rows = csr_array(stiffness)[free]
    factor = splu(
        rows[:, free].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    displacement = displacement.copy()
    displacement[free] = factor.solve(-(rows[:, fixed] @ displacement[fixed]))
    return displacement.T @ (stiffness @ displacement)
