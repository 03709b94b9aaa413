"""What a mock marker system sees: recordings played one after the other, with one force plate.

The laboratory is z-up. The plate's own z axis points down, as those of AMTI do, and it states the load on
itself, so that a client that forgets to turn the axes or the sign finds its subject pulled to the floor.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evaluation.c3d_writer import z_up
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.recording import Recording, read_recording
from mocks import synthetic_study

PLATE_ROTATION = np.diag([1.0, -1.0, -1.0])
PLATE_SIZE_M = (0.6, 0.4)


@dataclass(frozen=True)
class Scene:
    """Everything that is played.

    Attributes:
        labels: Names of the markers.
        rate_hz: Frames per second [Hz].
        positions: Markers in the laboratory [m], (frame, marker, 3); NaN where occluded.
        loads: Force [N] and moment [N*m] on the plate in its axes, (frame, sample, 6).
        centres: Centre of pressure in the plate's axes [m], (frame, sample, 3).
        plate_origin: Middle of the plate in the laboratory [m].
    """

    labels: tuple[str, ...]
    rate_hz: float
    positions: np.ndarray
    loads: np.ndarray
    centres: np.ndarray
    plate_origin: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def samples(self) -> int:
        """Plate samples per frame."""
        return self.loads.shape[1]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options that choose what is played."""
    group = parser.add_argument_group("scene")
    group.add_argument("recordings", nargs="*", type=Path, metavar="C3D",
                       help="files to play one after the other; without any, a synthetic trial")  # fmt: skip
    group.add_argument("--study-seed", type=int, default=0, help="seed of the synthetic trial")
    group.add_argument("--once", action="store_true", help="close the line after the last frame; else loop")
    group.add_argument("--speed", type=float, default=1.0, help="how much faster than real time to play")


def from_options(options: argparse.Namespace) -> Scene:
    """The scene that the command line asks for."""
    return from_files(options.recordings) if options.recordings else synthetic(options.study_seed)


def synthetic(seed: int = 0) -> Scene:
    """The leg standing, then bending, jumping and landing without a brace."""
    scatter = synthetic_study.Scatter()
    angles = synthetic_study.planted_angles()["unbraced"]
    trial = synthetic_study.trial_recording(angles, np.random.default_rng(seed), scatter, 4.0)
    return from_recordings([synthetic_study.standing_recording(seed, scatter), trial])


def from_files(paths: Sequence[Path]) -> Scene:
    """C3D files one after the other."""
    with C3DReader() as reader:
        return from_recordings([read_recording(path, None, None, reader) for path in paths])


def from_recordings(recordings: Sequence[Recording]) -> Scene:
    """Recordings, y up, one after the other; those without a plate leave it unloaded."""
    first = recordings[0].markers
    rates = [r.plates.rate_hz / r.markers.rate_hz for r in recordings if r.plates is not None]
    samples = round(rates[0]) if rates else 5
    if any(r.markers.names != first.names or r.markers.rate_hz != first.rate_hz for r in recordings):
        raise SystemExit("the recordings differ in markers or rate")
    origin = _plate_origin(recordings)
    plates = [_plate(recording, samples, origin) for recording in recordings]
    return Scene(
        first.names,
        first.rate_hz,
        np.concatenate([z_up(recording.markers.positions) for recording in recordings]),
        np.concatenate([loads for loads, _ in plates]),
        np.concatenate([centres for _, centres in plates]),
        origin,
    )


def _plate_origin(recordings: Sequence[Recording]) -> np.ndarray:
    points = [r.plates.point[:, 0][r.plates.force[:, 0, 1] > 20] for r in recordings if r.plates is not None]
    loaded = np.concatenate([*points, np.zeros((0, 3))])
    return z_up(np.median(loaded, axis=0)) if len(loaded) else np.zeros(3)


def _plate(recording: Recording, samples: int, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    frames = len(recording.markers.time)
    plates = recording.plates
    if plates is None:
        return np.zeros((frames, samples, 6)), np.zeros((frames, samples, 3))
    force = -z_up(plates.force[:, 0]) @ PLATE_ROTATION
    torque = -z_up(plates.torque[:, 0]) @ PLATE_ROTATION
    centre = (np.nan_to_num(z_up(plates.point[:, 0]), nan=0.0) - origin) @ PLATE_ROTATION
    centre[np.linalg.norm(force, axis=1) == 0] = 0.0
    moment = np.cross(centre, force) + torque
    shape = (frames, samples, -1)
    return np.hstack([force, moment])[: frames * samples].reshape(shape), centre.reshape(shape)
