"""C3D files: checked first, then opened by ezc3d in a process that may die without harm."""

from __future__ import annotations

import io
import json
import os
import struct
import subprocess
import sys
import threading
import zipfile
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.motion.c3d_header import MIPS, C3DHeader, check_c3d
from hilbrace.motion.c3d_plain import read_plain
from hilbrace.motion.force_plates import DRIFT_N, PlateForces
from hilbrace.motion.opensim_files import MarkerTable

Array = np.ndarray

MEMORY_LIMIT_BYTES = 4 * 2**30
"""Address space of the reading process."""

START_SECONDS = 60.0
"""Longest time for the reading process to start on a busy computer."""

SECONDS_PER_FILE = 3.5
BYTES_PER_SECOND = 5e6
"""A file may take `SECONDS_PER_FILE`, and as much longer as its length at this rate."""

_LENGTH = struct.Struct("<Q")
_FORCE_TO_N = {"N": 1.0, "kN": 1000.0}
_MOMENT_TO_NM = {"Nmm": 1e-3, "Nm": 1.0, "N*mm": 1e-3, "N*m": 1.0}
_POSITION_TO_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


@dataclass(frozen=True)
class C3DRecording:
    """The content of a C3D file in SI units, in the laboratory's own axes.

    Attributes:
        markers: Markers; the first stored frame is at time zero.
        plates: Loads on the force plates, ``None`` if the file has none.
        outputs: What a model computed from the markers (angles, forces, ...), by name, in the file's own
            units; NaN where the file holds none.
        measurements: The subject's measurements (group PROCESSING of Vicon's files), in the file's own units.
        notes: What was left out or assumed, one sentence each.
        step: Step of values that are stored as whole numbers, in the file's own units; 0 for floats.
    """

    markers: MarkerTable
    plates: PlateForces | None
    outputs: dict[str, Float[Array, "frame 3"]]
    measurements: dict[str, float]
    notes: tuple[str, ...]
    step: float


