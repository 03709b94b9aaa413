"""What a force plate's load says: where it acts, when a foot is on the plate, how the plate drifts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

Array = np.ndarray

ONSET_N = 20.0
"""Vertical force at which a contact begins [N]."""

HYSTERESIS_N = 5.0
"""A contact ends this much below the force at which it began [N]."""


@dataclass(frozen=True)
class Contact:
    """One contact with a plate.

    Attributes:
        start: First sample at or above the onset.
        stop: First sample after the contact; the number of samples if it lasts until the end.
        whole: The contact begins and ends within the samples.
    """

    start: int
    stop: int
    whole: bool


def centre_of_pressure(
    load: Float[Array, "sample 6"], surface_z: float, least_n: float = ONSET_N
) -> Float[Array, "sample 2"]:
    """Point of the surface about which the load has no horizontal moment, on the plate's x and y axes [m].

    With the surface at z = -d (a plate whose z axis points down, its origin d below the surface) this is
    AMTI's x = -(My + Fx d) / Fz, y = (Mx - Fy d) / Fz. The sign of the load does not matter.

    Args:
        load: Force [N] and moment about the plate's origin [N*m], in the plate's axes.
        surface_z: The surface on the plate's z axis [m].
        least_n: Where the vertical force is smaller the point is NaN, since it would be a ratio of noise [N].
    """
    fx, fy, fz, mx, my, _ = load.T
    bearing = np.abs(fz) >= least_n
    divisor = np.where(bearing, fz, np.nan)
    return np.column_stack([(surface_z * fx - my) / divisor, (mx + surface_z * fy) / divisor])


def contacts(
    vertical: Float[Array, " sample"], onset_n: float = ONSET_N, hysteresis_n: float = HYSTERESIS_N
) -> list[Contact]:
    """Contacts with a plate: from the onset until the force falls below onset minus hysteresis.

    A gap (NaN) ends a contact, and neither it nor one after the gap counts as whole.

    Args:
        vertical: Vertical force of the ground on the subject, upward positive [N].
        onset_n: Force at which a contact begins [N].
        hysteresis_n: How far below the onset it ends [N].
    """
    state = np.zeros(len(vertical), int)
    state[vertical >= onset_n] = 1
    state[vertical < onset_n - hysteresis_n] = -1
    gap = np.isnan(vertical)
    state[gap] = -1
    known = np.flatnonzero(state)
    on = np.zeros(len(vertical) + 2, bool)
    if len(known):
        latest = np.searchsorted(known, np.arange(len(vertical)), side="right") - 1
        on[1:-1] = np.where(latest >= 0, state[known[np.maximum(latest, 0)]] > 0, False)
    edges = np.flatnonzero(np.diff(on.astype(int)))
    return [Contact(int(a), int(b), _is_whole(int(a), int(b), gap)) for a, b in edges.reshape(-1, 2)]


def without_drift(
    load: Float[Array, "sample 6"], unloaded: Bool[Array, " sample"]
) -> Float[Array, "sample 6"]:
    """Load less a drift that runs linearly from one unloaded phase to the next, and on at either end.

    Args:
        load: Force and moment.
        unloaded: Samples at which nothing is on the plate.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], unloaded.astype(int), [0]]))).reshape(-1, 2)
    if not len(edges):
        return load.copy()
    middles = (edges.sum(axis=1) - 1) / 2
    levels = np.stack([np.nanmean(load[a:b], axis=0) for a, b in edges])
    at = np.arange(len(load))
    drift = np.column_stack([np.interp(at, middles, column) for column in levels.T])
    return load - drift


def _is_whole(start: int, stop: int, gap: Bool[Array, " sample"]) -> bool:
    return 0 < start and stop < len(gap) and not (gap[start - 1] or gap[stop])
