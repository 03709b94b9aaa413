"""A C3D file as if it were measured now: for rehearsals, and for tests of everything behind the sources."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from evaluation.sources.stream import (
    Item,
    LabError,
    MarkerFrame,
    PlateInfo,
    PlateSamples,
    SourceEvent,
    SourceInfo,
)
from hilbrace.errors import InputError
from hilbrace.motion.c3d import C3DRecording, read_c3d
from hilbrace.motion.force_plates import PlateForces

Array = np.ndarray

MOST_FRAMES_AT_ONCE = 100
"""Most frames that one `read` returns."""


class C3DReplay:
    """A C3D file as a source, with its force plates as loads about the laboratory's origin.

    Args:
        name: Name of the source.
        path: The file.
        speed: How much faster than real time; infinity for as fast as it is read.
        up: The laboratory's vertical axis; C3D files do not tell it.
    """

    def __init__(self, name: str, path: Path, speed: float = 1.0, up: Literal["y", "z"] = "z") -> None:
        if not speed > 0:
            raise InputError("a replay needs a positive speed", where=str(path), hint="give 1 for real time")
        self._name, self._path, self._speed = name, path, speed
        self._up: Literal["y", "z"] = up
        self._content: C3DRecording | None = None
        self._plates: tuple[PlateInfo, ...] = ()
        self._loads: list[Float[Array, "frame sample 6"]] = []
        self._next = 0
        self._start = 0.0

    @property
    def name(self) -> str:
        """Name of the source."""
        return self._name

    def open(self) -> SourceInfo:
        """Read the file and start at its first frame.

        Raises:
            InputError: The file is missing, damaged, or its plates do not fit its frames.
        """
        content = read_c3d(self._path)
        table = content.markers
        self._plates, self._loads = (), []
        if content.plates is not None:
            self._plates, self._loads = _plates(content.plates, len(table.time), table.rate_hz, self._path)
        self._content, self._next, self._start = content, 0, time.monotonic()
        device = f"replay of {self._path.name}"
        return SourceInfo(
            self._name, device, tuple(table.names), table.rate_hz, self._up, self._plates, content.notes
        )

    def read(self, timeout_s: float) -> list[Item]:
        """Frames that are due; after the last one an ``ended`` event, and then nothing more.

        Args:
            timeout_s: Longest wait [s].

        Raises:
            LabError: The source is not open.
        """
        if self._content is None:
            raise LabError("the replay is not open", where=str(self._path), hint="call open first")
        frames = len(self._content.markers.time)
        if self._next > frames:
            time.sleep(timeout_s)
            return []
        rate = self._content.markers.rate_hz
        delay = self._start + self._next / (rate * self._speed) - time.monotonic()
        time.sleep(max(0.0, min(delay, timeout_s)))
        if delay > timeout_s:
            return []
        played = (time.monotonic() - self._start) * rate * self._speed
        due = math.floor(played) + 1 if math.isfinite(played) else frames
        end = min(frames, max(due, self._next), self._next + MOST_FRAMES_AT_ONCE)
        now = time.monotonic_ns()
        items = [
            item for number in range(self._next, end) for item in self._frame(self._content, number, now)
        ]
        self._next = end
        if end == frames:
            self._next = frames + 1
            items.append(SourceEvent(self._name, "ended", now, frames / rate, "the file is over"))
        return items

    def close(self) -> None:
        """Forget the file."""
        self._content = None

    def _frame(self, content: C3DRecording, number: int, now: int) -> list[Item]:
        table = content.markers
        items: list[Item] = [
            MarkerFrame(self._name, number, number / table.rate_hz, now, table.positions[number])
        ]
        for plate, loads in zip(self._plates, self._loads, strict=True):
            first = number * loads.shape[1]
            period = 1.0 / plate.rate_hz
            items.append(
                PlateSamples(self._name, plate.name, first, first * period, period, now, loads[number])
            )
        return items


def _plates(
    plates: PlateForces, frames: int, rate_hz: float, path: Path
) -> tuple[tuple[PlateInfo, ...], list[Float[Array, "frame sample 6"]]]:
    """What the plates deliver, and their samples frame by frame: force [N], moment about the origin [N*m]."""
    per_frame = round(plates.rate_hz / rate_hz)
    if per_frame < 1 or len(plates.time) < frames * per_frame:
        raise InputError(
            f"{len(plates.time)} plate samples do not fit {frames} frames",
            where=str(path),
            hint="export the file again, plates at a multiple of the camera rate",
        )
    moment = np.cross(plates.point, plates.force) + plates.torque
    unloaded = np.asarray((plates.force == 0.0).all(axis=2))
    moment[unloaded] = plates.torque[unloaded]
    loads = np.concatenate([plates.force, moment], axis=2)[: frames * per_frame]
    infos = tuple(
        PlateInfo(
            f"plate {name}",
            plates.rate_hz,
            ("Fx", "Fy", "Fz", "Mx", "My", "Mz"),
            ("N", "N", "N", "N*m", "N*m", "N*m"),
            np.eye(6),
            np.eye(3),
            np.zeros(3),
            np.full((4, 3), np.nan),
            zeroed=True,
        )
        for name in plates.names
    )
    return infos, [loads[:, k].reshape(frames, per_frame, 6) for k in range(len(plates.names))]
