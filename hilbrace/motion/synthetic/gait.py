"""Level walking at 1.2 m/s, exactly periodic and symmetric.

A stride of the left side is a stride of the right half a period later, mirrored. The root's channels are
periodic splines with that symmetry, so half a stride holds all that the optimiser can change, and a
recording may start and end anywhere without an unclean edge. Phases are shares of the stride from heel
strike (events after Perry & Burnfield, "Gait Analysis", 2010: toe off at 62 %, heel rise at about 31 %).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline

from hilbrace.motion.synthetic.curves import glide, pulse, ramp
from hilbrace.motion.synthetic.feet import FootPath, Rockers, foot_path
from hilbrace.motion.synthetic.plan import Effort, Motion, Plan, Plate, RootBasis
from hilbrace.units import DEG

Array = np.ndarray
Time = Float[Array, " frame"]

SPEED = 1.2
"""Walking speed [m/s]."""
STRIDE = 1.0
"""Duration of a stride [s]."""
STANCE = 0.62
"""Share of the stride that a foot stands."""

_HALF_COEFFICIENTS = 10
_DEGREE = 5
_LENGTH = SPEED * STRIDE
_DOUBLE_SUPPORT = STANCE - 0.5
_CHOICE = 0.025
_HEEL_AHEAD = 0.25
_TRACK_HALF = 0.06
_TOES_OUT = 0.1
_SIDES = (("r", 0.0, 1.0), ("l", 0.5, -1.0))
_EVEN = np.array([1.0, -1.0, -1.0, 1.0, 1.0, -1.0])


def gait() -> Motion:
    """Four steps of level walking (1.6 strides), each on a force plate of its own."""
    start, end = -0.2 * STRIDE, 1.4 * STRIDE
    return Motion(
        name="gait",
        start=start,
        end=end,
        plan=_plan,
        reference=_reference(),
        free=np.ones((_HALF_COEFFICIENTS, 6), dtype=bool),
        optimise_over=(0.0, STRIDE / 2),
        margin=0.15,
        effort=Effort(
            centre=1 / 60,
            yaw=1 / 2.5,
            track=(60.0, 20.0, 30.0, 4.0, 2.0, 2.0),
            smooth=(5e-4, 5e-4, 5e-4, 6e-3, 2e-2, 6e-3),
            knee=40.0,
            friction=0.22,
            load=(0.65, 1.30),
        ),
        plates=tuple(_plate(k) for k in range(-1, 3)),
    )


def _plate(step: int) -> Plate:
    """The plate of one step; even steps are the right foot's."""
    strike = step * STRIDE / 2
    foot = "r" if step % 2 == 0 else "l"
    return Plate(
        foot, (SPEED * strike + _HEEL_AHEAD + 0.12, 0.0), (0.295, 0.25), (strike, strike + STANCE * STRIDE)
    )


def _plan(time: Time) -> Plan:
    feet: dict[str, FootPath] = {}
    posture: dict[str, Array] = {}
    paths, ceilings = [], []
    swing = np.cos(2 * np.pi * time / STRIDE)
    for side, lag, sign in _SIDES:
        strides = np.floor(time / STRIDE - lag)
        phase = time / STRIDE - lag - strides
        heel = (strides + lag) * _LENGTH + _HEEL_AHEAD
        feet[side] = _foot(phase, heel, sign)
        paths.append(_pressure_path(phase, heel, sign))
        ceilings.append(_knee_ceiling(phase))
        posture.update(_limbs(phase, side, sign, swing))
        posture[f"mtp_angle_{side}"] = feet[side].toe_angle
    posture["lumbar_extension"] = np.full_like(time, -0.05)
    posture["lumbar_rotation"] = -0.22 * swing
    phase = time / STRIDE % 1.0
    shares = _share_range(phase)
    pressure = np.stack(paths, axis=1)
    middle = shares.mean(axis=1, keepdims=True)
    both = middle * pressure[:, 0] + (1 - middle) * pressure[:, 1]
    spread = np.abs(pressure[:, 0] - pressure[:, 1]) * np.diff(shares) / 2
    return Plan(
        time=time,
        root=_root(time),
        posture=posture,
        feet=feet,
        pressure_paths=pressure,
        cop_target=both[:, [0, 2]],
        cop_reach=spread[:, [0, 2]] + [0.05, 0.025],
        right_share=shares,
        airborne=np.zeros(len(time), dtype=bool),
        knee_ceiling=np.stack(ceilings, axis=1),
    )


