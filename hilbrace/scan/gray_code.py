"""Gray code: which cell of the projector lights a pixel.

Neighbouring cells differ in one bit, so a bit misread at the border of two stripes costs one cell at most.
OpenCV's own decoder (`GrayCodePattern.getProjPixel`) takes one pixel a call, 74 us each, and returns True
where decoding failed; this one reads whole pictures.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, Integer

Array = np.ndarray


def add_bit(
    code: Integer[Array, "*pixel"], picture: Float[Array, "*pixel"], inverse: Float[Array, "*pixel"]
) -> Integer[Array, "*pixel"]:
    """Append the next finer bit, which is 1 where the picture is brighter than its inverse."""
    return (code << np.uint32(1)) | (picture > inverse)


def cell_numbers(code: Integer[Array, "*pixel"]) -> Int[Array, "*pixel"]:
    """Numbers of the cells that reflected binary codes stand for."""
    number = code.copy()
    for shift in (16, 8, 4, 2, 1):
        number ^= number >> np.uint32(shift)
    return number.astype(np.int32)


def cell_middles(code: Integer[Array, "*pixel"], cell: int) -> Float[Array, "*pixel"]:
    """Middle of each pixel's cell [px], pixel middles at whole numbers.

    Args:
        code: Gray codes.
        cell: Width of a cell [px].
    """
    return (cell_numbers(code) * cell).astype(np.float32) + np.float32(0.5 * (cell - 1))
