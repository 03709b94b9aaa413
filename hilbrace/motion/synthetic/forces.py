"""The whole body's ground reaction divided between the feet.

The right foot's share follows from where the centre of pressure lies between the feet; in walking it is
kept to narrow limits. Forces of both feet, at their centres of pressure, with their free moments, add up to
the whole reaction exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.motion.synthetic.plan import Plan
from hilbrace.motion.synthetic.wrench import BodyWrench

Array = np.ndarray

FEET = ("r", "l")
_UNLOADED = 1.0


@dataclass(frozen=True)
class FootForces:
    """Action of the ground on each foot, right then left; all zero where a foot has no load.

    Attributes:
        force: Force [N].
        centre_of_pressure: Point where it acts, on the floor [m].
        free_moment: Moment about the vertical there [N*m].
    """

    force: Float[Array, "frame foot 3"]
    centre_of_pressure: Float[Array, "frame foot 3"]
    free_moment: Float[Array, "frame foot"]

    def total(self) -> tuple[Float[Array, "frame 3"], Float[Array, "frame 3"]]:
        """Force [N] and moment about the origin of the ground [N*m] of both feet together."""
        moment = np.cross(self.centre_of_pressure, self.force).sum(axis=1)
        moment[:, 1] += self.free_moment.sum(axis=1)
        return self.force.sum(axis=1), moment


def split_between_feet(plan: Plan, wrench: BodyWrench) -> FootForces:
    """Divide what the ground supplies between the feet.

    Args:
        plan: Where the feet are, and how they share.
        wrench: Force and moment that the whole body needs.
    """
    frames = len(plan.time)
    loaded = (wrench.force[:, 1] > _UNLOADED) & ~plan.airborne
    vertical = np.where(loaded, wrench.force[:, 1], 1.0)
    pressure = np.zeros((frames, 3))
    pressure[:, 0], pressure[:, 2] = wrench.moment[:, 2] / vertical, -wrench.moment[:, 0] / vertical
    middles = plan.pressure_paths
    across = (middles[:, 0] - middles[:, 1])[:, [0, 2]]
    right = np.einsum("ti,ti->t", (pressure - middles[:, 1])[:, [0, 2]], across) / (across**2).sum(axis=1)
    right = np.where(loaded, np.clip(right, plan.right_share[:, 0], plan.right_share[:, 1]), 0.5)
    shares = np.stack([right, 1 - right], axis=1)
    force = np.where(loaded[:, None, None], shares[:, :, None] * wrench.force[:, None], 0.0)
    between = np.einsum("tf,tfi->ti", shares, middles)
    centres = middles + (pressure - between)[:, None]
    centres[:, :, 1] = 0.0
    carries = force[:, :, 1] > 0.0
    centres[~carries] = 0.0
    lacking = np.where(loaded, wrench.moment[:, 1] - np.cross(centres, force)[:, :, 1].sum(axis=1), 0.0)
    return FootForces(force, centres, shares * lacking[:, None] * loaded[:, None])
