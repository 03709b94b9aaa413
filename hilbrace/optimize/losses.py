"""The five losses of the paper's loss table, each a plain function of tensors.

How they are measured and summed up is told in `hilbrace.optimize.objective`.
"""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Stability:
    """The two sums of L1.

    Attributes:
        preserved: Sum over the preserved angles of the squared change (mean over frames) [rad^2].
        prevented: Sum over the controlled angles of the squared angle with the brace on [rad^2].
        relieved: What the brace takes off that second sum: the unbraced sum less ``prevented`` [rad^2].
    """

    preserved: Float[Tensor, ""]
    prevented: Float[Tensor, ""]
    relieved: Float[Tensor, ""]

    @property
    def loss(self) -> Float[Tensor, ""]:
        """L1 of the loss table [rad^2]."""
        return self.preserved + self.prevented


def joint_stability(
    angles: Float[Tensor, "frame angle"],
    change: Float[Tensor, "frame angle"],
    preserve: tuple[int, ...],
    prevent: tuple[int, ...],
) -> Stability:
    """L1: keep the preserved angles, bring the controlled ones to zero.

    Args:
        angles: Recorded angles [rad].
        change: Change by the brace [rad].
        preserve: Columns of the angles to keep (sagittal).
        prevent: Columns of the angles to control (frontal).
    """
    preserved = (change[:, list(preserve)] ** 2).sum(1).mean()
    held, moved = angles[:, list(prevent)], change[:, list(prevent)]
    prevented = ((held + moved) ** 2).sum(1).mean()
    relieved = -(2.0 * held * moved + moved**2).sum(1).mean()
    return Stability(preserved, prevented, relieved)


def elastic_energy(
    modulus: Float[Tensor, " triangle"],
    unit_energy: Float[Tensor, " triangle"],
    areas: Float[Tensor, " triangle"],
) -> Float[Tensor, ""]:
    """L2: sum of the worst elastic energy densities over the elements.

    Both Lamé parameters are proportional to the modulus, so that ``W_e = f_E(d_e) w_e`` with ``w_e`` the
    energy for unit modulus. Elements are weighted by area over mean area, so that the sum does not depend
    on the mesh; on an even mesh it is the paper's.
    """
    return (modulus * unit_energy * areas).sum() / areas.mean()


def compliance(energies: Float[Tensor, " frame"], exponent: float) -> Float[Tensor, ""]:
    """L3: half the p-norm over the frames of the compliance (``energies`` are ``F.U / 2``), Eq. 2.

    Frames without load count nothing; if there are no others, the loss is zero.
    """
    doubled = 2.0 * energies
    largest = doubled.max().detach()
    if not largest > 0.0:
        return energies.sum()
    return 0.5 * largest * ((doubled / largest) ** exponent).sum() ** (1.0 / exponent)


def volume(
    fraction: Float[Tensor, " triangle"], areas: Float[Tensor, " triangle"], target: float
) -> Float[Tensor, ""]:
    """L4: squared relative error of the volume fraction."""
    return ((fraction * areas).sum() / areas.sum() / target - 1.0) ** 2


def seam(d_vertex: Float[Tensor, " vertex"], pairs: Int[Tensor, "pair 2"]) -> Float[Tensor, ""]:
    """L5: squared jumps of the design variable across the seam."""
    return ((d_vertex[pairs[:, 0]] - d_vertex[pairs[:, 1]]) ** 2).sum()
