"""The built-in synthetic subject in motion: coordinates, ground reactions and markers, all known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.errors import ConfigError, SolverError
from hilbrace.motion.synthetic.coefficients import stored_coefficients
from hilbrace.motion.synthetic.curves import time_derivative
from hilbrace.motion.synthetic.forces import FootForces, split_between_feet
from hilbrace.motion.synthetic.markers import synthetic_markers
from hilbrace.motion.synthetic.motions import motion
from hilbrace.motion.synthetic.plan import Motion, Plan, Plate
from hilbrace.motion.synthetic.solver import Solution, solve_poses
from hilbrace.motion.synthetic.wrench import BodyWrench, body_wrench
from hilbrace.skeleton.kinematics import Skeleton, skeleton_from_table
from hilbrace.skeleton.table import load_table
from hilbrace.units import GRAVITY

Array = np.ndarray

HEIGHT_M = 1.70
"""Height of the model's subject [m] (Rajagopal et al. 2016)."""

_STATIC_SECONDS = 1.0
_REACHED = 1e-8


@dataclass(frozen=True)
class StaticTrial:
    """The synthetic subject standing still in the model's neutral pose.

    Attributes:
        time: Instants [s].
        markers: Markers with noise [m].
        forces: Ground reactions.
        plates: Force plates, one per foot.
    """

    time: Float[Array, " frame"]
    markers: Float[Array, "frame marker 3"]
    forces: FootForces
    plates: tuple[Plate, ...]


@dataclass(frozen=True)
class SyntheticMotion:
    """A synthetic motion with everything about it that is true. It is not a measurement.

    Attributes:
        name: ``"serve"``, ``"gait"`` or ``"squat"``.
        time: Instants, from 0 [s].
        rate_hz: Frames per second [Hz].
        coordinates: True coordinates by OpenSim name [rad or m].
        forces: True ground reactions, right foot then left.
        com: Centre of mass [m].
        wrench: What the whole body needs of the ground; in flight it shows how nearly momentum is kept.
        marker_names: Names of the markers.
        true_markers: Markers without noise [m].
        markers: Markers with noise [m].
        noise_m: Standard deviation of the noise in each direction [m].
        seed: Seed of the noise.
        static: The standing trial.
        plates: Force plates.
        mass_kg: Mass of the subject [kg].
        height_m: Height of the subject [m].
    """

    name: str
    time: Float[Array, " frame"]
    rate_hz: float
    coordinates: dict[str, Float[Array, " frame"]]
    forces: FootForces
    com: Float[Array, "frame 3"]
    wrench: BodyWrench
    marker_names: tuple[str, ...]
    true_markers: Float[Array, "frame marker 3"]
    markers: Float[Array, "frame marker 3"]
    noise_m: float
    seed: int
    static: StaticTrial
    plates: tuple[Plate, ...]
    mass_kg: float
    height_m: float

    @property
    def static_markers(self) -> Float[Array, "marker 3"]:
        """Mean marker positions of the standing trial [m]."""
        return self.static.markers.mean(axis=0)


def generate(name: str, rate_hz: float = 200.0, noise_m: float = 0.0005, seed: int = 0) -> SyntheticMotion:
    """Generate a synthetic motion from its stored coefficients.

    Args:
        name: ``"serve"``, ``"gait"`` or ``"squat"``.
        rate_hz: Frames per second [Hz].
        noise_m: Standard deviation of the white noise on every marker coordinate [m].
        seed: Seed of the noise.

    Returns:
        The motion with its truth. Only white noise is added: no soft-tissue artefact is modelled.

    Raises:
        ConfigError: The motion is unknown, or rate or noise make no sense.
        SolverError: The stored coefficients do not fit this version's plan.
    """
    _check(rate_hz, noise_m)
    task = motion(name)
    skeleton = skeleton_from_table(load_table())
    plan, keep = _planned(task, rate_hz)
    solution, wrench = _moved(skeleton, task, plan, stored_coefficients(name))
    forces = split_between_feet(plan, wrench)
    random = np.random.default_rng(seed)
    marker_set = synthetic_markers(skeleton)
    exact = marker_set.positions(solution.pose)[keep]
    noisy = exact + random.normal(0.0, noise_m, exact.shape)
    still = _standing(skeleton, rate_hz)
    return SyntheticMotion(
        name=name,
        time=plan.time[keep] - plan.time[keep][0],
        rate_hz=rate_hz,
        coordinates={label: solution.coordinates[label][keep] for label in skeleton.coordinates},
        forces=FootForces(forces.force[keep], forces.centre_of_pressure[keep], forces.free_moment[keep]),
        com=wrench.com[keep],
        wrench=BodyWrench(
            wrench.force[keep], wrench.moment[keep], wrench.com[keep], wrench.angular_momentum[keep]
        ),
        marker_names=marker_set.names,
        true_markers=exact,
        markers=noisy,
        noise_m=noise_m,
        seed=seed,
        static=_noisy_static(still, random, noise_m),
        plates=tuple(_from_start(plate, task.start) for plate in task.plates),
        mass_kg=skeleton.mass,
        height_m=HEIGHT_M,
    )


