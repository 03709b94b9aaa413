"""Is there light, and not too much of it?"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from hilbrace.errors import InputError
from hilbrace.scan.capture import Capture

Array = np.ndarray

SATURATED = 253.0
"""Grey level from which a pixel counts as over-exposed, of 255."""
LEAST_CONTRAST = 8.0
"""White less black below which a pixel counts as unlit [grey levels]."""
MOST_SATURATED = 0.25
"""Part of the lit pixels that may be over-exposed before the capture is refused [-]."""
LEAST_LIT = 0.01
"""Part of the picture that must be lit [-]."""


@dataclass(frozen=True)
class Exposure:
    """What the white and the black picture say.

    Attributes:
        contrast: White less black [grey levels].
        total: White and black together [grey levels].
        lit: Pixels that the projector reaches.
        saturated: Lit pixels that are over-exposed.
    """

    contrast: Float[Array, "row column"]
    total: Float[Array, "row column"]
    lit: Bool[Array, "row column"]
    saturated: Bool[Array, "row column"]


def examine_exposure(
    capture: Capture, white: Float[Array, "row column"], black: Float[Array, "row column"], noise: float
) -> Exposure:
    """Contrast of white and black.

    Args:
        capture: Names the files in errors.
        white: Picture under full light [grey levels].
        black: Picture under no light of the projector [grey levels].
        noise: Standard deviation of the pictures' noise [grey levels].

    Raises:
        InputError: White and black are exchanged, or the pictures are too dark or too bright.
    """
    contrast = white - black
    least = max(LEAST_CONTRAST, 5.0 * noise)
    bright, dark = (str(capture.files[capture.place(kind)]) for kind in ("white", "black"))
    if (contrast < -least).mean() > max(LEAST_LIT, float((contrast > least).mean())):
        raise InputError(
            f"darker than the picture of black, {dark}",
            where=bright,
            hint="the first two pictures must be white, then black; are they exchanged?",
        )
    lit = contrast > least
    saturated = lit & (capture.brightest(capture.place("white")) >= SATURATED)
    over = float(saturated.sum() / max(int(lit.sum()), 1))
    if float((black >= SATURATED).mean()) > 0.5 or over > MOST_SATURATED:
        raise InputError(
            f"{100 * max(over, float((black >= SATURATED).mean())):.0f} % of the lit pixels are over-exposed",
            where=bright,
            hint="halve the exposure time or close the aperture until white skin stays below 240 of 255,"
            " and take the capture again",
        )
    if lit.mean() < LEAST_LIT:
        raise InputError(
            f"only {100 * lit.mean():.1f} % of the picture is brighter by {least:.0f} grey levels than the"
            f" picture of black, {dark}",
            where=bright,
            hint="expose longer, darken the room, or check that the projector showed the pattern",
        )
    return Exposure(contrast, white + black, lit, saturated)


def picture_noise(picture: Float[Array, "row column"]) -> float:
    """Standard deviation of a picture's noise [grey levels], at least half a level.

    From a mask that cancels planes and edges (Immerkaer 1996), with the median for the mean.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    response = np.abs(cv2.filter2D(picture, cv2.CV_32F, mask)[1:-1, 1:-1])
    return max(0.5, float(np.median(response[::2, ::2])) / (6.0 * 0.6745))