class C3DReader:
    """A process that reads C3D files one after the other, replaced when a file kills it.

    Use it as a context: ``with C3DReader() as reader: reader.read(path)``. Starting it takes about 0.4 s.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> C3DReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def read(self, path: Path) -> C3DRecording:
        """Read one file.

        Raises:
            InputError: The file is missing, cut short or damaged, or contradicts itself.
        """
        header = check_c3d(path)
        oddity = _oddity(header)
        if oddity:
            recording = _recording(read_plain(path, header), header, path)
            note = f"{path.name} {oddity}: force plates are not read."
            return replace(recording, notes=(*recording.notes, note))
        process = self._running()
        request = json.dumps(str(path.resolve())).encode() + b"\n"
        seconds = SECONDS_PER_FILE + path.stat().st_size / BYTES_PER_SECOND
        answer, timed_out = _ask(process, request, seconds)
        if answer is None:
            self._stop()
            fate = f"was still reading after {seconds:.0f} s" if timed_out else "died on this file"
            raise InputError(
                f"the C3D library {fate}",
                where=str(path),
                hint="the file is damaged: copy or export it again",
            )
        return _recording(_unpack(answer, path), header, path)

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is None:
            return self._process
        self._stop()
        worker = Path(__file__).with_name("c3d_worker.py")
        quiet = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(worker), str(MEMORY_LIMIT_BYTES)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | quiet,
        )
        ready, _ = _ask(self._process, b"", START_SECONDS)
        if ready is None:
            self._stop()
            raise InputError(
                "the C3D library does not start",
                where="ezc3d in a process of its own",
                hint="run `hilbrace doctor`, or install ezc3d again",
            )
        return self._process

    def _stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()


def read_c3d(path: Path) -> C3DRecording:
    """Read one C3D file in a process of its own.

    Raises:
        InputError: The file is missing, cut short or damaged, or contradicts itself.
    """
    with C3DReader() as reader:
        return reader.read(path)


def _oddity(header: C3DHeader) -> str:
    """Why ezc3d cannot read a file right; nothing if it can.

    It refuses files of SGI computers, and takes analog values without channels or rate for points.
    """
    if header.processor == MIPS:
        return "was written by an SGI computer"
    if not header.analog_described:
        return "stores analog values of no channel or rate"
    return ""


def _ask(process: subprocess.Popen[bytes], request: bytes, seconds: float) -> tuple[bytes | None, bool]:
    """Send a request and wait for the answer; ``None`` if the process ended, and whether for lack of time."""
    stdin, stdout = process.stdin, process.stdout
    if stdin is None or stdout is None:
        return None, False
    late = threading.Event()

    def end() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(seconds, end)
    timer.start()
    try:
        stdin.write(request)
        stdin.flush()
        head = stdout.read(_LENGTH.size)
        if len(head) < _LENGTH.size:
            return None, late.is_set()
        length = _LENGTH.unpack(head)[0]
        body = stdout.read(length)
        return (body if len(body) == length else None), late.is_set()
    except (BrokenPipeError, OSError):
        return None, late.is_set()
    finally:
        timer.cancel()


def _unpack(answer: bytes, path: Path) -> dict[str, Any]:
    try:
        with np.load(io.BytesIO(answer), allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
    except (ValueError, zipfile.BadZipFile) as fault:
        raise InputError(
            f"unreadable content: {fault}", where=str(path), hint="export the file again"
        ) from None
    if "fault" in content:
        raise InputError(
            f"the C3D library refuses the file: {content['fault']}",
            where=str(path),
            hint="it is damaged or of a rare kind: export it again with the software that recorded it",
        )
    return content


def _recording(content: dict[str, Any], header: C3DHeader, path: Path) -> C3DRecording:
    points, rate = content["points"], float(content["point_rate"])
    if points.shape[:2] != (header.frames, header.points) or header.frames < 2:
        raise InputError(
            f"{points.shape[0]} frames of {points.shape[1]} points were read, "
            f"{header.frames} of {header.points} were promised",
            where=str(path),
            hint="the file is damaged, or holds a single frame: export it again",
        )
    if not 1.0 <= rate <= 1e5:
        raise InputError(
            f"a marker rate of {rate:g} Hz", where=str(path), hint="set POINT:RATE and export again"
        )
    scale, notes = _scale(str(content["units"]), path)
    names, kept, outputs, more = _markers(content, path)
    hidden = (content["residuals"] < 0) | np.all(points == 0, axis=2) | ~np.isfinite(points).all(axis=2)
    points = np.where(hidden[:, :, None], np.nan, points)
    markers = MarkerTable(names, np.arange(len(points)) / rate, rate, points[:, kept] * scale)
    plates, yet_more = _plates(content, header, rate, path)
    computed = {name: points[:, k] for name, k in outputs.items()}
    measured = dict(zip(map(str, content["measured"]), content["measurements"].tolist(), strict=True))
    return C3DRecording(markers, plates, computed, measured, (*notes, *more, *yet_more), header.step)


def _scale(units: str, path: Path) -> tuple[float, tuple[str, ...]]:
    text = units.strip().lower()
    if not text:
        return 1e-3, (f"{path.name} names no unit of length: millimetres assumed.",)
    for start, scale in (("mm", 1e-3), ("milli", 1e-3), ("cm", 1e-2), ("centi", 1e-2), ("m", 1.0)):
        if text.startswith(start):
            return scale, ()
    raise InputError(f"unknown unit '{units}'", where=f"{path}, POINT:UNITS", hint="set it to mm or m")


def _markers(
    content: dict[str, Any], path: Path
) -> tuple[tuple[str, ...], list[int], dict[str, int], tuple[str, ...]]:
    """Names without the subject's prefix, which trajectories they are, those computed, and what was left out.

    Some programs list the outputs without the prefix that their labels carry, or list no angles at all.
    """
    labels = [str(label).strip() for label in content["labels"]]
    outputs = {str(name).strip() for name in content["outputs"]}
    outputs |= {label for label in labels if label.rsplit(":", 1)[-1] in outputs or label.endswith("Angles")}
    count = content["points"].shape[1]
    labels = (labels + [""] * count)[:count]
    unnamed = [k for k, label in enumerate(labels) if not label or label.startswith("*")]
    computed = [k for k, label in enumerate(labels) if label in outputs and k not in set(unnamed)]
    left_out = set(unnamed) | set(computed)
    kept = [k for k in range(count) if k not in left_out]
    names = tuple(labels[k].rsplit(":", 1)[-1] for k in kept)
    repeated = [name for name, times in Counter(names).items() if times > 1]
    if repeated or not names:
        raise InputError(
            f"markers share a name: {', '.join(repeated[:5])}" if repeated else "no named markers",
            where=str(path),
            hint="label every trajectory once, and export one subject per file",
        )
    notes = [f"{path.name}: {len(unnamed)} unlabelled trajectories left out."] if unnamed else []
    if computed:
        notes.append(
            f"{path.name}: {len(computed)} model outputs (angles, forces, moments, powers) left out."
        )
    return names, kept, {labels[k].rsplit(":", 1)[-1]: k for k in computed}, tuple(notes)


def _plates(
    content: dict[str, Any], header: C3DHeader, rate: float, path: Path
) -> tuple[PlateForces | None, tuple[str, ...]]:
    """The plates' wrenches about the middle of their surface; downward forces are turned, with a note."""
    samples = header.frames * header.analog_per_frame
    count = int(content["plates"])
    usable = [k for k in range(count) if len(content[f"plate{k}_force"]) == samples > 0]
    notes = [f"{path.name}: force plate {k + 1} holds no samples." for k in range(count) if k not in usable]
    if not usable:
        return None, tuple(notes)
    force, point, torque = (np.zeros((samples, len(usable), 3)) for _ in range(3))
    for at, k in enumerate(usable):
        where = f"{path}, force plate {k + 1}"
        to_m = _unit(_POSITION_TO_M, content[f"plate{k}_unit_position"], where)
        force[:, at] = content[f"plate{k}_force"] * _unit(_FORCE_TO_N, content[f"plate{k}_unit_force"], where)
        torque[:, at] = content[f"plate{k}_moment"] * _unit(
            _MOMENT_TO_NM, content[f"plate{k}_unit_moment"], where
        )
        point[:, at] = _middle(content[f"plate{k}_corners"], where) * to_m
        if _pulls(force[:, at]):
            force[:, at] *= -1
            torque[:, at] *= -1
            notes.append(
                f"{path.name}: force plate {k + 1} stores forces on the plate; their sign was changed."
            )
    plates = PlateForces(
        str(path),
        tuple(str(k + 1) for k in usable),
        tuple(f"force plate {k + 1}" for k in usable),
        np.arange(samples) / (rate * header.analog_per_frame),
        rate * header.analog_per_frame,
        force,
        point,
        torque,
    )
    return plates, tuple(notes)


def _middle(corners: Float[Array, "corner 3"], where: str) -> Float[Array, " 3"]:
    if corners.shape != (4, 3) or not np.isfinite(corners).all():
        raise InputError(
            "the plate's corners are no four points",
            where=where,
            hint="set FORCE_PLATFORM:CORNERS, export again",
        )
    return corners.mean(axis=0)


def _pulls(force: Float[Array, "sample 3"]) -> bool:
    """Whether a plate's main component is opposite to what a floor can do.

    Whichever axis is up in the laboratory (y or z), the force of the floor on the subject is positive along
    it; drift of an unloaded plate says nothing.
    """
    force = np.nan_to_num(force)
    up = 1 + int(np.abs(force[:, 1:]).max(axis=0).argmax())
    low, high = -float(force[:, up].min()), float(force[:, up].max())
    return low > max(DRIFT_N, 2 * high)


def _unit(table: dict[str, float], unit: Any, where: str) -> float:
    if str(unit) not in table:
        raise InputError(f"unknown unit '{unit}'", where=where, hint=f"use one of {', '.join(table)}")
    return table[str(unit)]
