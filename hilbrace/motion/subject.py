"""The subject's mass and height, from the recording where the user does not give them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import MarkerMap, file_name_of
from hilbrace.units import GRAVITY

Array = np.ndarray

MASS_TOLERANCE = 0.15
"""Largest difference between the mass given and the one weighed, as a fraction."""

LEAST_WEIGHT_N = 150.0
"""A smaller mean force is not a person standing on the plates."""

STEADY = 0.05
"""Largest standard deviation of the vertical force of a person standing still, as a fraction of the mean."""

ACROMION_HEIGHT = 0.818
"""Height of the acromion over height of the body (Drillis & Contini 1966, in Winter 2009, fig. 4.1)."""

ANKLE_HEIGHT = 0.039
"""Height of the ankle over height of the body (same source)."""


def standing_force(vertical_n: Float[Array, " sample"]) -> float | None:
    """Mean vertical force of a person standing still [N]; ``None`` if nobody does.

    Args:
        vertical_n: Vertical force on all plates together [N].
    """
    if not len(vertical_n) or not np.isfinite(vertical_n).all():
        return None
    mean = float(vertical_n.mean())
    steady = float(vertical_n.std()) <= STEADY * mean
    return mean if mean >= LEAST_WEIGHT_N and steady else None


def subject_mass(given_kg: float | None, standing_n: float | None, where: str) -> float:
    """The mass given, checked against the force while standing, or else the mass weighed [kg].

    Raises:
        InputError: Neither is known, or they differ by more than 15 %.
    """
    weighed = None if standing_n is None else standing_n / GRAVITY
    if given_kg is None and weighed is None:
        raise InputError(
            "the subject's mass is unknown: nobody stands still on the force plates",
            where=where,
            hint="give subject.mass_kg, or motion.static (with motion.static_forces for a TRC file)",
        )
    if given_kg is None:
        return float(weighed or 0.0)
    if weighed is not None and abs(weighed - given_kg) > MASS_TOLERANCE * given_kg:
        raise InputError(
            f"subject.mass_kg is {given_kg:.1f} kg, but the plates weigh {weighed:.1f} kg while standing",
            where=where,
            hint="correct the mass, or use a standing trial with both feet on the plates",
        )
    return given_kg


def subject_height(
    given_m: float | None,
    marker_map: MarkerMap,
    names: tuple[str, ...],
    standing: Float[Array, "marker 3"],
) -> float:
    """The height given, or an estimate from the standing markers [m]; 0 where they do not tell.

    The estimate is the vertical distance from the ankle to the acromion markers over the same distance in
    the average body, (0.818 - 0.039) of the height; both are skin markers of one size, so that their radius
    drops out. Four subjects of known height came out 0.4, 1.3, 2.4 and -2.3 % off. Without both markers
    the height is unknown.

    Args:
        given_m: Height in the settings [m].
        marker_map: Meaning of the names.
        names: Names of the standing markers.
        standing: Their positions [m].
    """
    if given_m is not None:
        return given_m
    place = dict(zip(names, standing, strict=True))

    def mean_height(landmarks: tuple[str, ...]) -> float:
        files = [file_name_of(marker_map, landmark) for landmark in landmarks]
        known = [place[name][1] for name in files if name in place and np.isfinite(place[name][1])]
        return float(np.mean(known)) if known else np.nan

    shoulder, ankle = mean_height(("RACR", "LACR")), mean_height(("RLMAL", "LLMAL"))
    height = (shoulder - ankle) / (ACROMION_HEIGHT - ANKLE_HEIGHT)
    return round(height, 3) if np.isfinite(height) and height > 0 else 0.0


def check_weight(vertical_n: Float[Array, " sample"], mass_kg: float, where: str) -> None:
    """Refuse ground forces that cannot be those of a subject of this mass.

    Raises:
        InputError: The forces never reach half the weight, or exceed fifteen times the weight.
    """
    peak = float(vertical_n.max()) / (mass_kg * GRAVITY)
    if not 0.5 <= peak <= 15.0:
        raise InputError(
            f"the vertical force peaks at {peak:.3g} times the weight of {mass_kg:.1f} kg",
            where=where,
            hint="check the unit (N), the columns, and subject.mass_kg",
        )
