"""Streams of the Lab Streaming Layer: plates and markers that other programs send, and our angles for them.

Needs the extra ``hilbrace[lsl]`` (pylsl, Kothe et al., labstreaminglayer). LSL finds its streams by multicast
in the local network, so it is used only where a stream is asked for by name. Its samples have no counter, and
its connection drops nothing while it lasts; gaps in the sender's time stamps are reported as they are.
"""

from __future__ import annotations

import importlib
import math
import time
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from evaluation.plate_calibration import UNITS, Placement, PlateCalibration, plate_info
from evaluation.sources.stream import Item, LabError, MarkerFrame, PlateSamples, SourceEvent, SourceInfo
from hilbrace.errors import InputError
from hilbrace.units import LENGTH_TO_M

Array = np.ndarray

FIND_S = 3.0
"""A stream is looked for this long [s]."""

BUFFER_S = 60
"""What may wait for a reader [s]."""

LOAD_CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
"""Channels of a stream that delivers loads instead of counts."""

_GAP_PERIODS = 1.5


@dataclass(frozen=True)
class StreamHeader:
    """What a stream says about itself.

    Attributes:
        name: Its name.
        host: The computer that sends it.
        rate_hz: Samples per second [Hz]; 0 if irregular.
        channels: Labels of the channels.
        unit: Unit of the first channel; empty if not told.
    """

    name: str
    host: str
    rate_hz: float
    channels: tuple[str, ...]
    unit: str


class LslStream:
    """A stream found by its name: a plate with a calibration or with loads, or markers.

    A stream whose labels come in threes ``NAME.x``, ``NAME.y``, ``NAME.z`` (or with ``_``) holds markers; any
    other is a plate.
    """

    def __init__(
        self,
        name: str,
        stream: str,
        calibration: PlateCalibration | None = None,
        placement: Placement | None = None,
    ) -> None:
        """A stream that is not yet looked for.

        Args:
            name: Name of the source, and of its plate.
            stream: Name of the stream.
            calibration: What the counts of a plate mean; plates with channels Fx to Mz need none.
            placement: Where the plate lies, and the vertical axis.
        """
        self._name = name
        self._stream = stream
        self._calibration = calibration
        self._placement = placement or Placement()
        self._inlet: Any = None
        self._info: SourceInfo | None = None
        self._scale = 1.0
        self._received = 0
        self._last_s = math.nan

    @property
    def name(self) -> str:
        """Name of the source."""
        return self._name

    def open(self) -> SourceInfo:
        """Find the stream and begin to receive.

        Raises:
            LabError: No such stream is in the network.
            InputError: pylsl is not installed, several streams have this name, or its channels are not
                understood.
        """
        self.close()
        pylsl = load_pylsl()
        found = pylsl.resolve_byprop("name", self._stream, minimum=1, timeout=FIND_S)
        if not found:
            raise LabError(
                f"no stream '{self._stream}' is in the network",
                where=f"LSL, {FIND_S:g} s",
                hint="start the program that sends it; both computers must be in one network",
            )
        if len(found) > 1:
            raise InputError(
                f"{len(found)} streams are called '{self._stream}'",
                where="LSL",
                hint="stop all but one, or give them different names",
            )
        inlet = pylsl.StreamInlet(found[0], max_buflen=BUFFER_S, recover=False)
        try:
            header = _header(inlet.info(FIND_S))
            inlet.open_stream(FIND_S)
        except (pylsl.util.LostError, pylsl.util.TimeoutError) as fault:
            raise _gone(self._stream) from fault
        self._inlet, self._info = inlet, self._describe(header)
        return self._info

    def read(self, timeout_s: float) -> list[Item]:
        """Samples that arrive within a time.

        Args:
            timeout_s: Longest wait [s].

        Raises:
            LabError: The stream ended.
        """
        if self._inlet is None or self._info is None:
            raise LabError(
                "the stream is not open", where=self._name, hint="open the source before reading it"
            )
        pylsl = load_pylsl()
        try:
            first, stamp = self._inlet.pull_sample(timeout=timeout_s)
            rest, stamps = self._inlet.pull_chunk(timeout=0.0)
        except pylsl.util.LostError as fault:
            raise _gone(self._stream) from fault
        if first is None or stamp is None:
            return []
        now = time.monotonic_ns()
        return self._items(np.array([first, *rest], float), np.array([stamp, *stamps], float), now)

    def close(self) -> None:
        """Let the stream go."""
        if self._inlet is not None:
            self._inlet.close_stream()
        self._inlet = None

    def _describe(self, header: StreamHeader) -> SourceInfo:
        device = f"LSL stream '{header.name}' of {header.host}"
        labels = marker_labels(header.channels)
        if labels:
            if header.unit not in LENGTH_TO_M:
                raise _unclear(header, f"its unit is '{header.unit}', not one of {', '.join(LENGTH_TO_M)}")
            self._scale = LENGTH_TO_M[header.unit]
            return SourceInfo(self._name, device, labels, header.rate_hz, self._placement.up)
        if header.rate_hz <= 0:
            raise _unclear(header, "a plate without a rate")
        calibration = self._calibration or _loads(header)
        plate = plate_info(self._name, header.rate_hz, header.channels, calibration, self._placement)
        notes = () if self._calibration else ("the loads of the stream are taken as those on the plate",)
        return SourceInfo(self._name, device, up=self._placement.up, plates=(plate,), notes=notes)

    def _items(
        self, values: Float[Array, "sample channel"], stamps: Float[Array, " sample"], now: int
    ) -> list[Item]:
        info = self._info
        if info is None:
            return []
        number, self._received = self._received, self._received + len(values)
        period = 1.0 / (info.plates[0].rate_hz if info.plates else info.rate_hz or math.inf)
        before = np.concatenate([[self._last_s], stamps[:-1]])
        self._last_s = float(stamps[-1])
        starts = [0, *np.flatnonzero((stamps - before)[1:] > _GAP_PERIODS * period) + 1] if period else [0]
        items: list[Item] = []
        for start, stop in zip(starts, [*starts[1:], len(values)], strict=True):
            away = float(stamps[start] - before[start])
            if period and away > _GAP_PERIODS * period:
                items.append(self._gap(float(stamps[start]), away, round(away / period) - 1, now))
            block, at = values[start:stop], stamps[start:stop]
            items += self._block(info, number + start, block, at, period, now)
        return items

    def _block(
        self,
        info: SourceInfo,
        number: int,
        values: Float[Array, "sample channel"],
        stamps: Float[Array, " sample"],
        period: float,
        now: int,
    ) -> list[Item]:
        if info.plates:
            return [PlateSamples(self._name, self._name, number, float(stamps[0]), period, now, values)]
        positions = self._scale * values.reshape(len(values), -1, 3)
        return [
            MarkerFrame(self._name, number + k, float(at), now, frame)
            for k, (at, frame) in enumerate(zip(stamps, positions, strict=True))
        ]

    def _gap(self, at: float, away: float, lost: int, now: int) -> SourceEvent:
        text = f"{away:.3f} s without a sample by the sender's time stamps, about {lost} samples"
        plate = self._name if self._info and self._info.plates else ""
        return SourceEvent(self._name, "gap", now, at, text, lost=lost, plate=plate)


