"""Elastic energy density of the skin's deformation (paper, Eq. 4)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

from hilbrace.errors import GeometryError

Array = np.ndarray
Lame = Literal["plane_stress", "plane_strain"]


def energy_density(
    deformation: Float[Array, "frame triangle 2 2"], poisson: float, lame: Lame = "plane_stress"
) -> Float[Array, "frame triangle"]:
    """Compressible neo-Hookean energy per area and thickness for unit modulus.

    ``mu/2 (tr G'G - 2) - mu log A + lambda/2 (log A)^2`` with ``A = det G`` (Bonet & Wood 2008). The paper
    prints the first Lame constant of a bulk, ``nu E / ((1 + nu)(1 - 2 nu))``, which grows without bound for
    rubber; a thin sheet is free to change its thickness and has ``nu E / (1 - nu^2)``. The sheet's is the
    default, the printed one is ``"plane_strain"``.

    Args:
        deformation: Deformation gradients between local frames of the triangles, rest to posed [-].
        poisson: Poisson's ratio [-].
        lame: Which first Lame constant.

    Returns:
        Energy density over Young's modulus [-].

    Raises:
        GeometryError: A triangle is flattened or turned over.
    """
    area = np.linalg.det(deformation)
    if not (area > 0).all():
        frame, triangle = np.argwhere(~(area > 0))[0]
        raise GeometryError(
            f"the skin turns over: relative area {area[frame, triangle]:.3g}",
            where=f"frame {frame}, triangle {triangle}",
            hint="choose another window of the motion or a region with fewer folds",
        )
    mu = 1.0 / (2.0 * (1.0 + poisson))
    first = (
        poisson / (1 - poisson**2)
        if lame == "plane_stress"
        else poisson / ((1 + poisson) * (1 - 2 * poisson))
    )
    invariant = (deformation**2).sum(axis=(-2, -1))
    log_area = np.log(area)
    return mu / 2 * (invariant - 2) - mu * log_area + first / 2 * log_area**2


def worst_energy_density(
    deformation: Float[Array, "frame triangle 2 2"], poisson: float, lame: Lame = "plane_stress"
) -> Float[Array, " triangle"]:
    """Largest energy density of each triangle over the motion, for unit modulus [-]; see `energy_density`."""
    return energy_density(deformation, poisson, lame).max(axis=0)
