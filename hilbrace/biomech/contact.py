"""Contact forces: what bones press on each other, once the muscles' pull is known.

Newton-Euler on the part below a joint gives the net load across it. Muscles that cross the joint pull on that
part; what they do not supply of the net load, the bones do (Steele, DeMers, Schwartz & Delp 2012, Gait &
Posture 35:556). At the knee the load is that on the tibia, kneecap aside; at the ankle that on the talus.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Array = np.ndarray

COMPARTMENTS_M = 0.045
"""Distance between the centres of pressure of the two compartments of a knee [m], an assumption: between the
40 and 50 mm that are usual for adults. A share of the load moves by its error over this distance."""

UP, ANTERIOR = 1, 0
NO_PULL = 1e-9
SAME_ARM_M = 1e-5
LARGEST_SHARE = 1.5
"""Bound of the ligament's over the quadriceps' tension [-]; measured shares are 0.5 to 1.3."""


class Crossing(NamedTuple):
    """What muscles do across a joint per unit tension, in the frame of the distal bone.

    Attributes:
        pull: Force on the part below the joint [-]; zero for muscles that do not cross.
        turn: Moment of the same about the joint's centre [m].
    """

    pull: Float[Array, "frame muscle 3"]
    turn: Float[Array, "frame muscle 3"]


def crossing(
    pulls: Float[Array, "frame muscle 6"],
    rotation: Float[Array, "frame 3 3"],
    centre: Float[Array, "frame 3"],
) -> Crossing:
    """Turn the muscles' pulls on the part below a joint into the frame of its distal bone.

    Args:
        pulls: Force [-] and moment about the origin of the ground [m] per unit tension, ground frame.
        rotation: Rotation of the distal bone, its frame to ground.
        centre: The joint's centre in the ground [m].
    """
    force = pulls[..., :3]
    moment = pulls[..., 3:] - np.cross(centre[:, None], force)
    crosses = np.abs(pulls).max(axis=(0, 2), initial=0.0) > NO_PULL
    masked = np.where(crosses[None, :, None], 1.0, 0.0)
    return Crossing(masked * (force @ rotation), masked * (moment @ rotation))


def through_kneecap(
    across: Crossing,
    flexion: Float[Array, "frame 6"],
    arms: Float[Array, "frame muscle"],
) -> Crossing:
    """Let the quadriceps pull on the tibia by the patellar ligament, whose tension is not their own.

    A path that runs over the kneecap pulls on the tibia at its last stretch, the ligament, with an arm of 36
    to 50 mm. Its moment arm about knee flexion is shorter, since the kneecap moves too: 42 mm at 20 deg, 20
    mm at 100 deg. The kneecap is a lever, not a pulley: the ligament carries less than the quadriceps, most
    of all in deep flexion (van Eijden et al. 1986, J. Biomech. 19:219; Yamaguchi & Zajac 1989, J. Biomech.
    22:1). Here its tension follows from the balance of the tibia, on which only the ligament acts for them:
    moment arm over the ligament's own arm, times the quadriceps' tension. With the same tension on both
    sides, as OpenSim's joint reaction analysis has it, the moment about the flexion axis would be off by what
    the model's coupler between knee and kneecap supplies.

    Args:
        across: Muscles' pull on the part below the knee, tension the same all along the path.
        flexion: Velocity of the joint's centre [m] and turn [-] of the tibia per unit speed of knee flexion,
            in its frame.
        arms: Moment arms about knee flexion [m].

    Returns:
        The same, with the pull of muscles that run over the kneecap scaled.
    """
    below = np.einsum("fmi,fi->fm", across.pull, flexion[:, :3])
    below += np.einsum("fmi,fi->fm", across.turn, flexion[:, 3:])
    over = (np.abs(arms - below).max(axis=0, initial=0.0) > SAME_ARM_M) & np.any(across.pull, axis=(0, 2))
    share = np.where(over, arms, 1.0) / np.where(over, below, 1.0)
    share = np.clip(share, 0.0, LARGEST_SHARE)[..., None]
    return Crossing(share * across.pull, share * across.turn)


def compartments(
    force: Float[Array, "*any 3"], moment: Float[Array, "*any 3"], joint: str
) -> tuple[Float[Array, "*any"], Float[Array, "*any"]]:
    """Compression of the medial and the lateral compartment of a knee [N].

    Two parallel forces `COMPARTMENTS_M` apart, even about the joint's centre, that have the compression and
    the frontal moment of the contact; negative where they would have to pull.

    Args:
        force: Contact force on the tibia, its frame [N].
        moment: Its moment about the joint's centre [N*m].
        joint: ``"knee_r"`` or ``"knee_l"``.
    """
    to_lateral = 1.0 if joint.endswith("_r") else -1.0
    press, tilt = -0.5 * force[..., UP], to_lateral * moment[..., ANTERIOR] / COMPARTMENTS_M
    return press - tilt, press + tilt


def surface_loads(
    force: Float[Array, "*any 3"], moment: Float[Array, "*any 3"], joint: str
) -> tuple[Float[Array, "*any"], ...]:
    """Compression of each surface of a joint [N]: two compartments of a knee, one surface of an ankle."""
    if joint.startswith("knee"):
        return compartments(force, moment, joint)
    return (-force[..., UP],)


def acting_force(
    net: Float[Array, "frame 3"],
    pull: Float[Array, "frame muscle 3"],
    tension: Float[Array, "frame muscle"],
    convention: str,
) -> Float[Array, "frame 3"]:
    """Acting force F_JCF - sum F_mus of Eq. 1, in the frame of ``net``.

    With ``"intersegmental"`` the muscles count as their pull on the proximal bone; contact and muscles then
    add up to the net force across the joint. With ``"paper_literal"`` they count as their pull on the distal
    bone, on which the contact force is given: their compression then counts twice.

    Args:
        net: Net (intersegmental) force of the proximal on the distal part [N], or moment [N*m].
        pull: Pull of each muscle on the distal part per unit tension [-], or its moment [m].
        tension: Tension of each muscle [N].
        convention: ``"intersegmental"`` or ``"paper_literal"``.
    """
    if convention == "intersegmental":
        return net
    return net - 2.0 * np.einsum("fmi,fm->fi", pull, tension)