class AnglesOutlet:
    """Our knee angles as a stream, so that other programs can show or record them."""

    def __init__(self, name: str, labels: tuple[str, ...], rate_hz: float) -> None:
        """Offer a stream.

        Args:
            name: Name of the stream.
            labels: Names of the angles.
            rate_hz: Frames per second [Hz].

        Raises:
            InputError: pylsl is not installed.
        """
        pylsl = load_pylsl()
        info = pylsl.StreamInfo(name, "MoCap", len(labels), rate_hz, "float32", f"hilbrace {name}")
        info.set_channel_labels(list(labels))
        info.set_channel_units(["degrees"] * len(labels))
        self._outlet = pylsl.StreamOutlet(info)

    def push(self, angles_deg: Float[Array, " angle"]) -> None:
        """Send the angles of one frame [deg]."""
        self._outlet.push_sample(angles_deg.tolist())


def load_pylsl() -> ModuleType:
    """The module pylsl.

    Raises:
        InputError: It is not installed, or its library does not load.
    """
    try:
        return importlib.import_module("pylsl")
    except (ImportError, RuntimeError, OSError) as fault:
        raise InputError(
            "LSL streams need pylsl", where=str(fault), hint='pip install "hilbrace[lsl]"'
        ) from fault


def marker_labels(channels: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the markers if channels come in threes of x, y and z; empty if they do not.

    Args:
        channels: Labels of the channels.
    """
    triples = [channels[k : k + 3] for k in range(0, len(channels), 3)]
    for mark in (".", "_"):
        names = [triple[0].rpartition(mark)[0] for triple in triples]
        whole = [tuple(f"{name}{mark}{axis}" for axis in "xyz") for name in names]
        if all(names) and [tuple(label for label in t) for t in triples] == whole:
            return tuple(names)
    return ()


def _header(info: Any) -> StreamHeader:
    count = info.channel_count()
    labels = info.get_channel_labels() or []
    units = info.get_channel_units() or []
    channels = tuple(label or f"channel {k + 1}" for k, label in enumerate(labels))
    if len(channels) != count:
        channels = tuple(f"channel {k + 1}" for k in range(count))
    return StreamHeader(
        info.name(), info.hostname(), info.nominal_srate(), channels, _unit(units[0] if units else "")
    )


def _unit(told: str | None) -> str:
    """Units as streams write them: the conventions of LSL spell them out."""
    spelled: dict[str, Literal["mm", "cm", "m"]] = {"millimeters": "mm", "centimeters": "cm", "meters": "m"}
    return spelled.get(told or "", told or "")


def _loads(header: StreamHeader) -> PlateCalibration:
    if header.channels != LOAD_CHANNELS:
        raise _unclear(
            header, "a plate of counts needs a calibration; loads are called Fx, Fy, Fz, Mx, My, Mz"
        )
    units = "N, N*mm" if header.unit == "N*mm" else "N, N*m"
    matrix = -np.eye(6) * np.repeat(UNITS[units], 3)[:, None]
    size = (math.nan, math.nan)
    return PlateCalibration(header.name, matrix, "down", 0.0, size, 1.0, np.full(6, math.nan))


def _unclear(header: StreamHeader, why: str) -> InputError:
    return InputError(
        f"the stream is not understood: {why}",
        where=f"LSL stream '{header.name}', channels {', '.join(header.channels[:8])}",
        hint="label its channels NAME.x, NAME.y, NAME.z with a unit, or give the plate's calibration file",
    )


def _gone(stream: str) -> LabError:
    return LabError(f"the stream '{stream}' ended", where="LSL", hint="start the program that sends it again")
