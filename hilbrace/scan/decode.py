"""Which pixel of the projector lights each pixel of the camera, how surely, and what cannot be said.

A pixel counts if the projector reaches it (white against black), if it is not over-exposed, if its cosines
are modulated, and if Gray code and phase agree. The expected error is what the pictures' own noise makes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hilbrace.scan.axis_code import AxisCode
from hilbrace.scan.capture import Capture
from hilbrace.scan.exposure import Exposure, examine_exposure, picture_noise
from hilbrace.scan.gray_code import add_bit, cell_middles
from hilbrace.scan.order_check import check_order, check_pairs, pair_misfit
from hilbrace.scan.patterns import AXES
from hilbrace.scan.phase_shift import phase_and_modulation, place_error, resolved

Array = np.ndarray

LEAST_MODULATION = 0.1
"""Modulation below which a cosine counts as lost, of half the contrast of white and black [-]."""
WORST_ERROR = 0.3
"""Expected error of the place above which a pixel is left out [px]."""
GRAY_ERROR = 12.0**-0.5
"""Standard deviation of a place that is only known to the pixel [px]."""


@dataclass(frozen=True)
class Decoded:
    """A decoded capture.

    Attributes:
        column: Column of the projector that lights each pixel [px]; not a number where unknown.
        row: Its row [px].
        error: Standard deviation of both that the pictures' noise causes, the larger one [px].
        colours: The picture under white light.
        even: Mean of all stripes and their inverses, under even light with little noise [grey levels].
        lit: Pixels that the projector reaches.
        saturated: Lit pixels that are over-exposed.
        noise: Standard deviation of the pictures' noise [grey levels].
        contrast: Median of white less black over decoded pixels [grey levels].
        agreement: Part of the modulated pixels on which Gray code and phase agree; 1 without phase [-].
    """

    column: Float[Array, "row column"]
    row: Float[Array, "row column"]
    error: Float[Array, "row column"]
    colours: UInt8[Array, "row column 3"]
    even: Float[Array, "row column"]
    lit: Bool[Array, "row column"]
    saturated: Bool[Array, "row column"]
    noise: float
    contrast: float
    agreement: float

    @property
    def valid(self) -> Bool[Array, "row column"]:
        """Pixels of which both axes are known."""
        return np.isfinite(self.column)


def decode_capture(capture: Capture) -> Decoded:
    """Decode a capture.

    Raises:
        InputError: A picture cannot be read, is over- or under-exposed, missing, repeated or out of order.
    """
    white, black = (capture.grey(capture.place(kind)) for kind in ("white", "black"))
    noise = picture_noise(black)
    light = examine_exposure(capture, white, black, noise)
    codes = {axis: _axis_code(capture, axis, light, noise) for axis in AXES}
    agreement = check_order(capture, codes, light)
    known = light.lit & ~light.saturated
    for code in codes.values():
        known &= np.isfinite(code.place)
    column, row = (np.where(known, codes[axis].place, np.float32(np.nan)) for axis in AXES)
    return Decoded(
        column=column,
        row=row,
        error=np.where(known, np.maximum(codes["column"].error, codes["row"].error), np.float32(np.nan)),
        colours=capture.colours(capture.place("white")),
        even=np.float32(0.5) * (codes["column"].even + codes["row"].even),
        lit=light.lit,
        saturated=light.saturated,
        noise=noise,
        contrast=float(np.median(light.contrast[known if known.any() else light.lit])),
        agreement=agreement,
    )


def _axis_code(capture: Capture, axis: str, light: Exposure, noise: float) -> AxisCode:
    plan = capture.plan
    code = np.zeros(light.lit.shape, dtype=np.uint32)
    even = np.zeros(light.lit.shape, dtype=np.float32)
    misfits = []
    for bit in range(plan.bits(axis)):
        picture = capture.grey(capture.place("bit", axis, bit))
        inverse = capture.grey(capture.place("inverse", axis, bit))
        misfits.append(pair_misfit(picture, inverse, light))
        code = add_bit(code, picture, inverse)
        even += picture + inverse
    check_pairs(capture, axis, misfits, light)
    even /= np.float32(2 * plan.bits(axis))
    middle = cell_middles(code, plan.cell)
    outside = (middle < 0) | (middle > plan.size(axis) - 0.5)
    if not plan.steps:
        place = np.where(outside, np.float32(np.nan), middle)
        return AxisCode(place, np.full_like(middle, GRAY_ERROR), code, np.full_like(middle, np.nan), even)
    phase, modulation = phase_and_modulation(_cosines(capture, axis), plan.steps)
    dim = modulation < np.maximum(LEAST_MODULATION * 0.5 * light.contrast, 2.0 * noise)
    inside = np.where(dim, np.float32(np.nan), phase * np.float32(plan.period / (2.0 * np.pi)))
    place = resolved(inside, middle, plan.period)
    error = place_error(modulation, noise, plan.period, plan.steps)
    lost = outside | (place < 0) | (place > plan.size(axis) - 1) | (error > WORST_ERROR)
    lost |= np.abs(place - middle) > plan.cell
    return AxisCode(np.where(lost, np.float32(np.nan), place), error, code, inside, even)


def _cosines(capture: Capture, axis: str) -> Iterator[Float[Array, "row column"]]:
    for step in range(capture.plan.steps):
        yield capture.grey(capture.place("phase", axis, step))
