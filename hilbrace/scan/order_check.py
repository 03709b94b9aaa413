"""Do the pictures follow the order of the patterns?

Three signs, none of which needs a calibration. A pattern of stripes and its inverse add up to white and
black, whatever the camera's response. Between neighbouring cells one bit changes, and the number changes by
one: a pair in a wrong place breaks that wherever it changes. And the phase must lie inside the cell that the
Gray code names. Where a sign fails, every single exchange of pictures is tried, and the one that mends all is
named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, UInt32

from hilbrace.errors import InputError
from hilbrace.scan.capture import ORDER_HINT, Capture
from hilbrace.scan.exposure import Exposure
from hilbrace.scan.gray_code import cell_middles, cell_numbers
from hilbrace.scan.patterns import PatternPlan
from hilbrace.scan.phase_shift import resolved

Array = np.ndarray

Change = Callable[[UInt32[Array, "*pixel"]], UInt32[Array, "*pixel"]]
"""What an exchange of pictures does to the codes."""

WORST_MISFIT = 0.25
"""Median misfit of a pair of pictures that still counts as pattern and inverse [-]."""
LEAST_IN_ORDER = 0.5
"""Part of the changes of each bit that must go to a neighbouring cell [-]."""
LEAST_AGREEMENT = 0.7
"""Part of the phases that must lie in their cells [-]; by chance 3 of 8 do."""
FEWEST_CHANGES = 30
"""Changes of a bit from which it is judged."""
FEWEST_PIXELS = 200
"""Lit pixels from which the phase is judged."""
_SAMPLES = 40_000


class Coded(Protocol):
    """One axis of a decoded capture."""

    @property
    def code(self) -> UInt32[Array, "row column"]:
        """Gray code."""
        ...

    @property
    def inside(self) -> Float[Array, "row column"]:
        """Place inside the period [px], not a number where it is lost."""
        ...


@dataclass(frozen=True)
class Signs:
    """Samples of one axis.

    Attributes:
        changes: Codes of neighbouring pixels that differ in one bit.
        code: Codes of single pixels.
        inside: Their places inside the period [px].
        plan: What was projected.
        axis: ``"column"`` or ``"row"``.
    """

    changes: UInt32[Array, "2 change"]
    code: UInt32[Array, " pixel"]
    inside: Float[Array, " pixel"]
    plan: PatternPlan
    axis: str

    def out_of_place(self, change: Change) -> list[int]:
        """Bits whose changes mostly do not go to a neighbouring cell, coarse to fine."""
        one, other = change(self.changes)
        bits = self.plan.bits(self.axis)
        step = np.abs(cell_numbers(one) - cell_numbers(other))
        changed = bits - 1 - np.log2(np.maximum(one ^ other, 1)).astype(int)
        count = np.bincount(changed, minlength=bits)[:bits]
        good = np.bincount(changed, step == 1, minlength=bits)[:bits]
        bad = (count >= FEWEST_CHANGES) & (good < LEAST_IN_ORDER * count)
        return [int(bit) for bit in np.flatnonzero(bad)]

    def agreement(self, change: Change) -> float:
        """Part of the pixels whose phase lies in the cell of their code; 1 with too few pixels [-]."""
        if len(self.code) < FEWEST_PIXELS:
            return 1.0
        middle = cell_middles(change(self.code), self.plan.cell)
        off = np.abs(resolved(self.inside, middle, self.plan.period) - middle)
        return float((off <= 0.75 * self.plan.cell).mean())

    def whole(self, change: Change) -> bool:
        """Neither sign fails after an exchange."""
        return not self.out_of_place(change) and self.agreement(change) >= LEAST_AGREEMENT


def pair_misfit(
    picture: Float[Array, "row column"], inverse: Float[Array, "row column"], light: Exposure
) -> float:
    """Median over lit pixels of how far a picture and its inverse are from white and black together [-]."""
    usable = light.lit & ~light.saturated
    if not usable.any():
        return 0.0
    off = np.abs((picture + inverse)[usable] - light.total[usable])
    alike = 1.0 - np.abs((picture - inverse)[usable]) / light.contrast[usable]
    return float(max(np.median(off / light.contrast[usable]), np.median(alike) - 0.5))


def check_pairs(capture: Capture, axis: str, misfits: list[float], light: Exposure) -> None:
    """Every picture of stripes must have its inverse after it.

    Raises:
        InputError: Pairs do not add up; a single exchange that mends them is named.
    """
    bad = [bit for bit, misfit in enumerate(misfits) if misfit > WORST_MISFIT]
    if not bad:
        return
    names = [_pair(capture, axis, bit) for bit in bad]
    exchange = _single_exchange(capture, axis, bad, light) if len(bad) == 2 else None
    what = f"{names[0][0]} and {names[0][1]} are not a pattern and its inverse"
    if exchange:
        what = f"{exchange[0]} and {exchange[1]} seem to be exchanged"
    elif len(bad) > 1:
        what += f" (nor are {len(bad) - 1} other pairs of the {axis}s)"
    raise InputError(
        what,
        where=str(capture.folder),
        hint=f"a picture may be missing, taken twice or taken while the pattern changed: {ORDER_HINT}",
    )


def check_order(capture: Capture, codes: Mapping[str, Coded], light: Exposure) -> float:
    """Bits must be in their places, and phases inside their cells.

    Returns:
        Part of the modulated pixels on which phase and Gray code agree; 1 without phase.

    Raises:
        InputError: The pictures do not follow the patterns.
    """
    usable = light.lit & ~light.saturated
    agreements = []
    for axis, coded in codes.items():
        signs = _signs(capture.plan, axis, coded, usable)
        agreements.append(signs.agreement(_unchanged))
        if signs.whole(_unchanged):
            continue
        culprit = next((names for names, change in _exchanges(capture, axis) if signs.whole(change)), None)
        raise InputError(
            culprit or _contradiction(capture, signs),
            where=str(capture.folder),
            hint=f"the pictures do not follow the list of patterns: {ORDER_HINT}; is --patterns the folder"
            " that was projected?",
        )
    return min(agreements)


def _signs(plan: PatternPlan, axis: str, coded: Coded, usable: Bool[Array, "row column"]) -> Signs:
    places = np.flatnonzero(usable & np.isfinite(coded.inside))
    places = places[:: max(1, len(places) // _SAMPLES)]
    return Signs(
        _clean_changes(coded.code, usable),
        coded.code.ravel()[places],
        coded.inside.ravel()[places],
        plan,
        axis,
    )


def _contradiction(capture: Capture, signs: Signs) -> str:
    out = signs.out_of_place(_unchanged)
    if out:
        first, last = _pair(capture, signs.axis, out[0])
        return f"{first} and {last} do not fit their place among the stripes of the {signs.axis}s"
    cosine = capture.files[capture.place("phase", signs.axis, 0)].name
    return (
        f"phase and Gray code of the {signs.axis}s agree on {100 * signs.agreement(_unchanged):.0f} % of the"
        f" lit pixels only (the cosines start with {cosine}): cosines are out of order, or the limb moved"
    )


def _unchanged(codes: UInt32[Array, "*pixel"]) -> UInt32[Array, "*pixel"]:
    return codes


def _pair(capture: Capture, axis: str, bit: int) -> tuple[str, str]:
    return tuple(capture.files[capture.place(kind, axis, bit)].name for kind in ("bit", "inverse"))  # pyright: ignore[reportReturnType]


def _single_exchange(capture: Capture, axis: str, bad: list[int], light: Exposure) -> tuple[str, str] | None:
    """The two pictures of two bad pairs whose exchange makes both pairs add up."""
    numbers = [capture.place(kind, axis, bit) for bit in bad for kind in ("bit", "inverse")]
    pictures = [capture.grey(number) for number in numbers]
    for one in (0, 1):
        for other in (2, 3):
            order = list(pictures)
            order[one], order[other] = order[other], order[one]
            misfits = [pair_misfit(order[k], order[k + 1], light) for k in (0, 2)]
            if max(misfits) < WORST_MISFIT:
                return capture.files[numbers[one]].name, capture.files[numbers[other]].name
    return None


def _clean_changes(
    code: UInt32[Array, "row column"], usable: Bool[Array, "row column"]
) -> UInt32[Array, "2 change"]:
    """Codes of neighbouring pixels that differ in exactly one bit, a sample of them."""
    found = []
    for one, other, both in (
        (code[:, :-1], code[:, 1:], usable[:, :-1] & usable[:, 1:]),
        (code[:-1], code[1:], usable[:-1] & usable[1:]),
    ):
        differing = one ^ other
        single = both & (differing != 0) & ((differing & (differing - np.uint32(1))) == 0)
        found.append(np.stack([one[single], other[single]]))
    pairs = np.concatenate(found, axis=1)
    return pairs[:, :: max(1, pairs.shape[1] // _SAMPLES)]


def _exchanges(capture: Capture, axis: str) -> Iterator[tuple[str, Change]]:
    """Every exchange of a pattern with its inverse, and of one pair with another; names and what it does."""
    bits = capture.plan.bits(axis)

    def flipped(bit: int) -> Change:
        return lambda pairs: pairs ^ np.uint32(1 << (bits - 1 - bit))

    def swapped(bit: int, other: int) -> Change:
        def swap(pairs: UInt32[Array, "*pixel"]) -> UInt32[Array, "*pixel"]:
            low, high = np.uint32(bits - 1 - bit), np.uint32(bits - 1 - other)
            differ = ((pairs >> low) ^ (pairs >> high)) & np.uint32(1)
            return pairs ^ (differ << low) ^ (differ << high)

        return swap

    for bit in range(bits):
        first, second = _pair(capture, axis, bit)
        yield f"{first} and {second} seem to be exchanged: the inverse comes first", flipped(bit)
    for bit in range(bits):
        for other in range(bit + 1, bits):
            ours, theirs = _pair(capture, axis, bit), _pair(capture, axis, other)
            yield (
                f"the pair {ours[0]}, {ours[1]} and the pair {theirs[0]}, {theirs[1]} seem to be exchanged",
                swapped(bit, other),
            )
