"""Find the pelvis angles and the path of the centre of mass for which the ground reaction can exist.

Run once per motion; the coefficients are stored beside this module and only evaluated afterwards::

    python -m hilbrace.motion.synthetic.optimise serve

From the reference the gait ends within a fifth of its stored cost (40 iterations) and the serve at 1.7 times;
both were lowered to what is stored by starting again from there (``--warm``).

Least squares by Levenberg and Marquardt's method. What counts is a moment that the ground can supply: none in
flight; in stance one whose centre of pressure lies in the feet, with friction inside its cone.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import SolverError
from hilbrace.motion.synthetic.coefficients import store_coefficients, stored_coefficients
from hilbrace.motion.synthetic.curves import time_derivative
from hilbrace.motion.synthetic.motions import MOTIONS, motion
from hilbrace.motion.synthetic.plan import Motion, Plan
from hilbrace.motion.synthetic.solver import LEG_ANGLES, Solution, refresh, solve_poses
from hilbrace.motion.synthetic.wrench import BodyWrench, body_wrench
from hilbrace.skeleton.kinematics import Skeleton, skeleton_from_table
from hilbrace.skeleton.table import coordinate_ranges, load_table
from hilbrace.units import DEG, GRAVITY

Array = np.ndarray
_LOG = logging.getLogger(__name__)

_STEP = 0.01
_TOLERANCE = 2e-4
_FIRM_CONTACT = 50.0
_PROBE = 1e-5
_RANGE_MARGIN = 3 * DEG
_RANGE_WEIGHT = 200.0
_FLIGHT_WEIGHT = 3.0


@dataclass(frozen=True)
class Problem:
    """One motion on the optimiser's grid.

    Attributes:
        motion: What is optimised.
        plan: The plan at the grid's instants.
        skeleton: The model.
        derivative: Differentiation on the grid [1/s].
        counted: Frames that count; the others only keep edges away.
        ranges: Lowest and highest angle of the leg's joints, `LEG_ANGLES` of each side [rad].
    """

    motion: Motion
    plan: Plan
    skeleton: Skeleton
    derivative: Float[Array, "frame frame"]
    counted: slice
    ranges: Float[Array, "12 2"]


@dataclass(frozen=True)
class Evaluation:
    """Residuals of one set of coefficients.

    Attributes:
        residual: All residuals, block after block.
        parts: Root mean square of each block by name.
        wrench: What the ground must supply.
        solution: Poses.
    """

    residual: Float[Array, " residual"]
    parts: dict[str, float]
    wrench: BodyWrench
    solution: Solution


def problem(name: str) -> Problem:
    """Set up the optimiser's problem of a motion.

    Raises:
        ConfigError: There is no such motion.
    """
    task = motion(name)
    table = load_table()
    first, last = task.optimise_over
    pad = round(task.margin / _STEP)
    count = round((last - first) / _STEP)
    time = first + _STEP * np.arange(-pad, count + pad + 1)
    limits = {item.name: (item.low, item.high) for item in coordinate_ranges(table)}
    ranges = np.array([limits[f"{angle}_{side}"] for side in "rl" for angle in LEG_ANGLES])
    # a periodic motion counts its first frame once
    counted = slice(pad, pad + count + (0 if pad else 1))
    return Problem(task, task.plan(time), skeleton_from_table(table), time_derivative(time), counted, ranges)


def evaluate(
    task: Problem,
    coefficients: Float[Array, "coefficient 6"],
    start: Solution | None,
    iterations: int = 60,
) -> Evaluation:
    """Residuals of a set of coefficients.

    Args:
        task: The problem.
        coefficients: Of the root's channels.
        start: Poses nearby.
        iterations: Most steps of the pose solver.
    """
    plan = task.plan
    channels = plan.root.channels(coefficients)
    solution = solve_poses(task.skeleton, plan, channels, start, iterations, 1e-9)
    wrench = body_wrench(
        task.skeleton, solution.pose, plan.root.com_acceleration(coefficients), task.derivative
    )
    blocks = _ground_residuals(task, wrench)
    blocks.update(_posture_residuals(task, solution))
    change = coefficients - task.motion.reference
    blocks["track"] = np.einsum("ctn,nc->tc", plan.root.value, change) * task.motion.effort.track
    blocks["smooth"] = np.einsum("ctn,nc->tc", plan.root.third, coefficients) * task.motion.effort.smooth
    kept = {name: block[task.counted] for name, block in blocks.items()}
    parts = {name: float(np.sqrt(np.mean(block**2))) for name, block in kept.items()}
    return Evaluation(np.concatenate([block.ravel() for block in kept.values()]), parts, wrench, solution)


def optimise(
    task: Problem, start: Float[Array, "coefficient 6"] | None = None, iterations: int = 20
) -> Float[Array, "coefficient 6"]:
    """Coefficients for which the ground reaction can exist.

    Args:
        task: The problem.
        start: Coefficients to start from; the motion's reference if left out.
        iterations: Most steps.

    Raises:
        SolverError: The feet cannot be reached from the first coefficients.
    """
    coefficients = (task.motion.reference if start is None else start).copy()
    current = evaluate(task, coefficients, None)
    if current.solution.error > 1e-6:
        raise SolverError(
            f"the feet miss their paths by {current.solution.error:.2g} m",
            where=f"synthetic motion '{task.motion.name}'",
            hint="start from coefficients with a lower centre of mass",
        )
    damping = 1e-3
    for iteration in range(iterations):
        cost = float(current.residual @ current.residual)
        _LOG.info("%d cost %.5g %s", iteration, cost, _format(current.parts))
        slopes = _jacobian(task, coefficients, current)
        found = _damped_step(task, coefficients, current, slopes, damping)
        if found is None:
            break
        coefficients, current, damping = found
        if cost - float(current.residual @ current.residual) < _TOLERANCE * cost:
            break
    _LOG.info("end cost %.5g %s", float(current.residual @ current.residual), _format(current.parts))
    return coefficients


def main(arguments: Sequence[str] | None = None) -> int:
    """Optimise one motion and store its coefficients."""
    parser = argparse.ArgumentParser(
        prog="python -m hilbrace.motion.synthetic.optimise",
        description=main.__doc__,
        epilog="example: python -m hilbrace.motion.synthetic.optimise serve --warm",
    )
    parser.add_argument("motion", choices=sorted(MOTIONS))
    parser.add_argument("--warm", action="store_true", help="start from the stored coefficients")
    parser.add_argument("--iterations", type=int, default=20, help="most steps (20)")
    parser.add_argument("--out", type=Path, default=None, help="file to write (default: the package's own)")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    start = stored_coefficients(options.motion) if options.warm else None
    found = optimise(problem(options.motion), start, options.iterations)
    store_coefficients(options.motion, found, options.out)
    return 0


def _ground_residuals(task: Problem, wrench: BodyWrench) -> dict[str, Float[Array, "frame _"]]:
    """What the ground cannot supply, or should not."""
    plan, effort = task.plan, task.motion.effort
    vertical = np.maximum(wrench.force[:, 1:2], 0.0)
    horizontal = wrench.force[:, [0, 2]]
    tipping = np.stack([wrench.moment[:, 2], -wrench.moment[:, 0]], axis=1)
    offset = tipping - plan.cop_target * vertical
    pressure = tipping / np.maximum(vertical, _FIRM_CONTACT)
    yaw = wrench.moment[:, 1:2] - (pressure[:, 1:] * horizontal[:, :1] - pressure[:, :1] * horizontal[:, 1:])
    airborne = plan.airborne[:, None]
    least, most = (share * task.skeleton.mass * GRAVITY for share in effort.load)
    return {
        "reach": np.where(airborne, _FLIGHT_WEIGHT, 1.0) * _beyond(offset, plan.cop_reach * vertical),
        "centre": effort.centre * offset,
        "slip": 2.0 * _beyond(horizontal, effort.friction * vertical),
        "load": 0.1 * (wrench.force[:, 1:2] - np.clip(wrench.force[:, 1:2], least, most)),
        "yaw": np.where(airborne, _FLIGHT_WEIGHT * wrench.moment[:, 1:2], effort.yaw * yaw),
    }


def _posture_residuals(task: Problem, solution: Solution) -> dict[str, Float[Array, "frame _"]]:
    """Leg angles outside the model's ranges, and knees bent more than wished."""
    angles = np.stack(
        [solution.coordinates[f"{angle}_{side}"] for side in "rl" for angle in LEG_ANGLES], axis=1
    )
    low, high = task.ranges[:, 0] + _RANGE_MARGIN, task.ranges[:, 1] - _RANGE_MARGIN
    knees = angles[:, [3, 9]] - task.plan.knee_ceiling
    return {
        "range": _RANGE_WEIGHT * (angles - np.clip(angles, low, high)),
        "knee": task.motion.effort.knee * np.maximum(knees, 0.0),
    }


