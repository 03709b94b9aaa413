"""What every device of the laboratory delivers, and the protocol that its source follows.

A source is read by one thread of its own::

    info = source.open()
    while running:
        for item in source.read(timeout_s=0.1):
            ...
    source.close()

Items come in the order of arrival and none is dropped. A new `SourceInfo` among them describes whatever
follows it, as when the operator changes the marker set. Values are those the device sent; `PlateInfo` says
what they mean. Nothing is rotated on the way in: markers are in the laboratory's axes, `SourceInfo.up` names
the vertical one, and `y_up` turns vectors into the OpenSim frame's order of axes.

A source raises `LabError` where trying again may help (nobody answers, the line went dead, the bytes make no
sense) and `InputError` where it cannot (a package is missing, a file is damaged). Sources neither reconnect
nor count losses: `evaluation.sources.reconnecting.Reconnecting` does both, for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from hilbrace.errors import HilbraceError
from hilbrace.motion.recording import from_z_up

Array = np.ndarray

EventKind = Literal["connected", "disconnected", "gap", "trigger", "restarted", "info", "fault", "ended"]
"""``gap``: samples are missing; ``restarted``: the device began anew, and so did its clock;
``fault``: bytes were discarded; ``ended``: a replay is over."""


class LabError(HilbraceError):
    """A device of the laboratory does not answer, or not as its protocol says; trying again may help."""

    exit_code = 7


@dataclass(frozen=True)
class PlateInfo:
    """One force plate: its channels, and how they become a load in the laboratory.

    The load of the ground on the subject, in the plate's own axes and about its own origin, is
    ``calibration @ (values - zero)`` with the force [N] above the moment [N*m]; `rotation` and `origin` carry
    it into the laboratory (`ground_load`). A device that delivers loads has a calibration that holds its
    units and the sign (many state the force on the plate).

    Attributes:
        name: The plate's name, unique within its source.
        rate_hz: Samples per second [Hz].
        channels: Names of the channels.
        units: Unit of each channel, ``"count"`` for raw ones.
        calibration: What one unit of each channel adds to force [N] and moment [N*m] on the subject.
        rotation: Axes of the plate as columns, in the laboratory's axes.
        origin: Point about which the moments are taken, in the laboratory [m].
        corners: Corners of the surface in the laboratory [m]; NaN where unknown.
        zeroed: The device subtracts its own zero; otherwise the reader does (`zero` of `ground_load`).
        noise_n: Standard deviation of the vertical force of the plate at rest [N].
        empty: What the channels of the empty plate read when it was calibrated; without values if unknown.
    """

    name: str
    rate_hz: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    calibration: Float[Array, "6 channel"]
    rotation: Float[Array, "3 3"]
    origin: Float[Array, " 3"]
    corners: Float[Array, "4 3"]
    zeroed: bool
    noise_n: float = 2.0
    empty: tuple[float, ...] = ()


@dataclass(frozen=True)
class SourceInfo:
    """What a source delivers from now on.

    Attributes:
        source: The source's name.
        device: How the device calls itself.
        labels: Names of the markers in their order in every frame; empty without markers.
        rate_hz: Marker frames per second [Hz]; 0 without markers.
        up: The laboratory's vertical axis.
        plates: The force plates.
        notes: What the source assumed or left out, one sentence each.
    """

    source: str
    device: str
    labels: tuple[str, ...] = ()
    rate_hz: float = 0.0
    up: Literal["y", "z"] = "z"
    plates: tuple[PlateInfo, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class MarkerFrame:
    """All markers at one instant.

    Attributes:
        source: The source's name.
        number: The device's own counter; it rises by one a frame.
        device_time_s: Instant by the device's clock [s].
        host_time_ns: ``time.monotonic_ns()`` when the last byte arrived [ns].
        positions: Positions in the laboratory's axes [m]; NaN where a marker is occluded.
    """

    source: str
    number: int
    device_time_s: float
    host_time_ns: int
    positions: Float[Array, "marker 3"]


@dataclass(frozen=True)
class PlateSamples:
    """Consecutive samples of one force plate.

    Attributes:
        source: The source's name.
        plate: `PlateInfo.name`.
        number: The device's own counter at the first sample, in samples; devices whose counter wraps are
            unwrapped, devices without a counter are counted from 0 and report their own gaps.
        device_time_s: Instant of the first sample by the device's clock [s].
        period_s: Nominal time between samples [s].
        host_time_ns: ``time.monotonic_ns()`` when the last byte arrived [ns].
        values: The channels as the device sent them, in `PlateInfo.units`.
    """

    source: str
    plate: str
    number: int
    device_time_s: float
    period_s: float
    host_time_ns: int
    values: Float[Array, "sample channel"]


@dataclass(frozen=True)
class SourceEvent:
    """Something happened that is no sample.

    Attributes:
        source: The source's name.
        kind: What happened.
        host_time_ns: ``time.monotonic_ns()`` when it was noticed [ns].
        device_time_s: Instant by the device's clock [s]; NaN if the device gave none.
        text: The event in a sentence.
        lost: Frames or samples missing by the device's counter; 0 if the counter does not tell.
        plate: The plate concerned; empty for markers and for the source as a whole.
    """

    source: str
    kind: EventKind
    host_time_ns: int
    device_time_s: float
    text: str
    lost: int = 0
    plate: str = ""


Item = SourceInfo | MarkerFrame | PlateSamples | SourceEvent


@runtime_checkable
class Source(Protocol):
    """A device that is read block by block by one thread."""

    @property
    def name(self) -> str:
        """Name of the source, unique within a session."""
        ...

    def open(self) -> SourceInfo:
        """Connect, within a few seconds, and say what comes.

        Raises:
            LabError: The device does not answer as it should.
            InputError: The settings cannot work, whatever the device does.
        """
        ...

    def read(self, timeout_s: float) -> list[Item]:
        """Wait for news; return all there is, or nothing when the time is over.

        Args:
            timeout_s: Longest wait [s].

        Raises:
            LabError: The connection is lost; every item before it has been returned.
        """
        ...

    def close(self) -> None:
        """Let the device go; closing twice is no mistake, and `open` works again afterwards."""
        ...


def ground_load(
    plate: PlateInfo, values: Float[Array, "sample channel"], zero: Float[Array, " channel"] | None = None
) -> Float[Array, "sample 6"]:
    """Load of the ground on the subject, in the laboratory's axes and about its origin.

    Args:
        plate: The plate.
        values: Channels as the device sent them.
        zero: Channels of the empty plate; ``None`` for a plate that is zeroed already.

    Returns:
        Force [N] and moment [N*m]; a channel that is NaN spoils only what it contributes to.
    """
    channels = (values if zero is None else values - zero)[:, None, :]
    local = np.where(plate.calibration == 0.0, 0.0, channels * plate.calibration).sum(axis=2)
    force = local[:, :3] @ plate.rotation.T
    moment = local[:, 3:] @ plate.rotation.T + np.cross(plate.origin, force)
    return np.hstack([force, moment])


def y_up(vectors: Float[Array, "*rest 3"], up: Literal["y", "z"]) -> Float[Array, "*rest 3"]:
    """Vectors in a frame whose y axis is vertical: (x, y, z) of a z-up laboratory becomes (x, z, -y).

    Args:
        vectors: Positions, forces or moments in the laboratory's axes.
        up: The laboratory's vertical axis.
    """
    return vectors if up == "y" else from_z_up(vectors)
