"""The thread that turns what the devices send into angles, forces and peaks while it comes."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.calibration import LimbCalibration
from evaluation.conventions import FRONTAL, SAGITTAL, TRANSVERSE
from evaluation.live.knee import LiveKnee
from evaluation.live.mailbox import Mailbox
from evaluation.live.peaks import FlightWatch, Peak, PeakWatch, bending_and_landing
from evaluation.live.timing import Latency
from evaluation.record.messages import plate_of
from evaluation.sources.stream import (
    Item,
    MarkerFrame,
    PlateInfo,
    PlateSamples,
    SourceEvent,
    SourceInfo,
    ground_load,
)
from hilbrace.errors import InputError

Array = np.ndarray

SHOWN_S = 12.0
"""Length of the curves that are kept for the screen [s]."""

CURVE_HZ = 100.0
"""Most points of a curve per second [Hz]."""

RESTART_S = 0.5
"""A curve whose time runs back so far starts anew [s]."""

STALE_S = 0.5
"""A plate that is silent for so long no longer counts to the force [s]."""

WAIT_S = 0.05


@dataclass(frozen=True)
class Readings:
    """What the screen shows of the leg at one instant.

    Attributes:
        knee_deg: Flexion (positive), adduction and internal rotation [deg]; ``None`` while unknown.
        force_n: Vertical force on all plates [N]; ``None`` without a plate.
        residual_mm: Misfit of the worse cluster [mm]; NaN while unknown.
        hidden: Markers that the last frame did not show.
        bending: The bending peak of this take.
        landing: The landing peak of this take.
        deepest: The deepest flexion of this take so far.
        fault: Why there are no angles; empty if there are.
    """

    knee_deg: tuple[float, float, float] | None
    force_n: float | None
    residual_mm: float
    hidden: int
    bending: Peak | None
    landing: Peak | None
    deepest: Peak | None
    fault: str


class LiveAnalysis:
    """Empties a mailbox of items; everything else may be asked from any thread.

    Args:
        mailbox: The queue that the devices fill.
        cluster_labels: Markers that tell which source shows the leg.
    """

    def __init__(self, mailbox: Mailbox[Item], cluster_labels: tuple[str, ...]) -> None:
        self._mailbox, self._cluster_labels = mailbox, frozenset(cluster_labels)
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="analysis", daemon=True)
        self._infos: dict[str, SourceInfo] = {}
        self._calibration: LimbCalibration | None = None
        self._knee: LiveKnee | None = None
        self._fault = "no standing trial yet"
        self._zeros: dict[tuple[str, str], Float[Array, " channel"]] = {}
        self._offsets: dict[str, float] = {}
        self._vertical: dict[tuple[str, str], tuple[float, float]] = {}
        self._peaks, self._flight = PeakWatch(), FlightWatch()
        self._last: tuple[float, float, float] | None = None
        self._residual, self._hidden = float("nan"), 0
        self._frames = 0
        self._samples: dict[tuple[str, str], list[Float[Array, "sample channel"]]] | None = None
        self.knee_curve = Curve()
        self.force_curve = Curve()
        self.latency = Latency()

    def start(self) -> None:
        """Begin to analyse."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopped.set()
        self._thread.join(10.0)

    @property
    def frames(self) -> int:
        """Marker frames of the leg's source so far."""
        return self._frames

    def marker_source(self) -> SourceInfo | None:
        """The source that shows the leg: the one with the most markers of its clusters."""
        with self._lock:
            return self._leg()

    def plates(self) -> list[tuple[str, PlateInfo]]:
        """Source and description of every plate."""
        with self._lock:
            return [(info.source, plate) for info in self._infos.values() for plate in info.plates]

    def calibrate(self, calibration: LimbCalibration) -> None:
        """Show angles from now on.

        Args:
            calibration: The standing leg.
        """
        with self._lock:
            self._calibration, self._knee = calibration, None
            self._aim()

    def zero(self, source: str, plate: str, channels: Float[Array, " channel"]) -> None:
        """Subtract the empty plate's channels from now on."""
        with self._lock:
            self._zeros[source, plate] = channels

    def collect_plates(self) -> None:
        """Begin to keep the samples of all plates, for their zero."""
        with self._lock:
            self._samples = {}

    def collected_plates(self) -> dict[tuple[str, str], Float[Array, "sample channel"]]:
        """The samples kept since `collect_plates`, which ends here."""
        with self._lock:
            kept, self._samples = self._samples or {}, None
        return {key: np.concatenate(blocks) for key, blocks in kept.items()}

    def new_take(self) -> None:
        """Forget the peaks of the take before."""
        with self._lock:
            self._peaks, self._flight = PeakWatch(), FlightWatch()

    def readings(self) -> Readings:
        """What the screen shows now."""
        with self._lock:
            bending, landing = bending_and_landing(self._peaks.peaks, self._flight.flight)
            return Readings(
                knee_deg=self._last,
                force_n=self._total(time.monotonic()) if self._vertical else None,
                residual_mm=self._residual,
                hidden=self._hidden,
                bending=bending,
                landing=landing,
                deepest=self._peaks.highest,
                fault=self._fault,
            )

    def _run(self) -> None:
        while not self._stopped.is_set():
            for items in _together(self._mailbox.take(WAIT_S)):
                self._take(items)

    def _take(self, items: list[Item]) -> None:
        first = items[0]
        with self._lock:
            match first:
                case SourceInfo():
                    self._infos[first.source] = first
                    self._aim()
                case SourceEvent():
                    for item in items:
                        if isinstance(item, SourceEvent) and item.kind == "disconnected":
                            self._forget(item.source)
                case MarkerFrame():
                    self._follow([item for item in items if isinstance(item, MarkerFrame)])
                case PlateSamples():
                    self._weigh([item for item in items if isinstance(item, PlateSamples)])

    def _leg(self) -> SourceInfo | None:
        def named(info: SourceInfo) -> int:
            return len(self._cluster_labels & {label.rsplit(":", 1)[-1] for label in info.labels})

        best = max(self._infos.values(), key=named, default=None)
        return best if best is not None and best.labels else None

    def _aim(self) -> None:
        """Prepare the fits for the markers that come now."""
        self._knee, leg = None, self._leg()
        if leg is None:
            self._fault = "no device sends markers"
        elif self._calibration is None:
            self._fault = "no standing trial yet"
        else:
            try:
                self._knee, self._fault = LiveKnee(self._calibration, leg), ""
            except InputError as fault:
                self._fault = fault.what

    def _forget(self, source: str) -> None:
        self._vertical = {key: value for key, value in self._vertical.items() if key[0] != source}
        leg = self._leg()
        if leg is not None and leg.source == source:
            self._last = None

    def _follow(self, frames: list[MarkerFrame]) -> None:
        leg = self._leg()
        if leg is None or frames[0].source != leg.source:
            return
        frames = [frame for frame in frames if len(frame.positions) == len(leg.labels)]
        if not frames:
            return
        self._frames += len(frames)
        self._offsets[leg.source] = 1e-9 * frames[-1].host_time_ns - frames[-1].device_time_s
        positions = np.stack([frame.positions for frame in frames])
        self._hidden = int(np.isnan(positions[-1]).any(axis=1).sum())
        if self._knee is None:
            self._last = None
            return
        found = self._knee.angles(positions)
        angles = found.knee_deg * [-1.0, 1.0, 1.0]
        for frame, (flexion, adduction, rotation) in zip(frames, angles.tolist(), strict=True):
            self._peaks.add(frame.device_time_s, flexion, adduction)
            self.knee_curve.add(frame.device_time_s, (flexion, adduction, rotation))
        now = time.monotonic_ns()
        for frame in frames:
            self.latency.add(1e-6 * (now - frame.host_time_ns))
        last = angles[-1]
        known = bool(np.isfinite(last).all())
        self._last = (float(last[SAGITTAL]), float(last[FRONTAL]), float(last[TRANSVERSE])) if known else None
        self._residual = float(found.residual_mm[-1].max())

    def _weigh(self, blocks: list[PlateSamples]) -> None:
        """Follow the vertical force, block by block in the order of time, whichever plate they come from."""
        plates: dict[tuple[str, str, int], list[PlateSamples]] = {}
        for block in blocks:
            plates.setdefault((block.source, block.plate, block.values.shape[1]), []).append(block)
        weighed = [entry for group in plates.values() for entry in self._weigh_plate(group)]
        for at, host_s, key, vertical in sorted(weighed, key=lambda entry: entry[0]):
            self._vertical[key] = (vertical, host_s)
            total = self._total(host_s)
            self._flight.add(at, total)
            self.force_curve.add(at, (total,))

    def _weigh_plate(self, blocks: list[PlateSamples]) -> list[tuple[float, float, tuple[str, str], float]]:
        """Time on the leg's clock, time of arrival, plate and mean vertical force of every block."""
        first = blocks[0]
        info, key = self._infos.get(first.source), (first.source, first.plate)
        plate = plate_of(info, first.plate)
        if info is None or plate is None or first.values.shape[1] != plate.calibration.shape[1]:
            return []
        values = np.concatenate([block.values for block in blocks])
        if self._samples is not None:
            self._samples.setdefault(key, []).append(values)
        zero = None if plate.zeroed else self._zeros.get(key)
        vertical = ground_load(plate, values, zero)[:, 1 if info.up == "y" else 2]
        ends = np.cumsum([len(block.values) for block in blocks])
        parts = np.split(vertical, ends[:-1])
        return [
            (self._on_leg_clock(block), 1e-9 * block.host_time_ns, key, float(part.mean()))
            for block, part in zip(blocks, parts, strict=True)
            if len(part)
        ]

    def _on_leg_clock(self, block: PlateSamples) -> float:
        """Instant of a block on the clock of the source that shows the leg [s]."""
        own = 1e-9 * block.host_time_ns - block.device_time_s
        leg = self._leg()
        if leg is None or leg.source == block.source or leg.source not in self._offsets:
            return block.device_time_s
        return block.device_time_s + own - self._offsets[leg.source]

    def _total(self, now_s: float) -> float:
        return sum(value for value, at in self._vertical.values() if now_s - at < STALE_S)


