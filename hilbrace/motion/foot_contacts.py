"""Which foot stands on which force plate, contact by contact."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.filters import gap_free_runs
from hilbrace.motion.force_plates import DRIFT_N, FEET, UP, PlateForces

Array = np.ndarray

REACH_M = 0.20
"""Farthest that a foot's centre of pressure lies from its markers and the points midway between them."""

MARGIN_M = 0.03
"""By how much one foot must be nearer than the other for a contact to be its own."""

MERGE_SECONDS = 0.05
"""Contacts of a plate that are closer in time than this are one contact."""

NAMED = 3
"""Most contacts of one plate that a note describes."""

NOBODY = -1


def assign_contacts(
    plates: PlateForces,
    time: Float[Array, " frame"],
    feet: dict[str, Float[Array, "frame marker 3"]],
    given: Mapping[str, str],
    named: Mapping[str, str] | None = None,
) -> tuple[Int[Array, "sample plate"], tuple[str, ...]]:
    """Foot on each plate at each sample.

    With ``given`` every plate that carries load must be named there, and a plate under the other foot than
    the one given is refused. Without it every contact goes to the foot whose markers are nearest to the
    centre of pressure, so that a walker may meet the plates in any order. What a file calls a plate counts
    only where the markers do not tell.

    Args:
        plates: Loads after `hilbrace.motion.force_plates.unload`.
        time: The markers' instants; contacts outside are left out [s].
        feet: Markers on each foot by ``"right"`` and ``"left"`` [m]; no markers where unknown.
        given: Foot, or ``"unused"``, by plate name, as the user says; may be empty.
        named: Foot by plate name, as the file says (`feet_by_name`).

    Returns:
        Index into `FEET` or -1, and what the reader should know.

    Raises:
        ConfigError: ``given`` names a plate that is not there, or leaves out one that carries load.
        InputError: A contact is under neither foot, or under both.
    """
    _check_given(plates, given)
    owner = np.full(plates.force.shape[:2], NOBODY)
    stray: dict[str, float] = {}
    found: dict[str, list[str]] = {}
    named = named or {}
    nearby = {foot: _with_midpoints(markers) for foot, markers in feet.items()}
    for k, plate in enumerate(plates.names):
        for contact in _contacts(plates, k, time):
            distance = _distances(plates, k, contact, time, nearby)
            where = (
                f"{plates.source}, plate {plate}, "
                f"{plates.time[contact.start]:.2f} to {plates.time[contact.stop - 1]:.2f} s"
            )
            if given:
                foot = _confirm(given[plate], distance, plate, where)
            elif _is_stray(plates, k, contact, distance):
                foot = NOBODY
                stray[plate] = max(stray.get(plate, 0.0), float(plates.force[contact, k, UP].max()))
            elif plate in named and not _is_clear(distance):
                foot = FEET.index(named[plate])
            else:
                foot = _nearest(distance, plate, where)
            owner[contact, k] = foot
            if foot != NOBODY:
                found.setdefault(plate, []).append(_told(plates, k, contact, foot, distance, named))
    notes = [f"Plate {p}: {'; '.join(_shortened(told))}." for p, told in found.items()]
    notes += [f"Plate {p} shows up to {n:.0f} N with no foot near it: left out." for p, n in stray.items()]
    return owner, tuple(notes)


def _told(
    plates: PlateForces,
    k: int,
    contact: slice,
    foot: int,
    distance: Float[Array, " foot"],
    named: Mapping[str, str],
) -> str:
    """Which foot, when, how hard, and how far its markers are from the centre of pressure."""
    far = "" if np.isnan(distance[foot]) else f", {100 * distance[foot]:.0f} cm from its markers"
    said = named.get(plates.names[k], FEET[foot])
    against = "" if said == FEET[foot] else f", though the file says {said}"
    return (
        f"{FEET[foot]} foot {plates.time[contact.start]:.2f} to {plates.time[contact.stop - 1]:.2f} s, up to "
        f"{plates.force[contact, k, UP].max():.0f} N{far}{against}"
    )


def _shortened(told: list[str]) -> list[str]:
    return told if len(told) <= NAMED else [*told[:NAMED], f"and {len(told) - NAMED} more contacts"]


def _is_clear(distance: Float[Array, " foot"]) -> bool:
    """Whether the markers tell which foot it is."""
    near, far = np.sort(distance)
    return bool(near <= REACH_M and not far < near + MARGIN_M)


def feet_by_name(plates: PlateForces) -> dict[str, str]:
    """Feet of the plates that are called r, l, right or left.

    Args:
        plates: Loads of the plates.
    """
    feet = {"r": "right", "right": "right", "l": "left", "left": "left"}
    return {plate: feet[plate.lower()] for plate in plates.names if plate.lower() in feet}


