"""What no microstructure can exceed: bounds on the stiffness of a sheet with holes.

All are relative to the Young's modulus E of the material, in plane stress, and hold for any arrangement of
material and void at volume fraction V; Poisson's ratio drops out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

Array = np.ndarray


def voigt(volume: Any) -> Any:
    """Largest Young's modulus in any direction, ``V``: parallel bars reach it along themselves."""
    return volume


def hashin_shtrikman(volume: Any) -> Any:
    """Largest Young's modulus of an isotropic sheet, ``V / (3 - 2 V)``.

    From the bounds on bulk and shear modulus of Hashin & Shtrikman (1963, J. Mech. Phys. Solids 11) and
    Hashin (1965, ibid. 13) in two dimensions with voids.
    """
    return volume / (3.0 - 2.0 * volume)


def isotropic_modulus(stiffness: Float[Array, "3 3"]) -> float:
    """Young's modulus that `hashin_shtrikman` bounds for any cell, isotropic or not [-].

    It is the harmonic mean over the directions. A sheet pieced together of the cell in all directions is
    isotropic, is at least that stiff, and has the same volume.
    """
    s = np.linalg.inv(stiffness)
    return float(8.0 / (3 * (s[0, 0] + s[1, 1]) + 2 * s[0, 1] + s[2, 2]))


def bound_margin(stiffness: Float[Array, "3 3"], volume: float, poisson: float, angles: int = 24) -> float:
    """How far a cell stays from the bound that holds for every stress; negative is impossible.

    Under any mean stress of principal values (s1, s2) the energy is at least that of the material plus
    ``(1 - V) / V (|s1| + |s2|)^2 / E`` (Allaire & Kohn 1993, Q. Appl. Math. 51); uniaxial stress gives the
    Voigt bound, equal stresses that of Hashin and Shtrikman on the bulk modulus.

    Args:
        stiffness: Effective stiffness, relative to E.
        volume: Volume fraction [-].
        poisson: Poisson's ratio of the material [-].
        angles: Directions of the principal axes, and ratios of the principal stresses, that are tried.

    Returns:
        Least relative distance of the energy from its bound [-].
    """
    compliance = np.linalg.inv(stiffness)
    solid = np.array([[1, -poisson, 0], [-poisson, 1, 0], [0, 0, 2 * (1 + poisson)]])
    ratio, turn = (
        grid.ravel()
        for grid in np.meshgrid(
            np.linspace(0, np.pi, 2 * angles + 1), np.linspace(0, np.pi / 2, angles + 1), indexing="ij"
        )
    )
    first, second = np.cos(ratio), np.sin(ratio)
    c, s = np.cos(turn), np.sin(turn)
    stress = np.stack([first * c**2 + second * s**2, first * s**2 + second * c**2, (first - second) * c * s])
    energy = np.einsum("is,ij,js->s", stress, compliance, stress)
    least = np.einsum("is,ij,js->s", stress, solid, stress)
    least = least + (1 - volume) / volume * (np.abs(first) + np.abs(second)) ** 2
    return float((energy / least).min() - 1.0)
