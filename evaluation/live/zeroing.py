"""The zero of a plate that is asked for while devices run."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from evaluation.plate_zero import PlateZero, measure_zero
from evaluation.sources.stream import LabError, PlateInfo

Array = np.ndarray


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
    now = time.monotonic_ns()
    before = None if previous is None else PlateZero(plate.name, np.array(previous), 0.0, 0, now)
    return measure_zero(plate, values, now, before).counts
