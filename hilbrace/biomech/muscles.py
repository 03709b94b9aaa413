"""Muscle forces: which muscles supply the moments that a motion needs.

Static optimisation (Crowninshield & Brand 1981, J. Biomech. 14:793): of all activations that supply the
moments, those with the least sum of squares. Reserves make it solvable in every frame: weak ones at the
coordinates that muscles move, strong ones where ligaments and condyles hold.

With the criterion ``"activation_and_contact"`` a joint's surfaces count like muscles: the force that presses
on each of them, over its strength, is squared and added (contact forces in the criterion are an idea of
Moissenet, Cheze & Dumas 2014, J. Biomech. 47:50). The strength of a surface is the mean strength of the
muscles that cross the joint, so that nothing is left to choose, and the frontal moment of a knee is carried
by its compartments. Muscles that press on a joint without need, such as the gastrocnemius where the soleus
would do, are then used less.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.contact import Crossing, surface_loads
from hilbrace.biomech.load_sharing import share_load

Array = np.ndarray

RESERVE = 1.0
"""Optimal force of the reserve at a coordinate that muscles move [N*m]."""
LIGAMENTS = 100.0
"""The same at adduction and rotation of the knee, whose moments ligaments and condyles carry [N*m]."""
HELD = ("knee_adduction", "knee_rotation")
MOVED = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle", "subtalar_angle")
"""Coordinates whose moments muscles supply, without their sides. Toes are not among them: the plantar fascia
holds them, which the model does not have."""
SMALLEST_ARM_M = 1e-4


class MuscleFigures(NamedTuple):
    """Constant figures of the muscles.

    Attributes:
        names: Names, in the model's order.
        max_force: Greatest isometric force [N].
        optimal_length: Optimal length of the fibres [m].
        slack_length: Slack length of the tendon [m].
        least_activation: Activation that a muscle at rest has [-], 0.01 in models of the Rajagopal family.
    """

    names: tuple[str, ...]
    max_force: Float[Array, " muscle"]
    optimal_length: Float[Array, " muscle"]
    slack_length: Float[Array, " muscle"]
    least_activation: Float[Array, " muscle"]


class Recruitment(NamedTuple):
    """Muscle forces over a motion.

    Attributes:
        activation: Activations [-], from the least to 1.
        tension: Force of each muscle along its tendon [N].
        balanced: Coordinates whose moments the muscles were asked for.
        steps: Newton steps of the solver.
    """

    activation: Float[Array, "frame muscle"]
    tension: Float[Array, "frame muscle"]
    balanced: tuple[str, ...]
    steps: int


def balanced_coordinates(
    names: tuple[str, ...], coordinates: Float[Array, "frame coordinate"]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Coordinates whose moments muscles are asked for, and those that a lock holds.

    Args:
        names: Names of the coordinates.
        coordinates: Their values; one that never changes is held by a lock, which supplies its moment.
    """
    wanted = [f"{name}_{side}" for side in "rl" for name in (*MOVED, *HELD)]
    still = {name: bool(np.ptp(coordinates[:, k]) == 0.0) for k, name in enumerate(names)}
    present = [name for name in wanted if name in still]
    return (
        tuple(name for name in present if not still[name]),
        tuple(name for name in present if still[name]),
    )


def recruit(
    capacity: Float[Array, "frame muscle"],
    arms: Float[Array, "frame row muscle"],
    moments: Float[Array, "frame row"],
    rows: tuple[str, ...],
    surfaces: Mapping[str, tuple[Crossing, Float[Array, "frame 3"], Float[Array, "frame 3"]]],
    figures: MuscleFigures,
) -> Recruitment:
    """Find the muscle forces that supply the moments of a motion.

    Args:
        capacity: Force of each muscle at full activation [N].
        arms: Moment about each row's coordinate per unit tension [m].
        moments: Moment that the motion needs about it [N*m].
        rows: Names of the coordinates.
        surfaces: By joint, the muscles' pull, and the net force [N] and moment [N*m] across the joint, whose
            surfaces count in the criterion; empty for the sum of squared activations alone.
        figures: Strengths and least activations of the muscles.

    Raises:
        SolverError: The programme does not converge.
    """
    carried = {f"knee_adduction_{joint[-1]}" for joint in surfaces if joint.startswith("knee")}
    reached = np.abs(arms).max(axis=(0, 2), initial=0.0) > SMALLEST_ARM_M
    kept = [k for k, name in enumerate(rows) if reached[k] and name not in carried]
    strength = [LIGAMENTS if rows[k].startswith(HELD) else RESERVE for k in kept]
    effect = [arms[:, kept] * capacity[:, None]]
    demand = [moments[:, kept]]
    for joint, (across, force, moment) in surfaces.items():
        pressed = surface_loads(across.pull, across.turn, joint)
        needed = surface_loads(force, moment, joint)
        crossing = np.abs(across.pull).max(axis=(0, 2), initial=0.0) > 0.0
        strength += [float(figures.max_force[crossing].mean())] * len(needed)
        effect.append(np.stack([load * capacity for load in pressed], axis=1))
        demand.append(np.stack(needed, axis=1))
    shares = share_load(
        np.concatenate(effect, axis=1),
        np.concatenate(demand, axis=1),
        np.array(strength),
        figures.least_activation,
    )
    return Recruitment(
        shares.activation, shares.activation * capacity, tuple(rows[k] for k in kept), shares.steps
    )