def _beyond(value: Array, reach: Array) -> Array:
    """The part of a value outside -reach .. reach."""
    return value - np.clip(value, -reach, reach)


def _damped_step(
    task: Problem,
    coefficients: Float[Array, "coefficient 6"],
    current: Evaluation,
    slopes: Float[Array, "residual unknown"],
    damping: float,
) -> tuple[Float[Array, "coefficient 6"], Evaluation, float] | None:
    """The first step of Levenberg and Marquardt that lowers the cost, or ``None``."""
    normal, gradient = slopes.T @ slopes, slopes.T @ current.residual
    scale = np.diag(np.diag(normal) + 1e-9)
    cost = current.residual @ current.residual
    for _ in range(8):
        trial = coefficients.copy()
        trial[task.motion.free] -= np.linalg.solve(normal + damping * scale, gradient)
        there = evaluate(task, trial, current.solution)
        if there.solution.error < 1e-6 and there.residual @ there.residual < cost:
            return trial, there, max(0.1 * damping, 1e-9)
        damping = max(10 * damping, 1e-6)
    return None


def _jacobian(
    task: Problem, coefficients: Float[Array, "coefficient 6"], current: Evaluation
) -> Float[Array, "residual unknown"]:
    """Slopes of the residuals by forward differences; coefficients with distant supports share one probe."""
    start = refresh(task.skeleton, task.plan, current.solution)
    base = evaluate(task, coefficients, start, 12).residual
    unknowns = np.argwhere(task.motion.free)
    frames = _residual_frames(task, len(base))
    slopes = np.zeros((len(base), len(unknowns)))
    for group in _groups(task, unknowns):
        probe = coefficients.copy()
        for k in group:
            probe[tuple(unknowns[k])] += _PROBE
        change = (evaluate(task, probe, start, 12).residual - base) / _PROBE
        for k in group:
            first, last = _support(task, unknowns[k])
            near = (frames >= first) & (frames <= last)
            slopes[near, k] = change[near]
    return slopes


