"""A made-up study with planted truth: a synthetic reproduction of the processing, never of the measurement.

Six conditions of five tennis-serve-like trials as C3D files: a deep bend, a jump, a landing. The angles at
both peaks scatter between repeats about means that are the roots of the values the paper published; signs are
not in the paper and are chosen here (braces bend less, the knee falls into abduction). The files hold cluster
markers with noise, gaps, soft tissue that wobbles, and repeats that differ in pace.

    python -m mocks.synthetic_study FOLDER --seed 3
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomli_w
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from evaluation.c3d_writer import write_c3d
from evaluation.published import published_rows
from hilbrace.motion.force_plates import PlateForces
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.motion.recording import Recording
from hilbrace.units import GRAVITY
from mocks import synthetic_limb as limb

UNBRACED_FLEXION_DEG = (70.0, 60.0)
"""Flexion at the bending and the landing peak without a brace."""

MASS_KG = 64.0
SIDE = "left"


@dataclass(frozen=True)
class Scatter:
    """What makes repeats differ and markers err.

    Attributes:
        sagittal_deg: Standard deviation of the sagittal peaks between repeats [deg].
        frontal_deg: The same in the frontal plane [deg].
        pace_s: Standard deviation of the time from bending to landing [s].
        noise_mm: Standard deviation of each marker coordinate [mm].
        wobble_mm: Size of the slow movement of each marker on its segment [mm].
        gaps: Gaps of single cluster markers in each trial, one after the other.
    """

    sagittal_deg: float = 2.0
    frontal_deg: float = 0.5
    pace_s: float = 0.015
    noise_mm: float = 0.3
    wobble_mm: float = 1.0
    gaps: int = 4


def planted_angles() -> dict[str, np.ndarray]:
    """True mean angles by condition [deg]: (bending, landing) x (sagittal, frontal), extension positive."""
    planted = {}
    for key, row in published_rows().items():
        sagittal = np.sqrt(row.squared[:, 0]) - np.array(UNBRACED_FLEXION_DEG)
        planted[key] = np.column_stack([sagittal, -np.sqrt(row.squared[:, 1])])
    return planted


def planted_squares() -> np.ndarray:
    """The table that an error-free evaluation returns [deg^2], (condition, event, plane)."""
    return np.stack([row.squared for row in published_rows().values()])


def standing_recording(seed: int, scatter: Scatter, rate_hz: float = 200.0) -> Recording:
    """The person standing for two seconds, feet flat."""
    pose = limb.standing(round(2 * rate_hz))
    return Recording(
        _table(pose, np.random.default_rng([seed, 999]), scatter, rate_hz, wobble=False), None, ()
    )


def trial_recording(
    angles_deg: np.ndarray, rng: np.random.Generator, scatter: Scatter, seconds: float, rate_hz: float = 200.0
) -> Recording:
    """One repeat whose angles scatter about the given means."""
    peaks = angles_deg + rng.normal(0, 1, (2, 2)) * [scatter.sagittal_deg, scatter.frontal_deg]
    bending = 0.35 * seconds + rng.normal(0, 0.04)
    landing = bending + 0.95 + rng.normal(0, scatter.pace_s)
    flight = (bending + 0.35, landing - 0.2)
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    rest = np.array([-6.0, 0.0])
    knots = np.array([0.0, bending - 0.75, bending, flight[0] + 0.1, flight[1] - 0.05, landing,
                      landing + 0.7, max(seconds, landing + 1.0)])  # fmt: skip
    shape = np.stack([rest, rest, peaks[0], rest * [2, 1], rest * [2.2, 1], peaks[1], rest, rest])
    knee = np.zeros((len(time), 3))
    knee[:, :2] = PchipInterpolator(knots, shape)(time)
    knee[:, 2] = 4 * np.sin(2 * time)
    lean = np.column_stack([0.2 * np.sin(time), 25 * np.sin(0.9 * time), -knee[:, 0] / 2])
    drop = 0.35 * (1 - np.cos(np.deg2rad(knee[:, 0] + 6)))
    airborne = np.clip(time, *flight) - flight[0]
    rise = GRAVITY / 2 * airborne * (flight[1] - flight[0] - airborne)
    hip = np.column_stack([0.3 * time, 0.9 - drop + rise, 0.05 * np.sin(time)])
    pose = limb.Pose(hip, Rotation.from_euler("XYZ", lean, degrees=True).as_matrix(), knee, 0 * knee)
    return Recording(
        _table(pose, rng, scatter, rate_hz, wobble=True), _plate(flight, len(time), rate_hz, hip), ()
    )


def study_recordings(seed: int, scatter: Scatter, seconds: float, repeats: int) -> dict[str, list[Recording]]:
    """Repeats of every condition."""
    return {
        key: [
            trial_recording(angles, np.random.default_rng([seed, k, repeat]), scatter, seconds)
            for repeat in range(repeats)
        ]
        for k, (key, angles) in enumerate(planted_angles().items())
    }


def study_document(repeats: int) -> dict:
    """The study file that measures what was written."""
    return {
        "name": "Synthetic reproduction of the processing",
        "subject": "nobody",
        "synthetic": True,
        "standing": "standing.c3d",
        "baseline": "Unbraced",
        "protocol": {
            "side": SIDE,
            "hip": {"model": "marker"},
            "processing": {"cutoff_hz": 12.0},
        },
        "conditions": [
            {
                "name": row.title,
                "published": key,
                "trials": [f"{key}_{repeat + 1}.c3d" for repeat in range(repeats)],
            }
            for key, row in published_rows().items()
        ],
    }


def write_study(
    folder: Path, seed: int = 0, scatter: Scatter | None = None, seconds: float = 4.0, repeats: int = 5
) -> Path:
    """Write standing trial, repeats and study file; returns the study file."""
    scatter = scatter or Scatter()
    folder.mkdir(parents=True, exist_ok=True)
    write_c3d(folder / "standing.c3d", standing_recording(seed, scatter), prefix="Nobody")
    for key, trials in study_recordings(seed, scatter, seconds, repeats).items():
        for number, trial in enumerate(trials, 1):
            write_c3d(folder / f"{key}_{number}.c3d", trial, prefix="Nobody")
    path = folder / "study.toml"
    path.write_text(tomli_w.dumps(study_document(repeats)), "utf-8")
    return path


def _table(
    pose: limb.Pose, rng: np.random.Generator, scatter: Scatter, rate_hz: float, wobble: bool
) -> MarkerTable:
    names = tuple(name for name in limb.NAMES if name not in limb.FOOT)
    positions = limb.stacked(limb.markers(pose, SIDE), names)
    time = np.arange(len(positions)) / rate_hz
    if wobble:
        frequency, phase = rng.uniform(0.5, 2.5, (2, *positions.shape[1:]))
        swing = np.sin(2 * np.pi * frequency * time[:, None, None] + 9 * phase)
        positions = positions + 1e-3 * scatter.wobble_mm * swing
    positions = positions + 1e-3 * scatter.noise_mm * rng.normal(size=positions.shape)
    clusters = [names.index(name) for cluster in limb.CLUSTERS.values() for name in cluster]
    slots = np.array_split(np.arange(len(time)), scatter.gaps) if wobble and scatter.gaps else []
    for slot in slots:
        start = int(rng.integers(slot[0], slot[-1] - 40))
        positions[start : start + int(rng.integers(5, 40)), rng.choice(clusters)] = np.nan
    return MarkerTable(names, time, rate_hz, positions)


def _plate(flight: tuple[float, float], frames: int, rate_hz: float, hip: np.ndarray) -> PlateForces:
    """One plate that carries the weight, nothing in flight, and the impact after it."""
    per_frame = 5
    time = np.arange(frames * per_frame) / (rate_hz * per_frame)
    weight = MASS_KG * GRAVITY
    after = np.maximum(time - flight[1], 0.0)
    vertical = weight * (1 + 2.2 * np.exp(-after / 0.06) * (after > 0))
    vertical[(time >= flight[0]) & (time <= flight[1])] = 0.0
    force = np.zeros((len(time), 1, 3))
    force[:, 0, 1] = vertical
    point = np.tile([hip[0, 0], 0.0, 0.0], (len(time), 1, 1))
    rate = rate_hz * per_frame
    return PlateForces("synthetic", ("1",), ("plate 1",), time, rate, force, point, np.zeros_like(force))


def main() -> None:
    """Write a study from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    write_study(options.folder, options.seed, seconds=options.seconds, repeats=options.repeats)


if __name__ == "__main__":
    main()
