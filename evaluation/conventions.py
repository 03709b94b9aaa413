"""Signs of joint angles: one set of anatomical angles, and what papers and laboratories make of it.

Anatomical angles mean the same on both sides: extension of the knee (dorsiflexion of the ankle), adduction
(ankle: inversion) and internal rotation are positive. From here on angles are in degrees, as people read
them.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from hilbrace.units import DEG

Array = np.ndarray

Side = Literal["left", "right"]
Convention = Literal["paper", "visual3d", "plug_in_gait"]
CONVENTIONS: tuple[Convention, ...] = get_args(Convention)

SAGITTAL, FRONTAL, TRANSVERSE = 0, 1, 2
"""Columns of every array of angles."""

PLANES = ("sagittal", "frontal", "transverse")

_SIGNS: dict[tuple[Convention, Side], tuple[int, int, int]] = {
    ("paper", "right"): (1, 1, 1),
    ("paper", "left"): (1, 1, 1),
    ("visual3d", "right"): (1, 1, 1),
    ("visual3d", "left"): (1, -1, -1),
    ("plug_in_gait", "right"): (-1, 1, 1),
    ("plug_in_gait", "left"): (-1, 1, 1),
}

KNEE_MEANING: dict[Convention, tuple[str, str, str]] = {
    "paper": ("extension +, flexion -", "adduction +, abduction -", "internal +, external -"),
    "visual3d": (
        "extension +, flexion -",
        "right: adduction +, left: abduction +",
        "right: internal +, left: external +",
    ),
    "plug_in_gait": ("flexion +, extension -", "adduction (varus) +, abduction -", "internal +, external -"),
}
"""What a positive knee angle means, plane by plane."""


def anatomical_degrees(cardan_rad: Float[Array, "*frame 3"], side: Side) -> Float[Array, "*frame 3"]:
    """Cardan angles as anatomical angles [deg]: on the left the last two turn the other way.

    Args:
        cardan_rad: Angles (a, b, c) of `evaluation.joint_angles.cardan_angles` [rad].
        side: Which leg.
    """
    mirror = np.array([1.0, 1.0, 1.0]) if side == "right" else np.array([1.0, -1.0, -1.0])
    return cardan_rad / DEG * mirror


def in_convention(
    anatomical_deg: Float[Array, "*frame 3"], side: Side, convention: Convention
) -> Float[Array, "*frame 3"]:
    """Knee angles with the signs of a convention [deg].

    ``paper`` counts extension and adduction positive on both sides (caption of the paper's table).
    ``visual3d`` is the plain x-y-z sequence on frames whose x axis points to the right in both legs, so that
    on the left abduction and external rotation are positive. ``plug_in_gait`` counts flexion positive, as
    `hilbrace.biomech.joint_loads.JointLoads` does.

    Args:
        anatomical_deg: Angles of `anatomical_degrees`.
        side: Which leg.
        convention: Whose signs.
    """
    return anatomical_deg * np.array(_SIGNS[convention, side], float)
