"""Standing motions on two feet: the serve-like jump and the squat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import BSpline

from hilbrace.motion.synthetic.curves import basis, clamped_knots, hump, pulse
from hilbrace.motion.synthetic.feet import BALL, TOE_TIP, FootPath, Rockers, foot_path
from hilbrace.motion.synthetic.height_plan import AccelerationWish, HeightPlan, Waypoint, plan_height
from hilbrace.motion.synthetic.plan import Effort, Motion, Plan, Plate, RootBasis
from hilbrace.units import DEG, GRAVITY

Array = np.ndarray
Time = Float[Array, " frame"]

_DEGREE = 5
_FIXED_AT_ENDS = 3
_STANCE_HALF = 0.11
_TOES_OUT = 0.12
_STANDING_HEIGHT = 0.905
_FORWARD = 0.115
_MIDDLE_OF_FOOT = np.array([0.11, 0.0, 0.0])


@dataclass(frozen=True)
class _Standing:
    """What the serve and the squat share."""

    name: str
    duration: float
    height: HeightPlan
    knots: Float[Array, " knot"]
    posture: Callable[[Time], dict[str, Time]]
    rockers: Callable[[Time], Rockers]
    lift: Callable[[Time], Time]
    flight: tuple[float, float] | None
    lean: Callable[[Time], Time]


def serve() -> Motion:
    """Stand, bend deep, jump, fly, land with the knees adducting, recover (3.2 s).

    The jump of a tennis serve: the left arm goes up as for the toss while the knees bend, the right arm
    swings overhead in flight.
    """
    leave, land, deepest, lowest = 1.45, 1.72, 1.24, 1.99
    rise_at, fall_at, airtime = 0.902, 0.893, land - leave
    speed = (fall_at - rise_at) / airtime + GRAVITY * airtime / 2
    height = plan_height(
        [
            Waypoint(0.0, _STANDING_HEIGHT),
            Waypoint(0.4, _STANDING_HEIGHT),
            Waypoint(deepest, _STANDING_HEIGHT - 0.16),
            Waypoint(leave, rise_at, speed),
            Waypoint(lowest, _STANDING_HEIGHT - 0.150),
            Waypoint(2.3, _STANDING_HEIGHT - 0.115, None),
            Waypoint(2.9, _STANDING_HEIGHT),
            Waypoint(3.2, _STANDING_HEIGHT),
        ],
        flight=(leave, land),
        wishes=(AccelerationWish(land + 0.06, 1.45 * GRAVITY, 1.0),),
    )

    def crouch(time: Time) -> Time:
        """The trunk's lean: two bends, half upright between them in flight."""
        first, second = pulse(time, 0.4, 1.15, 1.18, 1.60), pulse(time, 1.58, 2.12, 2.14, 2.85)
        return first + second + 0.45 * pulse(time, 1.18, 1.60, 1.58, 2.12)

    def posture(time: Time) -> dict[str, Time]:
        bent = crouch(time)
        toss, swing = pulse(time, 0.3, 1.1, 1.3, 2.3), pulse(time, 0.9, 1.65, 1.8, 2.8)
        yielding = pulse(time, land - 0.05, land + 0.25, land + 0.32, land + 0.9) + 0.2 * pulse(
            time, 0.4, 1.05, 1.1, 1.5
        )
        return {
            "lumbar_extension": -0.3 * bent,
            "arm_flex_l": 0.5 * bent + 0.8 * toss,
            "arm_add_l": -0.12 - 0.2 * toss,
            "elbow_flex_l": 0.35 - 0.15 * toss,
            "arm_flex_r": 0.5 * bent + 0.8 * swing,
            "arm_add_r": -0.12 - 0.4 * swing,
            "elbow_flex_r": 0.35 + 0.7 * toss,
            **{f"pro_sup_{side}": np.full_like(time, 0.6) for side in "rl"},
            "knee_adduction_r": 3 * DEG * yielding,
            "knee_adduction_l": 5 * DEG * yielding,
            **{f"knee_rotation_{side}": 3 * DEG * bent for side in "rl"},
        }

    def rockers(time: Time) -> Rockers:
        rise = pulse(time, 1.24, 1.60, 1.57, land + 0.15)
        return Rockers(np.zeros_like(time), 0.45 * rise, 0.10 * rise)

    def lean(time: Time) -> Time:
        return -0.6 * crouch(time)

    return _motion(
        _Standing(
            "serve",
            3.2,
            height,
            clamped_knots(0.0, 3.2, 0.08, _DEGREE, (leave - 0.15, land + 0.2, 0.025)),
            posture,
            rockers,
            lambda time: 0.045 * hump(time, leave, land),
            (leave, land),
            lean,
        )
    )


