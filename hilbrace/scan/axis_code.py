"""One axis of the projector as the camera's pixels see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Integer

Array = np.ndarray


@dataclass(frozen=True)
class AxisCode:
    """Where on one axis of the projector the light of each pixel comes from.

    Attributes:
        place: Column or row of the projector [px], not a number where unknown.
        error: Its standard deviation from the pictures' noise [px].
        code: Gray code.
        inside: Place inside the period as the phase tells it [px]; not a number where it is lost.
        even: Mean of all stripes and their inverses, the scene under even light with little noise [grey
            levels].
    """

    place: Float[Array, "row column"]
    error: Float[Array, "row column"]
    code: Integer[Array, "row column"]
    inside: Float[Array, "row column"]
    even: Float[Array, "row column"]
