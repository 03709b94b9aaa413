"""The pose of every frame: feet on their paths, centre of mass where the plan has it.

Six angles of each leg answer to the six conditions of its foot (Newton's method); the pelvis moves until
the centre of mass is in place. All frames are solved at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.motion.synthetic.plan import Plan
from hilbrace.skeleton.kinematics import Pose, Skeleton

Array = np.ndarray

LEG_ANGLES = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle", "subtalar_angle")
_PELVIS_ANGLES = ("pelvis_tilt", "pelvis_list", "pelvis_rotation")
_PELVIS_PLACE = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
_ROTATION_WEIGHT = 0.3
_LARGEST_STEP = 0.3
_LEAST_FLEXION = 0.02
_OVERSHOOT = 1.2
_PROBE = 1e-5


@dataclass(frozen=True)
class Solution:
    """A solved pose of every frame.

    Attributes:
        coordinates: All coordinates of the model by name [rad or m].
        pose: Frames of the bodies.
        inverses: Inverse Jacobian of each leg, which starts the next solution.
        error: Largest distance from the conditions [m, rad].
        iterations: Steps taken.
    """

    coordinates: dict[str, Float[Array, " frame"]]
    pose: Pose
    inverses: dict[str, Float[Array, "frame 6 6"]]
    error: float
    iterations: int


def solve_poses(
    skeleton: Skeleton,
    plan: Plan,
    channels: Float[Array, "frame 6"],
    start: Solution | None = None,
    iterations: int = 60,
    tolerance: float = 1e-11,
) -> Solution:
    """Find the poses that keep the feet on their paths and the centre of mass in its place.

    Args:
        skeleton: The model.
        plan: Prescribed feet and posture.
        channels: Pelvis angles [rad] and centre of mass [m].
        start: A solution nearby; its Jacobians are used again.
        iterations: Most steps to take.
        tolerance: Error at which to stop [m, rad].

    Returns:
        The solution, with its error: the caller decides what is good enough.
    """
    q = _first_guess(skeleton, plan, channels) if start is None else dict(start.coordinates)
    inverses = {} if start is None else start.inverses
    for k, name in enumerate(_PELVIS_ANGLES):
        q[name] = channels[:, k]
    previous, iteration = 0.0, 0
    while True:
        pose = skeleton.forward(q)
        lack = channels[:, 3:] - skeleton.centre(pose)
        misses = {side: foot_miss(plan, pose, side) for side in plan.feet}
        error = max(np.abs(lack).max(), *(np.abs(miss).max() for miss in misses.values()))
        if not inverses or (start is None and iteration < 8) or (iteration % 3 == 2 and previous > 1e-4):
            inverses = {side: _inverse_jacobian(skeleton, plan, q, pose, side) for side in plan.feet}
        previous = error
        if error < tolerance or iteration == iterations:
            return Solution(q, pose, inverses, float(error), iteration)
        _step(skeleton, plan, q, pose, lack, inverses)
        iteration += 1


def refresh(skeleton: Skeleton, plan: Plan, solution: Solution) -> Solution:
    """The same solution with Jacobians taken at its own poses."""
    inverses = {
        side: _inverse_jacobian(skeleton, plan, solution.coordinates, solution.pose, side)
        for side in plan.feet
    }
    return Solution(solution.coordinates, solution.pose, inverses, solution.error, solution.iterations)


def foot_miss(plan: Plan, pose: Pose, side: str) -> Float[Array, "frame 6"]:
    """How far a foot is from its path: place [m] and weighted rotation [rad]."""
    path, foot = plan.feet[side], pose[f"calcn_{side}"]
    turn = rotation_vector(foot.rotation @ path.rotation.transpose(0, 2, 1))
    return np.concatenate([foot.origin - path.origin, _ROTATION_WEIGHT * turn], axis=1)


def rotation_vector(rotation: Float[Array, "frame 3 3"]) -> Float[Array, "frame 3"]:
    """Axis times angle [rad] of rotations below half a turn."""
    skew = rotation - rotation.transpose(0, 2, 1)
    axis = 0.5 * np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    sine = np.linalg.norm(axis, axis=1)
    cosine = 0.5 * (np.trace(rotation, axis1=1, axis2=2) - 1)
    return axis * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))[:, None]


def _first_guess(
    skeleton: Skeleton, plan: Plan, channels: Float[Array, "frame 6"]
) -> dict[str, Float[Array, " frame"]]:
    """Bent legs below an upright trunk."""
    q = {name: np.zeros(len(plan.time)) for name in skeleton.coordinates}
    q.update(plan.posture)
    bent = {"hip_flexion": 0.3, "knee_angle": 0.6, "ankle_angle": 0.3}
    for side in plan.feet:
        q.update({f"{name}_{side}": np.full(len(plan.time), angle) for name, angle in bent.items()})
    for k, name in enumerate(_PELVIS_PLACE):
        q[name] = channels[:, 3 + k] + (0.08, 0.01, 0.0)[k]
    return q


def _step(
    skeleton: Skeleton,
    plan: Plan,
    q: dict[str, Float[Array, " frame"]],
    pose: Pose,
    lack: Float[Array, "frame 3"],
    inverses: dict[str, Float[Array, "frame 6 6"]],
) -> None:
    """Move the pelvis by what the centre of mass lacks, then bring the feet back; ``q`` is changed."""
    shift = _OVERSHOOT * lack
    for k, name in enumerate(_PELVIS_PLACE):
        q[name] = q[name] + shift[:, k]
    pelvis = pose["pelvis"]
    moved = {"pelvis": pelvis._replace(origin=pelvis.origin + shift)}
    for side in plan.feet:
        for _ in range(2):
            miss = foot_miss(plan, skeleton.leg(q, side, moved), side)
            turn = -np.einsum("tij,tj->ti", inverses[side], miss)
            turn = np.clip(turn, -_LARGEST_STEP, _LARGEST_STEP)
            for k, name in enumerate(LEG_ANGLES):
                q[f"{name}_{side}"] = q[f"{name}_{side}"] + turn[:, k]
            q[f"knee_angle_{side}"] = np.maximum(q[f"knee_angle_{side}"], _LEAST_FLEXION)
        q[f"knee_angle_{side}_beta"] = q[f"knee_angle_{side}"]


def _inverse_jacobian(
    skeleton: Skeleton, plan: Plan, q: dict[str, Float[Array, " frame"]], pose: Pose, side: str
) -> Float[Array, "frame 6 6"]:
    """Inverse of d(foot_miss)/d(leg angles), by forward differences, damped where the leg is straight."""
    base = foot_miss(plan, pose, side)
    above = {"pelvis": pose["pelvis"]}
    jacobian = np.empty((len(base), 6, 6))
    for k, name in enumerate(LEG_ANGLES):
        label = f"{name}_{side}"
        probed = skeleton.leg({**q, label: q[label] + _PROBE}, side, above)
        jacobian[:, :, k] = (foot_miss(plan, probed, side) - base) / _PROBE
    transposed = jacobian.transpose(0, 2, 1)
    return np.linalg.solve(transposed @ jacobian + 1e-9 * np.eye(6), transposed)