def _check(rate_hz: float, noise_m: float) -> None:
    if not 50 <= rate_hz <= 2000:
        raise ConfigError(
            f"{rate_hz:g} Hz is no rate for a synthetic motion",
            where="motion.synthetic",
            hint="choose 50 to 2000 Hz",
        )
    if not 0 <= noise_m <= 0.05:
        raise ConfigError(
            f"{noise_m:g} m is no marker noise", where="motion.synthetic", hint="choose 0 to 0.05 m"
        )


def _planned(task: Motion, rate_hz: float) -> tuple[Plan, slice]:
    """The plan at the wanted rate, with a margin at both ends, and the slice without it."""
    pad = int(np.ceil(task.margin * rate_hz))
    count = int(np.floor((task.end - task.start) * rate_hz + 1e-9)) + 1
    time = task.start + np.arange(-pad, count + pad) / rate_hz
    return task.plan(time), slice(pad, pad + count)


def _moved(
    skeleton: Skeleton, task: Motion, plan: Plan, coefficients: Float[Array, "coefficient 6"]
) -> tuple[Solution, BodyWrench]:
    """Poses and whole-body reaction of stored coefficients."""
    solution = (
        solve_poses(skeleton, plan, plan.root.channels(coefficients))
        if coefficients.shape == task.reference.shape
        else None
    )
    if solution is None or solution.error > _REACHED:
        raise SolverError(
            "the stored coefficients do not fit the plan",
            where=f"synthetic motion '{task.name}'",
            hint=f"run python -m hilbrace.motion.synthetic.optimise {task.name}",
        )
    acceleration = plan.root.com_acceleration(coefficients)
    return solution, body_wrench(skeleton, solution.pose, acceleration, time_derivative(plan.time))


def _standing(skeleton: Skeleton, rate_hz: float) -> StaticTrial:
    """The neutral pose with the heels on the floor; the feet carry the weight below the centre of mass."""
    time = np.arange(round(_STATIC_SECONDS * rate_hz)) / rate_hz
    height = -float(skeleton.forward({})["calcn_r"].origin[0, 1])
    pose = skeleton.forward({"pelvis_ty": np.full(1, height)})
    com = skeleton.centre(pose)[0]
    sides = np.array([pose["calcn_r"].origin[0, 2], pose["calcn_l"].origin[0, 2]])
    right = (com[2] - sides[1]) / (sides[0] - sides[1])
    shares = np.array([right, 1 - right])
    force = np.zeros((len(time), 2, 3))
    force[:, :, 1] = shares * skeleton.mass * GRAVITY
    centres = np.zeros((len(time), 2, 3))
    centres[:, :, 0], centres[:, :, 2] = com[0], sides
    markers = np.repeat(synthetic_markers(skeleton).positions(pose), len(time), axis=0)
    end = float(time[-1])
    plates = (
        Plate("r", (0.0, 0.21), (0.3, 0.2), (0.0, end)),
        Plate("l", (0.0, -0.21), (0.3, 0.2), (0.0, end)),
    )
    return StaticTrial(time, markers, FootForces(force, centres, np.zeros((len(time), 2))), plates)


def _noisy_static(still: StaticTrial, random: np.random.Generator, noise_m: float) -> StaticTrial:
    markers = still.markers + random.normal(0.0, noise_m, still.markers.shape)
    return StaticTrial(still.time, markers, still.forces, still.plates)


def _from_start(plate: Plate, start: float) -> Plate:
    first, last = plate.interval
    return Plate(plate.foot, plate.centre, plate.half, (first - start, last - start))
