"""The synthetic laboratory's C3D files: z up, millimetres, force plates of type 2.

Plate frames as ezc3d (and the C3D convention) expects them: z down, so that a loaded plate reads a negative
Fz; x along the walkway; corners in the order (+x +y), (-x +y), (-x -y), (+x -y) of the plate.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
from jaxtyping import Float

from hilbrace.motion.synthetic.forces import FEET, FootForces
from hilbrace.motion.synthetic.generate import SyntheticMotion
from hilbrace.motion.synthetic.plan import Plate
from hilbrace.units import MM_PER_M

Array = np.ndarray

ANALOG_PER_FRAME = 5
"""Analog samples per marker frame."""

_CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
_TO_PLATE = np.array([1.0, -1.0, -1.0])


def to_laboratory(vector: Float[Array, "*many 3"]) -> Float[Array, "*many 3"]:
    """From the OpenSim frame (y up) to the laboratory's (z up, y to the left)."""
    return np.stack([vector[..., 0], -vector[..., 2], vector[..., 1]], axis=-1)


def write_c3d(
    path: Path,
    motion: SyntheticMotion,
    time: Float[Array, " frame"],
    markers: Float[Array, "frame marker 3"],
    forces: FootForces,
    plates: tuple[Plate, ...],
) -> None:
    """Write one trial.

    Args:
        path: File to write.
        motion: The motion that the trial belongs to: names, rate, subject.
        time: Instants [s].
        markers: Marker positions [m].
        forces: Ground reactions.
        plates: Force plates; each reads the load of its foot within its interval.
    """
    content = ezc3d.c3d()
    _put_markers(content, motion, markers)
    channels = [plate_channels(plate, time, forces) for plate in plates]
    _put_plates(content, motion.rate_hz, plates, np.concatenate(channels))
    content.add_parameter("SUBJECTS", "NAMES", ["synthetic"])
    content.add_parameter("MANUFACTURER", "COMPANY", ["synthetic, not a measurement"])
    content.add_parameter("PROCESSING", "Bodymass", [motion.mass_kg])
    content.add_parameter("PROCESSING", "Height", [MM_PER_M * motion.height_m])
    content.write(str(path))


def plate_channels(
    plate: Plate, time: Float[Array, " frame"], forces: FootForces
) -> Float[Array, "channel sample"]:
    """What a plate reads: force [N] and moment about its centre [N*mm], in its own frame.

    Samples between the marker frames are linear between their neighbours.
    """
    foot = FEET.index(plate.foot)
    first, last = plate.interval
    loads = (time >= first - 1e-9) & (time <= last + 1e-9) & (forces.force[:, foot, 1] > 0)
    force = to_laboratory(forces.force[:, foot])
    arm = to_laboratory(forces.centre_of_pressure[:, foot]) - [plate.centre[0], -plate.centre[1], 0.0]
    moment = np.cross(arm, force)
    moment[:, 2] += forces.free_moment[:, foot]
    values = np.concatenate([force * _TO_PLATE, MM_PER_M * moment * _TO_PLATE], axis=1)
    values[~loads] = 0.0
    frames = np.arange(ANALOG_PER_FRAME * len(time)) / ANALOG_PER_FRAME
    return np.stack([np.interp(frames, np.arange(len(time)), column) for column in values.T])


def plate_corners(plate: Plate) -> Float[Array, "3 corner"]:
    """Corners in the laboratory [mm]."""
    (x, z), (length, width) = plate.centre, plate.half
    signs = ((1, -1), (-1, -1), (-1, 1), (1, 1))
    return MM_PER_M * np.array([[x + a * length, -z + b * width, 0.0] for a, b in signs]).T


def _put_markers(content: Any, motion: SyntheticMotion, markers: Float[Array, "frame marker 3"]) -> None:
    points = np.ones((4, markers.shape[1], markers.shape[0]))
    points[:3] = MM_PER_M * to_laboratory(markers).transpose(2, 1, 0)
    group = content["parameters"]["POINT"]
    group["RATE"]["value"] = [float(motion.rate_hz)]
    group["LABELS"]["value"] = list(motion.marker_names)
    group["DESCRIPTIONS"]["value"] = ["synthetic"] * len(motion.marker_names)
    group["UNITS"]["value"] = ["mm"]
    content["data"]["points"] = points


def _put_plates(
    content: Any, rate_hz: float, plates: tuple[Plate, ...], channels: Float[Array, "channel sample"]
) -> None:
    """Analog channels and the parameters of the plates.

    Values are set in place: ``add_parameter`` would store whole numbers as floats, which readers refuse.
    """
    count = len(plates)
    analog = content["parameters"]["ANALOG"]
    analog["RATE"]["value"] = [float(rate_hz * ANALOG_PER_FRAME)]
    analog["LABELS"]["value"] = [f"{name}{k}" for k in range(1, count + 1) for name in _CHANNELS]
    analog["DESCRIPTIONS"]["value"] = ["synthetic"] * (6 * count)
    analog["UNITS"]["value"] = ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * count
    analog["SCALE"]["value"] = [1.0] * (6 * count)
    analog["OFFSET"]["value"] = [0] * (6 * count)
    analog["GEN_SCALE"]["value"] = [1.0]
    content["data"]["analogs"] = channels[None]
    group = content["parameters"]["FORCE_PLATFORM"]
    values = {
        "USED": [count],
        "TYPE": [2] * count,
        "ZERO": [1, 0],
        "CORNERS": np.stack([plate_corners(plate) for plate in plates], axis=-1),
        "ORIGIN": np.zeros((3, count)),
        "CHANNEL": np.arange(1, 6 * count + 1).reshape(count, 6).T,
    }
    for key, value in values.items():
        group[key]["value"] = value