def _foot(phase: Time, heel: Time, sign: float) -> FootPath:
    """Heel strike with the toes up, foot flat, heel off, toe off, swing."""
    forward = heel + _LENGTH * glide(phase, 0.60, 1.0, 0.40, 0.38)
    lift = 0.025 * pulse(phase, 0.62, 0.80, 0.84, 1.0)
    rockers = Rockers(
        heel=0.33 * (1 - ramp(phase, 0.0, 0.11) + ramp(phase, 0.78, 0.98)),
        ball=0.48 * pulse(phase, 0.31, 0.60, 0.62, 0.86),
        tip=0.65 * pulse(phase, 0.48, 0.70, 0.66, 0.88),
    )
    place = np.stack([forward, lift, np.full_like(phase, sign * _TRACK_HALF)], axis=1)
    return foot_path(place, -sign * _TOES_OUT, rockers)


def _pressure_path(phase: Time, heel: Time, sign: float) -> Float[Array, "frame 3"]:
    """From the heel to the toes in the course of stance."""
    along = 0.015 + 0.195 * ramp(phase, -0.06, 0.62)
    outward = sign * (_TRACK_HALF + _TOES_OUT * along)
    return np.stack([heel + along, np.zeros_like(phase), outward], axis=1)


def _share_range(phase: Time) -> Float[Array, "frame 2"]:
    """Least and largest share of the right foot: all or nothing in single support, a choice in between."""
    early, late = 0.0, _CHOICE
    least = ramp(phase, late, _DOUBLE_SUPPORT) - ramp(phase, 0.5 + early, 0.5 + _DOUBLE_SUPPORT - _CHOICE)
    largest = ramp(phase, early, _DOUBLE_SUPPORT - _CHOICE) - ramp(phase, 0.5 + late, 0.5 + _DOUBLE_SUPPORT)
    return np.clip(np.stack([least, largest], axis=1), 0.0, 1.0)


def _knee_ceiling(phase: Time) -> Time:
    """A stance leg near extension: at most 18 deg until the heel has risen; no wish in swing."""
    return 18 * DEG + 90 * DEG * (ramp(phase, 0.44, 0.62) - ramp(phase, 0.90, 1.0))


def _limbs(phase: Time, side: str, sign: float, swing: Time) -> dict[str, Array]:
    """Arms against the legs; a little knee adduction and rotation in stance."""
    loaded = pulse(phase, 0.02, 0.20, 0.40, 0.60)
    return {
        f"arm_flex_{side}": 0.05 - sign * 0.42 * swing,
        f"arm_add_{side}": np.full_like(phase, -0.12),
        f"elbow_flex_{side}": 0.45 - sign * 0.15 * swing,
        f"pro_sup_{side}": np.full_like(phase, 0.6),
        f"knee_adduction_{side}": 2 * DEG * loaded,
        f"knee_rotation_{side}": 1.5 * DEG * loaded,
    }


def _reference() -> Float[Array, "coefficient 6"]:
    """Coefficients of a plain walk: the height falls in double support, pelvis and trunk sway."""
    time = STRIDE * np.arange(200) / 200
    stride = 2 * np.pi * time / STRIDE
    wished = np.zeros((len(time), 6))
    wished[:, 0] = -0.04
    wished[:, 1] = 0.03 * np.sin(stride)
    wished[:, 2] = 0.07 * np.cos(stride)
    wished[:, 4] = 0.89 - 0.019 * np.cos(2 * stride)
    wished[:, 5] = 0.02 * np.sin(stride)
    value = _symmetric_basis(time, 0)
    return np.stack([np.linalg.lstsq(value[c], wished[:, c], rcond=None)[0] for c in range(6)], axis=1)


def _root(time: Time) -> RootBasis:
    """Steady progress plus periodic channels."""
    offset = np.zeros((len(time), 6))
    offset[:, 3] = SPEED * time
    value, second, third = (_symmetric_basis(time, order) for order in (0, 2, 3))
    return RootBasis(offset, np.zeros((len(time), 3)), value, second, third)


def _symmetric_basis(time: Time, order: int) -> Float[Array, "6 frame coefficient"]:
    """Periodic B-splines that repeat after half a stride, with the sign of each channel, or a derivative."""
    count = 2 * _HALF_COEFFICIENTS
    step = STRIDE / count
    bump = BSpline.basis_element(np.arange(_DEGREE + 2.0), extrapolate=False)
    shape = bump if order == 0 else bump.derivative(order)
    place = (time[:, None] / step - np.arange(count)) % count
    values = np.nan_to_num(shape(np.where(place <= _DEGREE + 1, place, np.nan))) / step**order
    first, second = values[:, :_HALF_COEFFICIENTS], values[:, _HALF_COEFFICIENTS:]
    return first + _EVEN[:, None, None] * second
