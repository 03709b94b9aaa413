"""The five losses of the paper's loss table, each a plain function of tensors.

``normalised`` divides each by its value at the start, as the paper does. Three of them need a word:

* L1. The frontal angle is a few degrees and a soft sleeve changes it by a per cent: ``L1 / L1_start`` would
  be one for every design. Where the brace acts by its stiffness, the controlled angles are therefore measured
  by the size of the change that the first (uniform) brace makes to them, the preserved ones by their own
  start; see `relative_stability`. Where it acts by its reactions, L1 stays the paper's: statics fixes what
  both loops hold together, a design merely shifts it from one to the other, and in units of the first brace's
  effect that shift has no bound and would outweigh every other loss.
* L4 and L5 are zero for a uniform field of the right volume. Their start value is not taken below that of
  a 5 % error (`TOLERANCE`).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

TOLERANCE = 0.05
"""Relative volume error, and jump of d across the seam, that count as one unit of loss [-]."""

SUPPORT_UNIT = 0.2
"""Share of the first brace's effect on the controlled angles that counts as one unit of loss [-]."""

PRESERVED_SHARE = 0.6
"""Weight of the preserved angles within L1; the controlled ones have the rest [-].

The paper adds squared angles, whose sizes differ by orders of magnitude here, and so leaves open what a
degree of lost flexion is worth in degrees of adduction. These two numbers settle it: on a recorded drop jump
and on the synthetic jump both sums improve, and the frontal stiffness stays above that of a uniform brace.
"""


@dataclass(frozen=True)
class Stability:
    """The two sums of L1.

    Attributes:
        preserved: Sum over the preserved angles of the squared change (mean over frames) [rad^2].
        prevented: Sum over the controlled angles of the squared angle with the brace on [rad^2].
        effect: Size of what the brace does to that second sum, whatever its sign [rad^2].
    """

    preserved: Float[Tensor, ""]
    prevented: Float[Tensor, ""]
    effect: Float[Tensor, ""]

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
    effect = (2.0 * (held * moved).abs() + moved**2).sum(1).mean()
    return Stability(preserved, prevented, effect)


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
    """L3: half the p-norm over the frames of the compliance (``energies`` are ``F.U / 2``), Eq. 2."""
    doubled = 2.0 * energies
    largest = doubled.max().detach()
    return 0.5 * largest * ((doubled / largest) ** exponent).sum() ** (1.0 / exponent)


def volume(
    fraction: Float[Tensor, " triangle"], areas: Float[Tensor, " triangle"], target: float
) -> Float[Tensor, ""]:
    """L4: squared relative error of the volume fraction."""
    return ((fraction * areas).sum() / areas.sum() / target - 1.0) ** 2


def seam(d_vertex: Float[Tensor, " vertex"], pairs: Int[Tensor, "pair 2"]) -> Float[Tensor, ""]:
    """L5: squared jumps of the design variable across the seam."""
    return ((d_vertex[pairs[:, 0]] - d_vertex[pairs[:, 1]]) ** 2).sum()


@dataclass(frozen=True)
class Scales:
    """What each loss is divided by: its value for the first field.

    Attributes:
        preserved: Start of L1's preserved sum [rad^2].
        prevented: Start of L1's controlled sum [rad^2].
        preserved_unit: Change of the preserved sum that counts as one unit of loss [rad^2].
        prevented_unit: Change of the controlled sum that counts as one [rad^2].
        elastic_energy: Start of L2.
        compliance: Start of L3.
        volume: Start of L4, not below its floor.
        seam: Start of L5, not below its floor.
    """

    preserved: float
    prevented: float
    preserved_unit: float
    prevented_unit: float
    elastic_energy: float
    compliance: float
    volume: float
    seam: float


def stability_units(stability: Stability, coupling: str) -> tuple[float, float]:
    """Changes of L1's preserved and controlled sum that count as one unit of loss [rad^2].

    Args:
        stability: L1's sums for the first field.
        coupling: ``"stiffness"`` or ``"paper"``, see `hilbrace.optimize.coupling`.
    """
    preserved, prevented, effect = map(float, (stability.preserved, stability.prevented, stability.effect))
    units = {
        "stiffness": (preserved / PRESERVED_SHARE, SUPPORT_UNIT * effect / (1.0 - PRESERVED_SHARE)),
        "paper": (preserved + prevented, preserved + prevented),
    }
    of_preserved, of_prevented = units[coupling]
    return max(of_preserved, 1e-30), max(of_prevented, 1e-30)


def scales(
    stability: Stability, terms: Float[Tensor, "5"], seam_pairs: int, coupling: str = "stiffness"
) -> Scales:
    """The scales of a run from the first field's losses.

    Args:
        stability: L1's sums for the first field.
        terms: L1..L5 of the first field.
        seam_pairs: Number of seam pairs.
        coupling: How the brace acts on the joint, see `stability_units`.
    """
    tiny = 1e-30
    preserved_unit, prevented_unit = stability_units(stability, coupling)
    return Scales(
        preserved=float(stability.preserved),
        prevented=float(stability.prevented),
        preserved_unit=preserved_unit,
        prevented_unit=prevented_unit,
        elastic_energy=max(float(terms[1]), tiny),
        compliance=max(float(terms[2]), tiny),
        volume=max(float(terms[3]), TOLERANCE**2),
        seam=max(float(terms[4]), seam_pairs * TOLERANCE**2, tiny),
    )


def relative_stability(stability: Stability, scale: Scales) -> Float[Tensor, ""]:
    """L1 in its units: one at the start, falling as the design improves.

    With the stiffness coupling the preserved part, of weight `PRESERVED_SHARE`, is divided by its start; the
    controlled part, which has the rest, falls by one when the brace takes off `SUPPORT_UNIT` of the first
    brace's effect more than the first brace did. With the paper's coupling this is ``L1 / L1_start``.
    """
    preserved = (stability.preserved - scale.preserved) / scale.preserved_unit
    prevented = (stability.prevented - scale.prevented) / scale.prevented_unit
    return 1.0 + preserved + prevented


def normalised(stability: Stability, terms: Float[Tensor, "5"], scale: Scales) -> Float[Tensor, "5"]:
    """L1..L5, each by its scale."""
    return torch.stack(
        [
            relative_stability(stability, scale),
            terms[1] / scale.elastic_energy,
            terms[2] / scale.compliance,
            terms[3] / scale.volume,
            terms[4] / scale.seam,
        ]
    )
