"""Cross-talk of a misplaced knee axis, and one correction for a whole study.

A medial epicondyle marker 10 mm too far forward turns flexion of 75 degrees into 6 degrees of frontal angle.
Turning the thigh's frame about its long axis until the frontal angle varies least over a calibration
movement undoes most of it (Baker et al. 1999, Hum Mov Sci 18:655; Naim et al. 2019 for the range beyond 20
degrees of flexion), but adds an error of about a degree where the axis was right. So it is off by default,
and the same turn serves all conditions, or it would remove the very differences that are looked for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from evaluation.calibration import LimbCalibration
from evaluation.conventions import FRONTAL, SAGITTAL
from evaluation.joint_angles import cardan_angles, rotation_from_cardan
from hilbrace.errors import InputError
from hilbrace.units import DEG

Array = np.ndarray

LARGEST_TURN_DEG = 25.0
LEAST_RANGE_DEG = 30.0
"""Range of flexion that the calibration movement must span."""

_BENT_DEG = -20.0


def thigh_turn(calibration: LimbCalibration, knee_deg: Float[Array, "frame 3"], where: str) -> float:
    """Turn of the thigh's frame about its long axis at which the frontal angle varies least [deg].

    Args:
        calibration: The standing leg.
        knee_deg: Anatomical knee angles of the calibration movement [deg].
        where: The movement, for messages.

    Raises:
        InputError: The knee bends too little.
    """
    bent = np.isfinite(knee_deg).all(axis=1) & (knee_deg[:, SAGITTAL] < _BENT_DEG)
    if not bent.any() or np.ptp(knee_deg[bent, SAGITTAL]) < LEAST_RANGE_DEG:
        raise InputError(
            f"the knee bends over less than {LEAST_RANGE_DEG:g} deg beyond {-_BENT_DEG:g} deg of flexion",
            where=where,
            hint="give a squat as calibration movement, or leave protocol.processing.cross_talk off",
        )
    mirror = np.array([1.0, 1.0, 1.0]) if calibration.side == "right" else np.array([1.0, -1.0, -1.0])
    relative = rotation_from_cardan(knee_deg[bent] * mirror * DEG)

    def variance(turn_deg: float) -> float:
        return float(cardan_angles(_about_long_axis(-turn_deg) @ relative)[:, FRONTAL].var())

    found = minimize_scalar(variance, bounds=(-LARGEST_TURN_DEG, LARGEST_TURN_DEG), method="bounded",
                            options={"xatol": 1e-6})  # fmt: skip
    return float(found.x)


def turn_thigh(calibration: LimbCalibration, turn_deg: float) -> LimbCalibration:
    """The calibration with the thigh's frame turned about its long axis.

    Args:
        calibration: The standing leg.
        turn_deg: Turn about the upward axis [deg].
    """
    frame = calibration.thigh.frame @ _about_long_axis(turn_deg)
    relative = cardan_angles(frame.T @ calibration.shank.frame) / DEG
    mirror = np.array([1.0, 1.0, 1.0]) if calibration.side == "right" else np.array([1.0, -1.0, -1.0])
    return replace(
        calibration,
        thigh=replace(calibration.thigh, frame=frame),
        knee_deg=relative * mirror,
        cross_talk_deg=calibration.cross_talk_deg + turn_deg,
    )


def _about_long_axis(turn_deg: float) -> Float[Array, "3 3"]:
    return rotation_from_cardan(np.array([0.0, 0.0, turn_deg * DEG]))