def squat() -> Motion:
    """Stand, bend the knees slowly, stand up (3.0 s)."""
    height = plan_height(
        [
            Waypoint(0.0, _STANDING_HEIGHT),
            Waypoint(0.3, _STANDING_HEIGHT),
            Waypoint(1.4, _STANDING_HEIGHT - 0.22),
            Waypoint(1.6, _STANDING_HEIGHT - 0.22),
            Waypoint(2.7, _STANDING_HEIGHT),
            Waypoint(3.0, _STANDING_HEIGHT),
        ],
        knot_step=0.05,
    )

    def bend(time: Time) -> Time:
        return pulse(time, 0.3, 1.4, 1.6, 2.7)

    def posture(time: Time) -> dict[str, Time]:
        down = bend(time)
        values: dict[str, Time] = {"lumbar_extension": -0.35 * down}
        for side, adduction in (("r", 2 * DEG), ("l", 3 * DEG)):
            values[f"arm_flex_{side}"] = 0.1 + 1.2 * down
            values[f"arm_add_{side}"] = np.full_like(time, -0.12)
            values[f"elbow_flex_{side}"] = 0.35 - 0.15 * down
            values[f"pro_sup_{side}"] = np.full_like(time, 0.6)
            values[f"knee_adduction_{side}"] = adduction * down
            values[f"knee_rotation_{side}"] = 2 * DEG * down
        return values

    def flat(time: Time) -> Rockers:
        return Rockers(np.zeros_like(time), np.zeros_like(time), np.zeros_like(time))

    return _motion(
        _Standing(
            "squat",
            3.0,
            height,
            clamped_knots(0.0, 3.0, 0.15, _DEGREE),
            posture,
            flat,
            np.zeros_like,
            None,
            lambda time: -0.75 * bend(time),
        )
    )


def _motion(standing: _Standing) -> Motion:
    splines = basis(standing.knots, _DEGREE)
    count = len(standing.knots) - _DEGREE - 1
    free = np.ones((count, 6), dtype=bool)
    free[:_FIXED_AT_ENDS] = free[-_FIXED_AT_ENDS:] = False
    free[:, 4] = False
    free[_airborne_coefficients(standing)[2:], 3:] = False
    plates = tuple(
        Plate(side, (0.1, z), (0.3, 0.2), (0.0, standing.duration)) for side, z in (("r", 0.22), ("l", -0.22))
    )
    return Motion(
        name=standing.name,
        start=0.0,
        end=standing.duration,
        plan=lambda time: _plan(standing, splines, time),
        reference=_reference(standing, splines),
        free=free,
        optimise_over=(0.0, standing.duration),
        margin=0.0,
        effort=Effort(
            centre=1 / 60,
            yaw=1 / 5,
            track=(2.0, 15.0, 15.0, 3.0, 0.0, 15.0),
            smooth=(5e-5, 5e-5, 5e-5, 5e-4, 0.0, 5e-4),
        ),
        plates=plates,
    )


def _airborne_coefficients(standing: _Standing) -> Int[Array, " coefficient"]:
    """Coefficients of the root's splines whose support touches the flight."""
    if standing.flight is None:
        return np.zeros(0, dtype=int)
    begins, ends = standing.knots[: -_DEGREE - 1], standing.knots[_DEGREE + 1 :]
    return np.flatnonzero((ends > standing.flight[0] + 1e-9) & (begins < standing.flight[1] - 1e-9))


