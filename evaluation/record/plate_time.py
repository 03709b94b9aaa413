"""The time of a plate that has a clock of its own, on the clock of the markers.

In the order of trust: triggers that both devices recorded; heel stomps, if the recording says which marker is
on the heel (``stomps`` in its first mark); and otherwise the fastest arrivals at this computer, which cannot
tell how late a device sends. Triggers and stomps that disagree by more than one frame are refused.

Stomps are never guessed. In an ordinary landing the toes load the plate long before the heel stops, and every
landing does so alike: the events would agree, and the alignment be wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.clocks import fit_clock
from evaluation.record.reading import Recorded
from evaluation.sources.stream import MarkerFrame, PlateSamples, SourceEvent
from evaluation.stream_alignment import DRIFT_BASE_S, Alignment, align, force_onsets, heel_strikes
from hilbrace.errors import InputError
from hilbrace.motion.opensim_files import MarkerTable

Array = np.ndarray

PLAUSIBLE_S = 0.25
"""No device sends later than that, so that events farther from the arrivals are not the same ones [s]."""


@dataclass(frozen=True)
class PlateTime:
    """How a plate's time maps to the markers'.

    Attributes:
        to_markers: The map, of instants in seconds.
        remark: How well it is known, as the end of a sentence about the plate.
    """

    to_markers: Callable[[Float[Array, " any"]], Float[Array, " any"]]
    remark: str


def plate_time(
    recorded: Recorded,
    frames: Sequence[MarkerFrame],
    samples: Sequence[PlateSamples],
    table: MarkerTable,
    force: tuple[Float[Array, " sample"], Float[Array, " sample"]],
) -> PlateTime:
    """Lay a plate's clock over that of the markers.

    Args:
        recorded: The recording.
        frames: Its marker frames.
        samples: The plate's samples.
        table: The marker frames by their counter, y up, from time zero.
        force: Time by the plate's clock [s], and vertical force on the subject [N].

    Raises:
        InputError: Triggers or stomps disagree by more than a frame, or the heel's marker is missing.
    """
    frame_s = 1.0 / table.rate_hz
    marker, plate = _triggers(recorded, frames), _triggers(recorded, samples)
    if len(marker) > 1 and len(plate) > 1:
        return _aligned(align(marker, plate, frame_s, "trigger"), frames, samples)
    heel = next((str(m.content["stomps"]) for m in recorded.marks if m.content.get("stomps")), "")
    if heel:
        if heel not in table.names:
            raise InputError(
                f"there is no marker '{heel}' to see stomps by",
                where=str(recorded.path),
                hint=f"name one of {', '.join(table.names)}",
            )
        height = table.positions[:, table.names.index(heel), 1]
        strikes = heel_strikes(frames[0].device_time_s + table.time, height)
        return _aligned(align(strikes, force_onsets(*force), frame_s, "heel stomps"), frames, samples)
    return _by_arrivals(frames, samples)


def _aligned(found: Alignment, frames: Sequence[MarkerFrame], samples: Sequence[PlateSamples]) -> PlateTime:
    """A plate aligned by events, unless other events were taken for them: arrivals know roughly."""
    at = np.array([found.reference_s])
    apart = float((found.to_marker_time(at) - _by_arrivals(frames, samples).to_markers(at))[0])
    if abs(apart) > PLAUSIBLE_S:
        raise InputError(
            f"{found.events} events agree, but {apart:+.2f} s away from where the plate is by its arrivals",
            where=found.method,
            hint="stomp in an uneven rhythm, twice at the start and twice at the end",
        )
    drift = f", its clock runs {found.drift_ppm:+.0f} ppm" if found.drift_ppm else ""
    return PlateTime(
        found.to_marker_time,
        f"is laid over the markers by {found.events} events ({found.method}), which agree to "
        f"{1e3 * found.residual_s:.1f} ms{drift}",
    )


def _by_arrivals(frames: Sequence[MarkerFrame], samples: Sequence[PlateSamples]) -> PlateTime:
    remark = "is laid over the markers by its fastest arrivals: how late either device sends stays unknown"
    (marker_s, marker_host), (plate_s, plate_host) = _arrivals(frames), _arrivals(samples)
    if min(map(_span, (marker_s, plate_s))) < DRIFT_BASE_S:
        shift = _fastest(plate_s, plate_host) - _fastest(marker_s, marker_host)
        return PlateTime(lambda at: at + shift, remark)
    markers, plate = fit_clock(marker_s, marker_host), fit_clock(plate_s, plate_host)
    drift = plate.drift_ppm - markers.drift_ppm
    return PlateTime(
        lambda at: markers.to_device(plate.to_host(at)),
        f"{remark}; its clock runs {drift:+.0f} ppm against the markers'",
    )


def _arrivals(
    items: Sequence[MarkerFrame] | Sequence[PlateSamples],
) -> tuple[Float[Array, " item"], Float[Array, " item"]]:
    """Device time of the last value of each item, and when it arrived [s]."""
    device = [
        item.device_time_s + item.period_s * (len(item.values) - 1)
        if isinstance(item, PlateSamples)
        else item.device_time_s
        for item in items
    ]
    known = np.isfinite(device)
    return np.array(device)[known], np.array([1e-9 * item.host_time_ns for item in items])[known]


def _span(device_s: Float[Array, " item"]) -> float:
    return float(np.ptp(device_s)) if len(device_s) else 0.0


def _fastest(device_s: Float[Array, " item"], host_s: Float[Array, " item"]) -> float:
    """Host time minus device time of the fastest arrival [s]."""
    return float((host_s - device_s).min()) if len(device_s) else 0.0


def _triggers(
    recorded: Recorded, items: Sequence[MarkerFrame] | Sequence[PlateSamples]
) -> Float[Array, " event"]:
    """Rising triggers of a source by its own clock [s]; those without a time by their arrival."""
    events = [
        item for item in recorded.items
        if isinstance(item, SourceEvent) and item.kind == "trigger" and item.source == items[0].source
        and not item.text.endswith("input 0")
    ]  # fmt: skip
    late = _fastest(*_arrivals(items))
    return np.array(
        [
            event.device_time_s if np.isfinite(event.device_time_s) else 1e-9 * event.host_time_ns - late
            for event in events
        ],
        float,
    )