def _check_given(plates: PlateForces, given: Mapping[str, str]) -> None:
    unknown = [plate for plate in given if plate not in plates.names]
    if unknown:
        raise ConfigError(
            f"motion.plates names plate '{unknown[0]}', which is not there",
            where=plates.source,
            hint=f"the plates are {', '.join(plates.names)}",
        )
    missing = [p for k, p in enumerate(plates.names) if p not in given and plates.force[:, k, UP].any()]
    if given and missing:
        raise ConfigError(
            f"motion.plates says nothing about plate '{missing[0]}', which carries load",
            where=plates.source,
            hint=f"add {missing[0]} = 'right', 'left' or 'unused'",
        )


def _contacts(plates: PlateForces, k: int, time: Float[Array, " frame"]) -> list[slice]:
    """Runs of samples under load that overlap the markers' time; short breaks do not end a run."""
    loaded = plates.force[:, k, UP] > 0
    runs = gap_free_runs(np.where(loaded, 1.0, np.nan))
    merged: list[slice] = []
    for run in runs:
        if merged and (run.start - merged[-1].stop) / plates.rate_hz < MERGE_SECONDS:
            merged[-1] = slice(merged[-1].start, run.stop)
        else:
            merged.append(run)
    return [r for r in merged if plates.time[r.stop - 1] >= time[0] and plates.time[r.start] <= time[-1]]


def _with_midpoints(markers: Float[Array, "frame marker 3"]) -> Float[Array, "frame point 3"]:
    middles = [(markers[:, a] + markers[:, b]) / 2 for a, b in combinations(range(markers.shape[1]), 2)]
    return np.concatenate([markers, *[middle[:, None] for middle in middles]], axis=1)


def _distances(
    plates: PlateForces,
    k: int,
    contact: slice,
    time: Float[Array, " frame"],
    nearby: dict[str, Float[Array, "frame point 3"]],
) -> Float[Array, " foot"]:
    """Mean distance of a contact's centre of pressure from each foot, by force [m]; NaN if unknown."""
    rows = np.arange(contact.start, contact.stop)
    rows = rows[
        (plates.time[rows] >= time[0]) & (plates.time[rows] <= time[-1]) & (plates.force[rows, k, UP] > 0)
    ]
    rows = rows[:: max(1, len(rows) // 200)]
    frames = np.searchsorted(time, plates.time[rows]).clip(0, len(time) - 1)
    weight = plates.force[rows, k, UP]
    centre = _centre_of_pressure(plates.point[rows, k], plates.force[rows, k], plates.torque[rows, k])
    found = np.full(len(FEET), np.nan)
    for index, foot in enumerate(FEET):
        points = nearby.get(foot)
        if points is None or points.shape[1] == 0 or not len(rows):
            continue
        gap = np.linalg.norm(points[frames] - centre[:, None], axis=2)
        nearest = np.where(np.isnan(gap), np.inf, gap).min(axis=1)
        seen = np.isfinite(nearest)
        if seen.any():
            found[index] = np.average(nearest[seen], weights=weight[seen])
    return found


def _centre_of_pressure(
    point: Float[Array, "row 3"], force: Float[Array, "row 3"], torque: Float[Array, "row 3"]
) -> Float[Array, "row 3"]:
    """Point of the horizontal plane through ``point`` about which there is no horizontal moment."""
    shift = np.column_stack([torque[:, 2], 0 * torque[:, 1], -torque[:, 0]]) / force[:, [UP]]
    return point + shift


def _confirm(foot: str, distance: Float[Array, " foot"], plate: str, where: str) -> int:
    if foot == "unused":
        return NOBODY
    index = FEET.index(foot)
    own, other = distance[index], distance[1 - index]
    if np.isfinite(own) and np.isfinite(other) and own > other + max(MARGIN_M, 0.1):
        raise InputError(
            f"plate {plate} is given as the {foot} foot's, but its centre of pressure is "
            f"{100 * own:.0f} cm from that foot and {100 * other:.0f} cm from the other",
            where=where,
            hint="swap the feet in motion.plates, or leave it out to have plates found from the markers",
        )
    return index


def _is_stray(plates: PlateForces, k: int, contact: slice, distance: Float[Array, " foot"]) -> bool:
    far: Bool[Array, " foot"] = ~(distance <= REACH_M)
    return bool(far.all()) and float(plates.force[contact, k, UP].max()) < DRIFT_N


def _nearest(distance: Float[Array, " foot"], plate: str, where: str) -> int:
    settle = "say so with motion.plates, e.g. {1 = 'right', 2 = 'left'}, or choose another motion.window"
    if np.isnan(distance).all():
        raise InputError(f"no foot markers tell which foot is on plate {plate}", where=where, hint=settle)
    order = np.argsort(distance)
    nearest = int(order[0])
    if distance[nearest] > REACH_M:
        raise InputError(
            f"plate {plate} carries load, but the nearest foot is {100 * distance[nearest]:.0f} cm off",
            where=where,
            hint=f"check the axes and units of forces and markers; if it is not the subject's load, {settle}",
        )
    if distance[int(order[1])] < distance[nearest] + MARGIN_M:
        raise InputError(
            f"both feet are on plate {plate} ({100 * distance[0]:.0f} and {100 * distance[1]:.0f} cm "
            "from its centre of pressure)",
            where=where,
            hint=f"one plate cannot tell two feet apart: {settle}",
        )
    return nearest