class Curve:
    """The last seconds of a curve, thinned for the screen.

    A curve whose time runs back, as after a replay begins again, starts anew.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._points: deque[tuple[int, float, tuple[float, ...]]] = deque(maxlen=round(SHOWN_S * CURVE_HZ))
        self._count = 0
        self._first_kept = 0

    def add(self, time_s: float, values: tuple[float, ...]) -> None:
        """Append a point, unless it is nearer to the last one than the screen can show."""
        with self._lock:
            if self._points:
                step = time_s - self._points[-1][1]
                if step < -RESTART_S:
                    self._points.clear()
                    self._first_kept = self._count
                elif step < 0.99 / CURVE_HZ:
                    return
            self._points.append((self._count, time_s, values))
            self._count += 1

    def since(self, cursor: int) -> tuple[int, bool, list[list[float | None]]]:
        """Points that are new.

        Args:
            cursor: What the last call returned; 0 for all there are.

        Returns:
            The next cursor, whether the curve began anew meanwhile, and rows of time and values, ``None``
            where unknown.
        """
        with self._lock:
            rows = [
                [round(time_s, 4), *(round(v, 2) if v == v else None for v in values)]
                for number, time_s, values in self._points
                if number >= cursor
            ]
            return self._count, cursor <= self._first_kept > 0, rows


def _together(items: list[Item]) -> Iterator[list[Item]]:
    """Items of one kind at once, which is quick after a hold-up; what changes the sources keeps its place."""
    kinds: dict[tuple[str, ...], list[Item]] = {}
    for item in items:
        if isinstance(item, SourceInfo | SourceEvent):
            yield from kinds.values()
            kinds = {}
            yield [item]
        else:
            kind = ("frames", item.source) if isinstance(item, MarkerFrame) else ("samples",)
            kinds.setdefault(kind, []).append(item)
    yield from kinds.values()
