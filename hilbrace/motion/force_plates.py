"""Force plates: what each of them carried, checked, and summed up foot by foot.

Everywhere here a plate's load is a force, a point and a torque about that point. A foot may step on several
plates, or on one after the other: their wrenches are added, and the centre of pressure is the point of the
floor about which the sum has no horizontal moment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.errors import InputError
from hilbrace.motion.filters import lowpass

Array = np.ndarray

FEET = ("right", "left")
UP = 1
"""Index of the vertical axis in the OpenSim frame."""

DRIFT_N = 100.0
"""Largest force that a plate may show without a foot on it [N]."""

_AXES = "xyz"
_TINY_N = 1e-9
_FARTHEST_POINT_M = 100.0
_LONGEST_LEVER_M = 3.0


@dataclass(frozen=True)
class PlateForces:
    """The load on every force plate over time, as forces of the ground on the subject.

    Attributes:
        source: The file, for messages.
        names: The plates' names as settings use them, ``"1"``, ``"2"``, ...
        labels: How the file calls the force of each plate, for messages.
        time: Instants [s].
        rate_hz: Samples per second [Hz].
        force: Force [N].
        point: Point of application, or the plate's centre [m]; may be NaN while unloaded.
        torque: Torque about the point [N*m].
    """

    source: str
    names: tuple[str, ...]
    labels: tuple[str, ...]
    time: Float[Array, " sample"]
    rate_hz: float
    force: Float[Array, "sample plate 3"]
    point: Float[Array, "sample plate 3"]
    torque: Float[Array, "sample plate 3"]


@dataclass(frozen=True)
class FootForces:
    """The ground's load on each foot; zero while the foot is unloaded.

    Attributes:
        force: Force [N].
        centre_of_pressure: Point of the floor where it acts [m].
        free_torque: Torque about that point [N*m].
    """

    force: Float[Array, "frame foot 3"]
    centre_of_pressure: Float[Array, "frame foot 3"]
    free_torque: Float[Array, "frame foot 3"]


def unload(plates: PlateForces, threshold_n: float) -> PlateForces:
    """Set force, point and torque to zero wherever a plate carries less than the threshold.

    The centre of pressure of an unloaded plate is a ratio of noise (files hold values of hundreds of metres,
    or NaN); under load it must be a number.

    Args:
        plates: Loads in the OpenSim frame.
        threshold_n: Vertical force below which a plate is unloaded [N].

    Raises:
        InputError: A force is NaN, or a point or torque is NaN under load.
    """
    _refuse_nan(plates, plates.force, np.ones(plates.force.shape[:2], bool), "force")
    loaded = plates.force[:, :, UP] >= max(threshold_n, _TINY_N)
    _refuse_nan(plates, plates.point, loaded, "centre of pressure")
    _refuse_nan(plates, plates.torque, loaded, "torque")
    keep = loaded[:, :, None]
    return replace(
        plates,
        force=np.where(keep, plates.force, 0.0),
        point=np.where(keep, plates.point, 0.0),
        torque=np.where(keep, plates.torque, 0.0),
    )


def check_columns(plates: PlateForces, threshold_n: float) -> None:
    """Refuse loads whose components cannot be what they are called.

    Args:
        plates: Loads in the OpenSim frame, before `unload`.
        threshold_n: Force below which a plate is unloaded [N].

    Raises:
        InputError: The largest component is not the vertical one, forces pull the subject down, points are
            farther than 100 m off, or torques have levers of more than 3 m.
    """
    for k, (name, label) in enumerate(zip(plates.names, plates.labels, strict=True)):
        force = np.nan_to_num(plates.force[:, k])
        size = np.linalg.norm(force, axis=1)
        loaded = size > max(threshold_n, 0.05 * size.max(initial=0.0))
        if size.max(initial=0.0) < max(threshold_n, DRIFT_N):
            continue
        where = f"{plates.source}, plate {name} ({label})"
        mean = force[loaded].mean(axis=0)
        largest = int(np.abs(mean).argmax())
        if largest != UP:
            raise InputError(
                f"forces in the wrong columns: the largest is along {_AXES[largest]}, "
                f"{abs(mean[largest]):.0f} N on average against {abs(mean[UP]):.0f} N along y",
                where=where,
                hint="put the vertical force under y: rename columns, or set motion.vertical_axis = 'z'",
            )
        if mean[UP] < 0:
            raise InputError(
                f"the ground pulls the subject down with {-mean[UP]:.0f} N on average",
                where=where,
                hint="store the force of the ground on the subject: change the sign of forces and torques",
            )
        _check_levers(plates, k, loaded & (force[:, UP] >= threshold_n), where)


def _check_levers(plates: PlateForces, k: int, loaded: Bool[Array, " sample"], where: str) -> None:
    point, torque = plates.point[loaded, k], plates.torque[loaded, k]
    vertical = plates.force[loaded, k, UP]
    if not len(vertical):
        return
    distance = np.nanmax(np.abs(np.nan_to_num(point)))
    if distance > _FARTHEST_POINT_M:
        raise InputError(
            f"points of application are up to {distance:.0f} m off",
            where=where,
            hint="write them in metres (these look like millimetres), and torques in N*m",
        )
    lever = float(np.median(np.linalg.norm(np.nan_to_num(torque), axis=1) / vertical))
    if lever > _LONGEST_LEVER_M:
        raise InputError(
            f"torques have a lever of {lever:.1f} m",
            where=where,
            hint="write them in N*m (these look like N*mm)",
        )


def foot_forces(
    plates: PlateForces,
    owner: Int[Array, "sample plate"],
    time: Float[Array, " frame"],
    cutoff_hz: float,
    threshold_n: float,
) -> FootForces:
    """Sum the plates under each foot, filter, and sample at the markers' instants.

    The wrenches (and not the centres of pressure, which are ratios) are filtered, with the markers' cut-off,
    so that forces and accelerations of the same movement stay consistent.

    Args:
        plates: Loads after `unload`.
        owner: Index into `FEET` of the foot on the plate; -1 for none.
        time: The markers' instants [s].
        cutoff_hz: Cut-off of the low-pass filter [Hz].
        threshold_n: Vertical force below which a foot is unloaded [N].
    """
    shape = (len(time), len(FEET), 3)
    force, centre, torque = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for foot in range(len(FEET)):
        channels = lowpass(_wrench(plates, owner == foot), plates.rate_hz, cutoff_hz)
        sampled = np.column_stack([np.interp(time, plates.time, channel) for channel in channels.T])
        force[:, foot], centre[:, foot], torque[:, foot] = _reduce(sampled, threshold_n)
    return FootForces(force, centre, torque)


def _wrench(plates: PlateForces, on: Bool[Array, "sample plate"]) -> Float[Array, "sample 7"]:
    """Force, moment about the origin, and vertical force times height of the surface."""
    force = plates.force * on[:, :, None]
    moment = np.cross(plates.point, force) + plates.torque * on[:, :, None]
    height = (force[:, :, UP] * plates.point[:, :, UP]).sum(axis=1)
    return np.column_stack([force.sum(axis=1), moment.sum(axis=1), height])


def _reduce(
    wrench: Float[Array, "frame 7"], threshold_n: float
) -> tuple[Float[Array, "frame 3"], Float[Array, "frame 3"], Float[Array, "frame 3"]]:
    """Force, centre of pressure and free torque of a wrench about the origin."""
    loaded = wrench[:, UP] >= max(threshold_n, _TINY_N)
    force = np.where(loaded[:, None], wrench[:, :3], 0.0)
    moment = np.where(loaded[:, None], wrench[:, 3:6], 0.0)
    vertical = np.where(loaded, wrench[:, UP], 1.0)
    height = np.where(loaded, wrench[:, 6], 0.0) / vertical
    x = (moment[:, 2] + height * force[:, 0]) / vertical
    z = (height * force[:, 2] - moment[:, 0]) / vertical
    twist = moment[:, 1] - (z * force[:, 0] - x * force[:, 2])
    still = np.zeros_like(twist)
    return force, np.column_stack([x, height, z]), np.column_stack([still, twist, still])


def total_vertical(plates: PlateForces) -> Float[Array, " sample"]:
    """Vertical force on all plates together [N]."""
    return plates.force[:, :, UP].sum(axis=1)


def _refuse_nan(
    plates: PlateForces,
    values: Float[Array, "sample plate 3"],
    needed: Bool[Array, "sample plate"],
    what: str,
) -> None:
    missing = needed & ~np.isfinite(values).all(axis=2)
    if missing.any():
        row, k = (int(i) for i in np.argwhere(missing)[0])
        raise InputError(
            f"the {what} is no number under a load of {plates.force[row, k, UP]:.0f} N"
            if what != "force"
            else "a force is no number",
            where=f"{plates.source}, sample {row + 1} ({plates.time[row]:.4f} s), plate {plates.names[k]}",
            hint="export the forces again; unloaded samples may be NaN, loaded ones may not",
        )
