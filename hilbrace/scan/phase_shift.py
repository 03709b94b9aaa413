"""Phase of shifted cosines: the place inside a period of the pattern.

With pictures I_n = A + B cos(phi + 2 pi n / N) the phase is phi = atan2(-sum I_n sin, sum I_n cos) and the
modulation B = 2/N |sum I_n exp(-i 2 pi n / N)| (Srinivasan, Liu & Halioua 1984); white noise sigma of the
pictures gives the phase the variance 2 sigma^2 / (N B^2).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

Array = np.ndarray


def phase_and_modulation(
    pictures: Iterable[Float[Array, "row column"]], steps: int
) -> tuple[Float[Array, "row column"], Float[Array, "row column"]]:
    """Phase [rad] in [0, 2 pi) and modulation [grey levels].

    Args:
        pictures: The shifted cosines in their order, read one at a time.
        steps: Number of shifts.
    """
    sine = cosine = np.zeros((1, 1), dtype=np.float32)
    for step, picture in enumerate(pictures):
        angle = 2.0 * np.pi * step / steps
        sine = sine + np.float32(np.sin(angle)) * picture
        cosine = cosine + np.float32(np.cos(angle)) * picture
    phase = np.mod(np.arctan2(-sine, cosine), np.float32(2.0 * np.pi))
    return phase, np.float32(2.0 / steps) * np.hypot(sine, cosine)


def resolved(
    inside: Float[Array, "*pixel"], middle: Float[Array, "*pixel"], period: int
) -> Float[Array, "*pixel"]:
    """Place on the projector [px]: the period that brings the phase nearest to the Gray code's cell.

    Args:
        inside: Place inside the period, the phase as a length [px].
        middle: Middle of the cell of the Gray code [px].
        period: Length of the cosine [px].
    """
    return np.rint((middle - inside) / period).astype(np.float32) * np.float32(period) + inside


def place_error(
    modulation: Float[Array, "row column"], noise: float, period: int, steps: int
) -> Float[Array, "row column"]:
    """Standard deviation of the place that noise of the pictures causes [px].

    Args:
        modulation: Modulation [grey levels].
        noise: Standard deviation of the pictures' noise [grey levels].
        period: Length of the cosine [px].
        steps: Number of shifts.
    """
    scale = np.float32(period / (2.0 * np.pi) * noise * np.sqrt(2.0 / steps))
    return scale / np.maximum(modulation, np.float32(1e-6))
