"""Ground reactions of the GroundLink data set: a file of tensors, without motion, rate or mass.

Han et al., "GroundLink: A dataset unifying human body movement and ground reaction dynamics", SIGGRAPH Asia
2023. A file holds ``GRF`` (sample, foot, 3) in body weights and ``CoP`` (sample, foot, 3) in metres, left
foot first, in a laboratory whose third axis points up, and often a network's ``prediction``, which is not
used.
"""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.force_plates import PlateForces
from hilbrace.units import GRAVITY

Array = np.ndarray

FEET_IN_FILE = ("left", "right")
_DAMAGE = (
    *(OSError, RuntimeError, ValueError, EOFError, LookupError, TypeError, AttributeError),
    zipfile.BadZipFile,
)
"""What reading a damaged file raises; each opcode of its index may be anything."""
LOWEST_PEAK_BW, HIGHEST_PEAK_BW = 0.5, 15.0
"""Plausible peaks of the vertical force of both feet together [body weights]."""


def read_groundlink(path: Path, rate_hz: float | None, mass_kg: float | None) -> PlateForces:
    """Read the measured ground reactions of a GroundLink file, turned to y up and into newtons.

    Nothing in the file is executed: only tensors are read. Its first sample counts as the instant 0.

    Args:
        path: A ``.pth`` file.
        rate_hz: Samples per second, which the file does not say [Hz].
        mass_kg: The subject's mass, which turns body weights into newtons [kg].

    Raises:
        ConfigError: Rate or mass is not given.
        InputError: The file is missing, damaged, holds something else than tensors, or no forces.
    """
    if rate_hz is None or mass_kg is None:
        lacking = "subject.mass_kg" if rate_hz is not None else "motion.forces_rate_hz"
        raise ConfigError(
            f"a GroundLink file needs {lacking}",
            where=str(path),
            hint="the file holds body weights without a rate: give motion.forces_rate_hz and subject.mass_kg",
        )
    tensors = _tensors(path)
    force, point = (_array(tensors, name, path) for name in ("GRF", "CoP"))
    if force.shape != point.shape:
        raise InputError(
            f"GRF has the shape {force.shape}, CoP {point.shape}", where=str(path), hint="download it again"
        )
    peak = float(force[..., 2].sum(axis=1).max())
    if not LOWEST_PEAK_BW <= peak <= HIGHEST_PEAK_BW:
        raise InputError(
            f"the vertical force, third of GRF, peaks at {peak:.3g} body weights",
            where=str(path),
            hint="GroundLink files hold body weights with the third axis up; convert others to a MOT file",
        )
    time = np.arange(len(force)) / rate_hz
    up = (0, 2, 1)
    mirrored = np.array([1.0, 1.0, -1.0])  # (x, y, z) becomes (x, z, -y)
    newtons = force[..., up] * mirrored * mass_kg * GRAVITY
    return PlateForces(
        source=str(path),
        names=FEET_IN_FILE,
        labels=tuple(f"GRF of the {foot} foot" for foot in FEET_IN_FILE),
        time=time,
        rate_hz=rate_hz,
        force=newtons,
        point=point[..., up] * mirrored,
        torque=np.zeros_like(newtons),
    )


def check_clock(plates: PlateForces, marker_time: Float[Array, " frame"], marker_rate_hz: float) -> None:
    """Refuse forces that do not last as long as the markers: nothing else tells that both belong together.

    Args:
        plates: Ground reactions of a file without a clock.
        marker_time: The markers' instants [s].
        marker_rate_hz: The markers' rate [Hz].

    Raises:
        InputError: The lengths differ by more than two frames of the markers and one percent.
    """
    forces_s, markers_s = len(plates.time) / plates.rate_hz, len(marker_time) / marker_rate_hz
    if abs(forces_s - markers_s) > max(2.0 / marker_rate_hz, 0.01 * markers_s):
        fitting = len(plates.time) / markers_s
        raise InputError(
            f"{len(plates.time)} samples at {plates.rate_hz:g} Hz last {forces_s:.2f} s, the markers "
            f"{markers_s:.2f} s",
            where=plates.source,
            hint=f"correct motion.forces_rate_hz ({fitting:.4g} Hz would fit), or name this motion's forces",
        )


def _tensors(path: Path) -> dict[str, Any]:
    import torch

    try:
        if path.is_file() and not zipfile.is_zipfile(path):
            raise InputError(
                "no file of tensors, or cut short", where=str(path), hint="download it again, or save it anew"
            )
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError("no such file", where=str(path), hint="check motion.forces") from None
    except pickle.UnpicklingError:
        raise InputError(
            "the file holds more than tensors, and nothing in it is executed",
            where=str(path),
            hint="save a dict of the tensors GRF and CoP alone",
        ) from None
    except _DAMAGE as fault:
        reason = str(fault).strip().splitlines()[:1]
        raise InputError(
            f"no readable file of tensors: {''.join(reason)[:120]}", where=str(path), hint="download it again"
        ) from None
    if not isinstance(content, dict):
        raise InputError(
            f"holds a {type(content).__name__}, not GRF and CoP by name",
            where=str(path),
            hint="name a file of GroundLink",
        )
    return content


def _array(tensors: dict[str, Any], name: str, path: Path) -> Float[Array, "sample 2 3"]:
    if name not in tensors or not hasattr(tensors[name], "numpy"):
        raise InputError(
            f"there is no tensor '{name}' among {', '.join(map(str, tensors)) or 'nothing'}",
            where=str(path),
            hint="name a file of GroundLink, with GRF and CoP",
        )
    values = np.asarray(tensors[name].numpy(), dtype=float)
    if values.ndim != 3 or values.shape[1:] != (2, 3) or not len(values):
        raise InputError(
            f"{name} has the shape {values.shape}, not (sample, foot, 3)",
            where=str(path),
            hint="check the file",
        )
    if not np.isfinite(values).all():
        sample = int(np.argwhere(~np.isfinite(values))[0][0])
        raise InputError(
            f"{name} is no number in sample {sample + 1}", where=str(path), hint="download it again"
        )
    return values
