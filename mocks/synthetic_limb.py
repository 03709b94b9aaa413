"""A leg of rigid segments whose angles are known exactly, with the protocol's 13 markers and a foot.

y up, metres. The markers follow from given angles through scipy's rotations, not through the code under test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

THIGH_M, SHANK_M = 0.42, 0.41

THIGH = {
    "HIP": (0.0, 0.0, 0.0),
    "KNL": (0.0, -THIGH_M, 0.05),
    "KNM": (0.0, -THIGH_M, -0.05),
    "TH1": (0.02, -0.15, 0.07),
    "TH2": (0.055, -0.16, 0.06),
    "TH3": (0.015, -0.26, 0.072),
    "TH4": (0.058, -0.255, 0.058),
}
SHANK = {
    "ANL": (0.0, -SHANK_M, 0.038),
    "ANM": (0.0, -SHANK_M, -0.038),
    "SH1": (0.03, -0.13, 0.045),
    "SH2": (0.055, -0.15, 0.04),
    "SH3": (0.028, -0.23, 0.046),
    "SH4": (0.052, -0.24, 0.036),
}
FOOT = {"HEE": (-0.05, -0.06, 0.0), "TOE": (0.15, -0.06, 0.0), "MT5": (0.11, -0.055, 0.045)}
"""Places in the frame of the right segment, from its proximal joint [m]: anterior, up, right."""

NAMES = (*THIGH, *SHANK, *FOOT)
CLUSTERS = {"thigh": ("TH1", "TH2", "TH3", "TH4"), "shank": ("SH1", "SH2", "SH3", "SH4")}


@dataclass(frozen=True)
class Pose:
    """A leg over time.

    Attributes:
        hip: Path of the hip [m], (frame, 3).
        thigh: Orientation of the thigh, (frame, 3, 3).
        knee_deg: Anatomical knee angles [deg], (frame, 3).
        ankle_deg: Anatomical ankle angles [deg], (frame, 3).
    """

    hip: np.ndarray
    thigh: np.ndarray
    knee_deg: np.ndarray
    ankle_deg: np.ndarray


def standing(frames: int) -> Pose:
    """Upright, knees straight, feet flat."""
    return Pose(
        np.tile([0.0, 0.9, 0.0], (frames, 1)),
        np.tile(np.eye(3), (frames, 1, 1)),
        np.zeros((frames, 3)),
        np.zeros((frames, 3)),
    )


def markers(pose: Pose, side: str) -> dict[str, np.ndarray]:
    """Paths of all markers [m] by name."""
    out = np.array([1.0, 1.0, 1.0 if side == "right" else -1.0])
    mirror = np.array([1.0, 1.0, 1.0]) if side == "right" else np.array([1.0, -1.0, -1.0])
    shank = pose.thigh @ _turn(pose.knee_deg * mirror)
    foot = shank @ _turn(pose.ankle_deg * mirror)
    knee = pose.hip + pose.thigh @ np.array([0.0, -THIGH_M, 0.0])
    ankle = knee + shank @ np.array([0.0, -SHANK_M, 0.0])
    places = ((pose.hip, pose.thigh, THIGH), (knee, shank, SHANK), (ankle, foot, FOOT))
    return {
        name: start + axes @ (np.array(place) * out)
        for start, axes, segment in places
        for name, place in segment.items()
    }


def stacked(paths: dict[str, np.ndarray], names: tuple[str, ...] = NAMES) -> np.ndarray:
    """(frame, marker, 3) of some markers."""
    return np.stack([paths[name] for name in names], axis=1)


def _turn(angles_deg: np.ndarray) -> np.ndarray:
    return Rotation.from_euler("ZXY", angles_deg, degrees=True).as_matrix()