def _residual_frames(task: Problem, size: int) -> Int[Array, " residual"]:
    """The frame of the grid to which each residual belongs, in the order of `evaluate`."""
    index = np.arange(len(task.plan.time))[task.counted]
    widths = (2, 2, 2, 1, 1, 12, 2, 6, 6)
    frames = np.concatenate([np.repeat(index, width) for width in widths])
    if len(frames) != size:
        raise SolverError("residual blocks changed", where="optimiser", hint="adapt the widths of the blocks")
    return frames


def _support(task: Problem, unknown: Int[Array, " 2"]) -> tuple[int, int]:
    """First and last frame that a coefficient acts on, with some room for the differentiation."""
    touched = np.flatnonzero(np.abs(task.plan.root.value[unknown[1], :, unknown[0]]) > 1e-12)
    room = max(8, int(touched[-1] - touched[0]) // 4)
    return int(touched[0]) - room, int(touched[-1]) + room


def _groups(task: Problem, unknowns: Int[Array, "unknown 2"]) -> list[list[int]]:
    """Unknowns gathered so that no two of a group act on the same frame."""
    supports = [_support(task, unknown) for unknown in unknowns]
    groups: list[list[int]] = []
    ends: list[int] = []
    for k in sorted(range(len(unknowns)), key=lambda k: supports[k]):
        first, last = supports[k]
        open_groups = [g for g, end in enumerate(ends) if end < first]
        if open_groups:
            groups[open_groups[0]].append(k)
            ends[open_groups[0]] = last
        else:
            groups.append([k])
            ends.append(last)
    return groups


def _format(parts: dict[str, float]) -> str:
    return " ".join(f"{name} {value:.3g}" for name, value in parts.items())


if __name__ == "__main__":
    raise SystemExit(main())
