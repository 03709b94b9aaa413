"""A moving leg with known angles, and the records the laboratory code reads it from."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from evaluation.calibration import calibrate
from evaluation.protocol import HipSettings, MarkerLabels, Processing, Protocol
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.motion.recording import Recording
from mocks import synthetic_limb as limb

RATE_HZ = 200.0


def protocol(side="left", foot=False, hip=None, **processing) -> Protocol:
    """The 13 markers, with the marker as hip centre; markers unfiltered unless asked for."""
    labels = MarkerLabels(foot=("HEE", "TOE", "MT5"), heel="HEE", toe="TOE") if foot else MarkerLabels()
    return Protocol(
        side=side,
        markers=labels,
        hip=hip or HipSettings(model="marker"),
        processing=Processing(**({"cutoff_hz": 0.0} | processing)),
    )


def moving(frames=2000) -> limb.Pose:
    """Slow movement through 75 degrees of flexion while the thigh swings and turns."""
    at = np.linspace(0, 1, frames)
    knee = np.column_stack([-40 - 35 * np.sin(12 * at), 4 * np.sin(7 * at), 6 * np.cos(5 * at)])
    ankle = np.column_stack([10 * np.sin(8 * at), 5 * np.cos(6 * at), 3 * np.sin(4 * at)])
    thigh = Rotation.from_euler("YZX", np.column_stack([60 * at, 30 * np.sin(6 * at), 8 * at]), degrees=True)
    hip = np.column_stack([2 * at, 0.9 + 0.05 * np.cos(9 * at), 0.1 * np.sin(9 * at)])
    return limb.Pose(hip, thigh.as_matrix(), knee, ankle)


def table(pose: limb.Pose, side="left", names=limb.NAMES) -> MarkerTable:
    """Markers of a pose at 200 Hz."""
    positions = limb.stacked(limb.markers(pose, side), names)
    return MarkerTable(tuple(names), np.arange(len(positions)) / RATE_HZ, RATE_HZ, positions)


def calibrated(rules: Protocol, moved: dict[str, tuple[float, float, float]] | None = None):
    """The leg calibrated while standing; landmarks may be put at wrong places [m]."""
    standing = table(limb.standing(50), rules.side)
    for name, shift in (moved or {}).items():
        standing.positions[:, standing.names.index(name)] += shift
    return calibrate(Recording(standing, None, ()), rules, "standing.c3d")
