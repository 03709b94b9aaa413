"""Do the pictures follow the order of the patterns?

Three signs, none of which needs a calibration. A pattern of stripes and its inverse add up to white and
black, whatever the camera's response. Between neighbouring cells one bit changes, and the number changes by
one: a pair in a wrong place breaks that wherever it changes. And the phase must lie inside the cell that the
Gray code names. Where a sign fails, every exchange of two pictures or two pairs is tried, and those that mend
all are named: several, where the limb covers too little of the beam to tell them apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from hilbrace.errors import InputError
from hilbrace.scan.axis_code import AxisCode
from hilbrace.scan.capture import ORDER_HINT, Capture
from hilbrace.scan.exposure import Exposure
from hilbrace.scan.gray_code import cell_middles, cell_numbers
from hilbrace.scan.patterns import PatternPlan
from hilbrace.scan.phase_shift import phase_and_modulation, resolved

Array = np.ndarray

Codes = Integer[Array, "*pixel"]
Change = Callable[[Codes], Codes]
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


@dataclass(frozen=True)
class Signs:
    """Samples of one axis.

    Attributes:
        changes: Codes of neighbouring pixels that differ in one bit.
        pixels: Places of single pixels in the picture, row by row.
        code: Their codes.
        inside: Their places inside the period [px].
        plan: What was projected.
        axis: ``"column"`` or ``"row"``.
    """

    changes: Integer[Array, "2 change"]
    pixels: Int[Array, " pixel"]
    code: Integer[Array, " pixel"]
    inside: Float[Array, " pixel"]
    plan: PatternPlan
    axis: str

    def out_of_place(self) -> list[int]:
        """Bits whose changes mostly do not go to a neighbouring cell, coarse to fine."""
        one, other = self.changes
        bits = self.plan.bits(self.axis)
        step = np.abs(cell_numbers(one) - cell_numbers(other))
        changed = bits - 1 - np.log2(np.maximum(one ^ other, 1)).astype(int)
        count = np.bincount(changed, minlength=bits)[:bits]
        good = np.bincount(changed, step == 1, minlength=bits)[:bits]
        bad = (count >= FEWEST_CHANGES) & (good < LEAST_IN_ORDER * count)
        return [int(bit) for bit in np.flatnonzero(bad)]

    def agreement(self) -> float:
        """Part of the pixels whose phase lies in the cell of their code; 1 with too few pixels [-]."""
        if len(self.code) < FEWEST_PIXELS:
            return 1.0
        middle = cell_middles(self.code, self.plan.cell)
        off = np.abs(resolved(self.inside, middle, self.plan.period) - middle)
        return float((off <= 0.75 * self.plan.cell).mean())

    def whole(self) -> bool:
        """Neither sign fails."""
        return not self.out_of_place() and self.agreement() >= LEAST_AGREEMENT

    def changed(self, change: Change) -> Signs:
        """The samples with their bits exchanged."""
        return replace(self, changes=change(self.changes), code=change(self.code))


def pair_misfit(
    picture: Float[Array, "row column"], inverse: Float[Array, "row column"], light: Exposure
) -> float:
    """Median over lit pixels of how far a picture and its inverse are from white and black together [-]."""
    usable = light.lit & ~light.saturated
    if not usable.any():
        return 0.0
    off = np.abs((picture + inverse)[usable] - light.total[usable])
    return float(np.median(off / light.contrast[usable]))


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


def check_order(capture: Capture, codes: Mapping[str, AxisCode], light: Exposure) -> float:
    """Bits must be in their places, and phases inside their cells.

    Returns:
        Part of the modulated pixels on which phase and Gray code agree; 1 without phase.

    Raises:
        InputError: The pictures do not follow the patterns; every single exchange that mends it is named.
    """
    usable = light.lit & ~light.saturated
    agreements = []
    for axis, coded in codes.items():
        signs = _signs(capture.plan, axis, coded, usable)
        agreements.append(signs.agreement())
        if signs.whole():
            continue
        tried = (*_exchanges(capture, signs), *_exchanged_cosines(capture, signs))
        culprits = [names for names, mended in tried if mended.whole()]
        what = f"{' or '.join(culprits[:3])} seem to be exchanged" if culprits else ""
        raise InputError(
            what or _contradiction(capture, signs),
            where=str(capture.folder),
            hint=f"the pictures do not follow the list of patterns: {ORDER_HINT}; is --patterns the folder"
            " that was projected?",
        )
    return min(agreements)


def _signs(plan: PatternPlan, axis: str, coded: AxisCode, usable: Bool[Array, "row column"]) -> Signs:
    pixels = np.flatnonzero(usable & np.isfinite(coded.inside))
    pixels = pixels[:: max(1, len(pixels) // _SAMPLES)]
    return Signs(
        changes=_clean_changes(coded.code, usable),
        pixels=pixels,
        code=coded.code.ravel()[pixels],
        inside=coded.inside.ravel()[pixels],
        plan=plan,
        axis=axis,
    )


def _contradiction(capture: Capture, signs: Signs) -> str:
    out = signs.out_of_place()
    if out:
        first, last = _pair(capture, signs.axis, out[0])
        return f"{first} and {last} do not fit their place among the stripes of the {signs.axis}s"
    cosine = capture.files[capture.place("phase", signs.axis, 0)].name
    return (
        f"phase and Gray code of the {signs.axis}s agree on {100 * signs.agreement():.0f} % of the lit pixels"
        f" only (the cosines start with {cosine}): pictures are out of order, or the limb moved"
    )


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
    code: Integer[Array, "row column"], usable: Bool[Array, "row column"]
) -> Integer[Array, "2 change"]:
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


def _exchanges(capture: Capture, signs: Signs) -> Iterator[tuple[str, Signs]]:
    """Every exchange of a pattern with its inverse, and of one pair with another; names and what it gives."""
    bits = capture.plan.bits(signs.axis)
    place = [np.uint32(bits - 1 - bit) for bit in range(bits)]

    def swap(codes: Codes, one: int, other: int) -> Codes:
        differ = ((codes >> place[one]) ^ (codes >> place[other])) & np.uint32(1)
        return codes ^ (differ << place[one]) ^ (differ << place[other])

    for bit in range(bits):
        first, second = _pair(capture, signs.axis, bit)
        flipped = signs.changed(partial(np.bitwise_xor, np.uint32(1) << place[bit]))
        yield f"{first} and {second}", flipped
    for one, other in combinations(range(bits), 2):
        ours, theirs = _pair(capture, signs.axis, one), _pair(capture, signs.axis, other)
        swapped = signs.changed(partial(swap, one=one, other=other))
        yield f"the pair {ours[0]}, {ours[1]} and the pair {theirs[0]}, {theirs[1]}", swapped


def _exchanged_cosines(capture: Capture, signs: Signs) -> Iterator[tuple[str, Signs]]:
    """Every exchange of two cosines; names and what it gives."""
    steps, period = capture.plan.steps, capture.plan.period
    numbers = [capture.place("phase", signs.axis, step) for step in range(steps)]
    values = [capture.grey(number).ravel()[None, signs.pixels] for number in numbers]
    for one, other in combinations(range(steps), 2):
        order = list(values)
        order[one], order[other] = order[other], order[one]
        phase, _ = phase_and_modulation(order, steps)
        inside = phase[0] * np.float32(period / (2.0 * np.pi))
        names = f"{capture.files[numbers[one]].name} and {capture.files[numbers[other]].name}"
        yield names, replace(signs, inside=inside)
