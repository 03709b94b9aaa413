"""Force plates with a clock of their own brought to the clock of the markers.

In the order of trust: plates that the marker system itself delivers need none of this; a trigger that both
devices record; and heel stomps, which both see: the foot stops, the force begins. Two events ten seconds
apart give offset and drift. The residual is what the events leave unexplained; a residual of more than one
frame is refused. A delay common to all events stays hidden in the offset: the heel's pad, a filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from evaluation.plate_loads import ONSET_N, contacts
from hilbrace.errors import InputError

Array = np.ndarray

DRIFT_BASE_S = 10.0
"""Events must span this much for the drift to be told from noise [s]."""

LARGEST_DRIFT = 500e-6
"""No two quartz clocks differ by more."""

FASTEST_APPROACH_M_S = 0.3
"""A heel that comes down more slowly does not stomp [m/s]."""

_APPROACH_S = 0.03
_REST_S = 0.03


@dataclass(frozen=True)
class Alignment:
    """How plate time maps to marker time.

    Attributes:
        offset_s: Marker time less plate time at `reference_s` [s].
        reference_s: Plate time to which the offset belongs [s].
        drift_ppm: How much faster than the markers' the plate's clock runs [ppm]; 0 if the events are too
            close together to tell.
        residual_s: Largest distance of an event from the fit [s].
        events: Number of events that both devices saw.
        method: What the events are.
    """

    offset_s: float
    reference_s: float
    drift_ppm: float
    residual_s: float
    events: int
    method: Literal["trigger", "heel stomps"]

    def to_marker_time(self, plate_s: Float[Array, "*any"]) -> Float[Array, "*any"]:
        """Instants of the plate's clock on the markers' clock [s]."""
        slope = 1.0 / (1.0 + 1e-6 * self.drift_ppm)
        return self.reference_s + self.offset_s + slope * (plate_s - self.reference_s)


def force_onsets(
    time_s: Float[Array, " sample"], vertical: Float[Array, " sample"]
) -> Float[Array, " event"]:
    """Instants at which the vertical force rises through the onset, between samples [s].

    Args:
        time_s: Time of each sample by the plate's clock [s].
        vertical: Vertical force on the subject [N].
    """
    starts = [contact.start for contact in contacts(vertical) if contact.start > 0]
    starts = [k for k in starts if np.isfinite(vertical[k - 1])]
    return np.array(
        [np.interp(ONSET_N, vertical[k - 1 : k + 1], time_s[k - 1 : k + 1]) for k in starts], float
    )


def heel_strikes(time_s: Float[Array, " frame"], height_m: Float[Array, " frame"]) -> Float[Array, " event"]:
    """Instants at which a heel or ankle marker stops on its way down, between frames [s].

    The height falls steadily and then stays: the stop is where the line through the last frames of the fall
    meets the height of the first frames at rest.

    Args:
        time_s: Time of each frame by the markers' clock [s].
        height_m: Height of the marker [m]; NaN in gaps.
    """
    period = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    fall, rest = max(3, round(_APPROACH_S / period)), max(3, round(_REST_S / period))
    speed = np.diff(height_m) / period
    falling = np.concatenate([[False], speed < -FASTEST_APPROACH_M_S])
    stops = np.flatnonzero(falling[:-1] & ~falling[1:])
    found = [_stop(time_s, height_m, int(k), fall, rest) for k in stops]
    return np.array([at for at in found if at is not None], float)


def align(
    marker_events_s: Float[Array, " event"],
    plate_events_s: Float[Array, " onset"],
    frame_s: float,
    method: Literal["trigger", "heel stomps"],
) -> Alignment:
    """The plate's clock against the markers' from events that both have seen.

    Either may have missed some, or seen others. Of all offsets the one counts that makes most events agree;
    where two offsets do equally well the events are too regular, and are refused.

    Args:
        marker_events_s: Events by the markers' clock [s].
        plate_events_s: Events by the plate's clock [s].
        frame_s: Time between marker frames, the largest residual that is accepted [s].
        method: What the events are.

    Raises:
        InputError: Fewer than two events agree, several offsets do, or the residual exceeds a frame.
    """
    candidates = _candidates(marker_events_s, plate_events_s, frame_s)
    most = max((len(pairs) for pairs in candidates), default=0)
    if most < 2:
        raise InputError(
            f"of {len(marker_events_s)} events of the markers and {len(plate_events_s)} of the plate no two "
            f"agree within {1e3 * frame_s:g} ms",
            where=method,
            hint="record two stomps or triggers at the start and two at the end, in an uneven rhythm",
        )
    best = [
        _fit(marker_events_s, plate_events_s, pairs, method) for pairs in candidates if len(pairs) == most
    ]
    best.sort(key=lambda one: one.residual_s)
    others = [one for one in best if abs(one.offset_s - best[0].offset_s) > 2 * frame_s]
    if others and others[0].residual_s <= frame_s:
        raise InputError(
            f"two offsets, {best[0].offset_s:.3f} s and {others[0].offset_s:.3f} s, fit {most} events alike",
            where=method,
            hint="stomp in an uneven rhythm, so that the events can be told apart",
        )
    if best[0].residual_s > frame_s:
        raise InputError(
            f"the events agree to {1e3 * best[0].residual_s:.1f} ms only, one frame is {1e3 * frame_s:g} ms",
            where=method,
            hint="stomp harder and on the plate alone, or connect a trigger",
        )
    return best[0]


def _candidates(
    marker: Float[Array, " event"], plate: Float[Array, " onset"], frame_s: float
) -> list[list[tuple[int, int]]]:
    """For each pair of events that might be one, which others would agree as well."""
    found: dict[tuple[tuple[int, int], ...], None] = {}
    for i in range(len(marker)):
        for j in range(len(plate)):
            apart = marker[:, None] - plate[None, :] - (marker[i] - plate[j])
            allowed = 2 * frame_s + LARGEST_DRIFT * np.abs(plate - plate[j])
            nearest = np.abs(apart).argmin(axis=0)
            near = np.abs(apart[nearest, np.arange(len(plate))]) <= allowed
            pairs = {int(nearest[k]): int(k) for k in np.flatnonzero(near)}
            found[tuple(pairs.items())] = None
    return [list(pairs) for pairs in found]


def _fit(
    marker: Float[Array, " event"],
    plate: Float[Array, " onset"],
    pairs: list[tuple[int, int]],
    method: Literal["trigger", "heel stomps"],
) -> Alignment:
    theirs, ours = marker[[i for i, _ in pairs]], plate[[j for _, j in pairs]]
    reference = float(ours.mean())
    offsets = theirs - ours
    slope = 0.0
    if np.ptp(ours) >= DRIFT_BASE_S:
        slope = float(np.polyfit(ours - reference, offsets, 1)[0])
        slope = float(np.clip(slope, -LARGEST_DRIFT, LARGEST_DRIFT))
    offset = float((offsets - slope * (ours - reference)).mean())
    residual = float(np.abs(offsets - offset - slope * (ours - reference)).max())
    return Alignment(offset, reference, 1e6 * (1 / (1 + slope) - 1), residual, len(pairs), method)


def _stop(
    time_s: Float[Array, " frame"], height_m: Float[Array, " frame"], last: int, fall: int, rest: int
) -> float | None:
    """Where a fall whose last fast frame is given ends; ``None`` if the marker does not then rest."""
    falling = slice(last - fall, last)
    resting = slice(last + 1, last + 1 + rest)
    if falling.start < 0 or resting.stop > len(time_s):
        return None
    down, still = height_m[falling], height_m[resting]
    if not (np.isfinite(down).all() and np.isfinite(still).all()) or (np.diff(down) >= 0).any():
        return None
    slope, at_start = np.polyfit(time_s[falling] - time_s[falling.start], down, 1)
    level = float(np.median(still))
    if slope > -FASTEST_APPROACH_M_S or np.ptp(still) > 0.25 * abs(slope) * _REST_S:
        return None
    return float(time_s[falling.start] + (level - at_start) / slope)