def _ballistic(
    standing: _Standing, values: Float[Array, "frame coefficient"]
) -> Float[Array, "frame coefficient"]:
    """The basis of the horizontal channels: straight and steady wherever it touches the flight.

    A spline is linear where its coefficients are linear in the knot averages of their supports (Marsden's
    identity). The first two airborne coefficients become height and slope of that line, the others idle.
    """
    airborne = _airborne_coefficients(standing)
    if not airborne.size:
        return values
    average = np.array([standing.knots[k + 1 : k + 1 + _DEGREE].mean() for k in airborne])
    changed = values.copy()
    changed[:, airborne] = 0.0
    changed[:, airborne[0]] = values[:, airborne].sum(axis=1)
    changed[:, airborne[1]] = values[:, airborne] @ (average - average.mean())
    return changed


def _reference(standing: _Standing, splines: BSpline) -> Float[Array, "coefficient 6"]:
    """Coefficients of the lean that is wished for, and of a centre of mass at rest above the feet."""
    time = np.arange(0.0, standing.duration + 1e-9, 0.01)
    coefficients = np.zeros((splines.c.shape[0], 6))
    coefficients[:, 0] = np.linalg.lstsq(splines(time), standing.lean(time), rcond=None)[0]
    coefficients[:, 3] = _FORWARD
    coefficients[_airborne_coefficients(standing)[1:], 3] = 0.0
    return coefficients


def _plan(standing: _Standing, splines: BSpline, time: Time) -> Plan:
    rockers, lift = standing.rockers(time), standing.lift(time)
    feet = {side: _foot(time, rockers, lift, sign) for side, sign in (("r", 1.0), ("l", -1.0))}
    posture = standing.posture(time)
    posture.update({f"mtp_angle_{side}": path.toe_angle for side, path in feet.items()})
    low = BALL[0] * np.clip((rockers.ball + rockers.tip) / 0.10, 0, 1) * 0.9
    high = np.full_like(time, TOE_TIP[0] - 0.02)
    zero = np.zeros_like(time)
    airborne = np.zeros(len(time), dtype=bool)
    if standing.flight is not None:
        airborne = (time > standing.flight[0]) & (time < standing.flight[1])
    return Plan(
        time=time,
        root=_root(standing, splines, time),
        posture=posture,
        feet=feet,
        pressure_paths=np.stack(
            [feet[side].point(_MIDDLE_OF_FOOT) * (1.0, 0.0, 1.0) for side in "rl"], axis=1
        ),
        cop_target=np.stack([(low + high) / 2, zero], axis=1),
        cop_reach=np.stack([(high - low) / 2, zero + 0.5 * _STANCE_HALF], axis=1),
        right_share=np.broadcast_to([0.0, 1.0], (len(time), 2)),
        airborne=airborne,
        knee_ceiling=np.full((len(time), 2), 100 * DEG),
    )


def _foot(time: Time, rockers: Rockers, lift: Time, sign: float) -> FootPath:
    place = np.stack([np.zeros_like(time), lift, np.full_like(time, sign * _STANCE_HALF)], axis=1)
    return foot_path(place, -sign * _TOES_OUT, rockers)


def _root(standing: _Standing, splines: BSpline, time: Time) -> RootBasis:
    """Splines for the pelvis angles, ballistic ones for the horizontal path; the height is planned."""
    offset, acceleration = np.zeros((len(time), 6)), np.zeros((len(time), 3))
    offset[:, 4] = standing.height.height(time)
    acceleration[:, 1] = standing.height.acceleration(time)
    value, second, third = (_channels(standing, splines.derivative(k)(time)) for k in (0, 2, 3))
    return RootBasis(offset, acceleration, value, second, third)


def _channels(
    standing: _Standing, values: Float[Array, "frame coefficient"]
) -> Float[Array, "6 frame coefficient"]:
    ballistic = _ballistic(standing, values)
    return np.stack([values, values, values, ballistic, np.zeros_like(values), ballistic])
