"""The zero of a plate that is asked for while devices run."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from evaluation.plate_calibration import PlateCalibration
from evaluation.plate_zero import PlateZero, measure_zero
from evaluation.sources.stream import LabError, PlateInfo

Array = np.ndarray

NOISE_N = 2.0
"""Noise of the vertical force of a plate whose calibration does not say it [N]."""


def empty_plate(
    plate: PlateInfo, values: Float[Array, "sample channel"] | None, previous: Sequence[float] | None
) -> Float[Array, " channel"]:
    """Channels of a plate that was empty and still.

    Args:
        plate: The plate.
        values: Samples of more than a second; ``None`` if it sent none.
        previous: Channels of the zero before, if there was one.

    Raises:
        LabError: The plate sent nothing.
        InputError: It was not empty and still.
    """
    if values is None:
        raise LabError(
            f"plate '{plate.name}' sends nothing", where="zero", hint="check its cable and its power"
        )
    count = plate.calibration.shape[1]
    calibration = PlateCalibration(
        name=plate.name,
        matrix=plate.calibration,
        z_axis="up" if plate.rotation[2, 2] > 0 else "down",
        surface_z=0.0,
        surface_size=(float("nan"), float("nan")),
        noise_n=NOISE_N,
        empty=np.full(count, np.nan),
    )
    now = time.monotonic_ns()
    before = None if previous is None else PlateZero(plate.name, np.array(previous), 0.0, 0, now)
    return measure_zero(plate.name, values, plate.rate_hz, calibration, now, before).counts
