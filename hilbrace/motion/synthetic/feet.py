"""Paths of the feet, made of the three rockers of the foot: heel, ball and toe tip.

A foot on the ground turns about its heel after heel strike, about the ball when the heel rises (the toes stay
flat), and about the toe tip when it leaves (Perry & Burnfield, "Gait Analysis", 2010). Every rocker keeps its
pivot on the ground, so a foot in stance cannot slide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray

HEEL = np.array([0.0, 0.0, 0.0])
"""Where the heel touches the ground, in the calcaneus frame [m]."""
BALL = np.array([0.1788, 0.0, 0.0])
"""Below the metatarsophalangeal joint, in the calcaneus frame [m]."""
TOE_TIP = np.array([0.2388, 0.0, 0.0])
"""End of the toes, in the calcaneus frame of the flat foot [m]."""
HALF_WIDTH = 0.05
"""Half the breadth of the sole [m]."""


@dataclass(frozen=True)
class Rockers:
    """Angles of the rockers [rad], all zero while the foot is flat.

    Attributes:
        heel: Toes up, about the heel.
        ball: Heel up, about the ball; the toes stay flat, so this is the toes' extension.
        tip: The whole foot, about the toe tip.
    """

    heel: Float[Array, " frame"]
    ball: Float[Array, " frame"]
    tip: Float[Array, " frame"]


@dataclass(frozen=True)
class FootPath:
    """Prescribed motion of one foot.

    Attributes:
        rotation: Orientation of the calcaneus in the ground.
        origin: Origin of the calcaneus [m].
        toe_angle: The model's ``mtp_angle``, negative while the toes are extended [rad].
    """

    rotation: Float[Array, "frame 3 3"]
    origin: Float[Array, "frame 3"]
    toe_angle: Float[Array, " frame"]

    def point(self, local: Float[Array, "3"]) -> Float[Array, "frame 3"]:
        """Path of a point given in the calcaneus frame [m]."""
        return self.origin + self.rotation @ local


def foot_path(flat_origin: Float[Array, "frame 3"], yaw: float, rockers: Rockers) -> FootPath:
    """The foot's path from where it would stand flat and the angles of its rockers.

    Args:
        flat_origin: Origin of the calcaneus of the flat foot [m]; moving it lifts and carries the foot.
        yaw: Direction of the toes, positive to the left [rad].
        rockers: Angles of the rockers.
    """
    shift = np.zeros((len(flat_origin), 3))
    for pivot, angle in ((HEEL, rockers.heel), (BALL, -rockers.ball), (TOE_TIP, -rockers.tip)):
        shift = pivot + np.einsum("tij,tj->ti", about_z(angle), shift - pivot)
    turn = about_y(np.array([yaw]))[0]
    pitch = rockers.heel - rockers.ball - rockers.tip
    return FootPath(turn @ about_z(pitch), flat_origin + shift @ turn.T, -rockers.ball)


def about_z(angle: Float[Array, " frame"]) -> Float[Array, "frame 3 3"]:
    """Rotations about z: forward axis towards the vertical."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape(-1, 3, 3)


def about_y(angle: Float[Array, " frame"]) -> Float[Array, "frame 3 3"]:
    """Rotations about the vertical y."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([c, zero, s, zero, one, zero, -s, zero, c], -1).reshape(-1, 3, 3)
