"""What a synthetic motion prescribes, and what is left to be found.

Prescribed are the feet, the upper body and the adduction and rotation of the knees. Left to be found are
six channels, splines of time: the pelvis angles and the path of the centre of mass. All else follows
(`solver`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from hilbrace.motion.synthetic.feet import FootPath

Array = np.ndarray

CHANNELS = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "com_x", "com_y", "com_z")
"""Channels of the root: pelvis angles [rad], then centre of mass [m]."""


@dataclass(frozen=True)
class RootBasis:
    """The root's channels at given instants as linear functions of coefficients.

    ``channel = offset + value @ coefficients``, each channel with its own basis.

    Attributes:
        offset: Part that is fixed.
        offset_acceleration: Its second derivative, of the centre of mass [m/s^2].
        value: Basis functions.
        second: Their second derivatives [1/s^2].
        third: Their third derivatives [1/s^3].
    """

    offset: Float[Array, "frame 6"]
    offset_acceleration: Float[Array, "frame 3"]
    value: Float[Array, "6 frame coefficient"]
    second: Float[Array, "6 frame coefficient"]
    third: Float[Array, "6 frame coefficient"]

    def channels(self, coefficients: Float[Array, "coefficient 6"]) -> Float[Array, "frame 6"]:
        """Pelvis angles [rad] and centre of mass [m]."""
        return self.offset + np.einsum("ctn,nc->tc", self.value, coefficients)

    def com_acceleration(self, coefficients: Float[Array, "coefficient 6"]) -> Float[Array, "frame 3"]:
        """Acceleration of the centre of mass [m/s^2]."""
        return self.offset_acceleration + np.einsum("ctn,nc->tc", self.second[3:], coefficients[:, 3:])


@dataclass(frozen=True)
class Plan:
    """One motion at given instants.

    Attributes:
        time: Instants [s].
        root: Channels of the root as functions of their coefficients.
        posture: Prescribed coordinates [rad].
        feet: Path of each foot, ``"r"`` and ``"l"``.
        pressure_paths: Where the centre of pressure of each foot is wished, right and left [m].
        cop_target: Where the centre of pressure of both feet together is wished, x and z [m].
        cop_reach: How far from there it may go [m].
        right_share: Least and largest share of the force that the right foot may take.
        airborne: Instants of flight.
        knee_ceiling: Knee flexion that each knee should not exceed, right and left [rad].
    """

    time: Float[Array, " frame"]
    root: RootBasis
    posture: dict[str, Float[Array, " frame"]]
    feet: dict[str, FootPath]
    pressure_paths: Float[Array, "frame 2 3"]
    cop_target: Float[Array, "frame 2"]
    cop_reach: Float[Array, "frame 2"]
    right_share: Float[Array, "frame 2"]
    airborne: Bool[Array, " frame"]
    knee_ceiling: Float[Array, "frame 2"]


@dataclass(frozen=True)
class Effort:
    """Weights of the optimiser's wishes, against 1 N*m of moment that the ground cannot give.

    Attributes:
        centre: Wished place of the centre of pressure [1/(N*m)].
        yaw: Free moment [1/(N*m)].
        track: Distance of each channel from its reference.
        smooth: Third derivative of each channel.
        knee: Knee flexion above its ceiling [1/rad].
        friction: Largest wished ratio of horizontal to vertical force.
        load: Least and largest wished vertical force, as shares of the body's weight.
    """

    centre: float
    yaw: float
    track: tuple[float, ...]
    smooth: tuple[float, ...]
    knee: float = 0.0
    friction: float = 0.28
    load: tuple[float, float] = (0.0, np.inf)


@dataclass(frozen=True)
class Plate:
    """A force plate in the floor.

    Attributes:
        foot: The foot that steps on it, ``"r"`` or ``"l"``.
        centre: Its middle, x and z [m].
        half: Half its length and width, along x and z [m].
        interval: First and last instant at which that foot loads it [s].
    """

    foot: str
    centre: tuple[float, float]
    half: tuple[float, float]
    interval: tuple[float, float]


@dataclass(frozen=True)
class Motion:
    """A synthetic motion: how to plan it, and what its optimiser may change.

    Attributes:
        name: ``"serve"``, ``"gait"`` or ``"squat"``.
        start: First instant of the published part [s].
        end: Its last instant [s].
        plan: Plan at given instants.
        reference: Coefficients from which the optimiser starts and to which it stays close.
        free: Coefficients that it may change.
        optimise_over: First and last instant of its problem [s].
        margin: Time beyond both, so that derivatives have no edge [s]; 0 where the motion rests.
        effort: Weights.
        plates: Force plates of the synthetic laboratory.
    """

    name: str
    start: float
    end: float
    plan: Callable[[Float[Array, " frame"]], Plan]
    reference: Float[Array, "coefficient 6"]
    free: Bool[Array, "coefficient 6"]
    optimise_over: tuple[float, float]
    margin: float
    effort: Effort
    plates: tuple[Plate, ...]
