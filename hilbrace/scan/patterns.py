"""The pictures a projector shows one after another, and the list that says which is which.

White and black, then the bits of both axes in Gray code, coarse to fine, each followed by its inverse, then
shifted cosines of both axes. Gray code tells the period of the cosine, the cosine's phase the place inside
the period. The Gray code is OpenCV's (`cv2.structured_light.GrayCodePattern`), its finest bits left out where
a phase says more.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from hilbrace.errors import ConfigError, InputError
from hilbrace.run.records import write_atomic

Array = np.ndarray

MANIFEST = "manifest.json"
AXES = ("column", "row")
SHORTEST_PERIOD, LONGEST_PERIOD = 8, 128
FEWEST_STEPS, MOST_STEPS = 3, 16
LARGEST_SIDE = 16384


@dataclass(frozen=True)
class PatternPlan:
    """What is projected.

    Attributes:
        width: Columns of the projector [px].
        height: Rows of the projector [px].
        period: Length of the cosine [px].
        steps: Shifts of the cosine; 0 for Gray code alone, which then goes down to single pixels.
    """

    width: int
    height: int
    period: int = 16
    steps: int = 4

    @property
    def cell(self) -> int:
        """Width of a cell of the Gray code [px].

        A quarter of the period at most: a code that is one cell off at the border of two stripes still tells
        the period.
        """
        return 2 ** int(math.log2(self.period / 4)) if self.steps else 1

    def size(self, axis: str) -> int:
        """Pixels of the projector along an axis."""
        return self.width if axis == "column" else self.height

    def bits(self, axis: str) -> int:
        """Bits of the Gray code of an axis."""
        return math.ceil(math.log2(self.size(axis))) - int(math.log2(self.cell))


@dataclass(frozen=True)
class Pattern:
    """One projected picture.

    Attributes:
        name: Name without number, such as ``column_bit_03_inverse``.
        kind: ``"white"``, ``"black"``, ``"bit"``, ``"inverse"`` or ``"phase"``.
        axis: ``"column"`` or ``"row"``; empty for white and black.
        index: Bit from coarse to fine, or shift, from 0.
    """

    name: str
    kind: str
    axis: str = ""
    index: int = 0


def checked_plan(width: int, height: int, period: int, steps: int) -> PatternPlan:
    """A plan that can be projected and decoded.

    Raises:
        ConfigError: A figure is out of range.
    """
    for value, name in ((width, "width"), (height, "height")):
        if not 64 <= value <= LARGEST_SIDE:
            raise ConfigError(
                f"a projector of {value} pixels in {name} is none",
                where="--projector",
                hint="give the resolution that the projector shows, as 1280x720",
            )
    if not SHORTEST_PERIOD <= period <= LONGEST_PERIOD:
        raise ConfigError(
            f"a period of {period} pixels cannot be decoded",
            where="--period",
            hint=f"choose {SHORTEST_PERIOD} to {LONGEST_PERIOD}; 16 is ordinary",
        )
    if steps and not FEWEST_STEPS <= steps <= MOST_STEPS:
        raise ConfigError(
            f"{steps} shifts of a cosine do not make a phase",
            where="--steps",
            hint=f"choose {FEWEST_STEPS} to {MOST_STEPS}, or 0 for Gray code alone",
        )
    return PatternPlan(width, height, period, steps)


def sequence(plan: PatternPlan) -> tuple[Pattern, ...]:
    """The patterns in the order of projection."""
    patterns = [Pattern("white", "white"), Pattern("black", "black")]
    for axis in AXES:
        for bit in range(plan.bits(axis)):
            name = f"{axis}_bit_{bit + 1:02d}"
            patterns += [Pattern(name, "bit", axis, bit), Pattern(f"{name}_inverse", "inverse", axis, bit)]
    for axis in AXES:
        patterns += [
            Pattern(f"{axis}_phase_{step + 1:02d}", "phase", axis, step) for step in range(plan.steps)
        ]
    return tuple(patterns)


def pattern_pictures(plan: PatternPlan) -> list[UInt8[Array, "row column"]]:
    """The pictures of `sequence`, in its order."""
    shape = (plan.height, plan.width)
    coder = cv2.structured_light.GrayCodePattern.create(plan.width, plan.height)
    stripes = list(coder.generate()[1])
    first = {"column": 0, "row": 2 * math.ceil(math.log2(plan.width))}
    pictures = []
    for pattern in sequence(plan):
        if pattern.kind in ("white", "black"):
            pictures.append(np.full(shape, 255 if pattern.kind == "white" else 0, dtype=np.uint8))
        elif pattern.kind == "phase":
            pictures.append(_cosine(plan, pattern))
        else:
            place = first[pattern.axis] + 2 * pattern.index + (pattern.kind == "inverse")
            pictures.append(np.asarray(stripes[place], dtype=np.uint8))
    return pictures


def write_patterns(plan: PatternPlan, folder: Path) -> list[str]:
    """Write the numbered pictures, the manifest and what to do with them.

    Returns:
        Names of the files.

    Raises:
        InputError: The folder holds other pictures already.
    """
    named = pattern_files(plan)
    folder.mkdir(parents=True, exist_ok=True)
    strange = sorted(path.name for path in folder.glob("*.png") if path.name not in named)
    if strange:
        raise InputError(
            f"the folder holds pictures of something else, such as {strange[0]}",
            where=str(folder),
            hint="choose an empty folder with --out",
        )
    for name, picture in zip(named, pattern_pictures(plan), strict=True):
        write_atomic(folder / name, cv2.imencode(".png", picture)[1].tobytes())
    manifest = {"hilbrace_patterns": 1, **asdict(plan), "pictures": named}
    write_atomic(folder / MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
    write_atomic(folder / "README.txt", _instructions(plan, len(named)).encode())
    return [*named, MANIFEST, "README.txt"]


def pattern_files(plan: PatternPlan) -> list[str]:
    """File names of the pictures, numbered from 0 in the order of projection."""
    return [f"{number:03d}_{pattern.name}.png" for number, pattern in enumerate(sequence(plan))]


def read_manifest(path: Path) -> PatternPlan:
    """The plan that a manifest tells.

    Args:
        path: A manifest, or the folder of patterns with one.

    Raises:
        InputError: There is none, or it is not what `write_patterns` wrote.
    """
    file = path / MANIFEST if path.is_dir() else path
    if not file.is_file():
        raise InputError(
            "no list of the projected patterns",
            where=str(file),
            hint="name the folder that 'hilbrace scan patterns' wrote with --patterns, or copy its"
            f" {MANIFEST} there",
        )
    try:
        content = json.loads(file.read_text("utf-8"))
        figures = [content[key] for key in ("width", "height", "period", "steps")]
    except (ValueError, KeyError, TypeError) as fault:
        raise InputError(
            f"not a list of patterns: {type(fault).__name__} {fault}", where=str(file), hint="write it anew"
        ) from fault
    if not all(type(figure) is int for figure in figures):
        raise InputError("sizes are no whole numbers", where=str(file), hint="write the patterns anew")
    return checked_plan(*figures)


def _cosine(plan: PatternPlan, pattern: Pattern) -> UInt8[Array, "row column"]:
    place = np.arange(plan.size(pattern.axis))
    angle = 2.0 * np.pi * (place / plan.period + pattern.index / plan.steps)
    line = np.rint(127.5 + 127.5 * np.cos(angle)).astype(np.uint8)
    line = line[None, :] if pattern.axis == "column" else line[:, None]
    return np.ascontiguousarray(np.broadcast_to(line, (plan.height, plan.width)))


def _instructions(plan: PatternPlan, count: int) -> str:
    return f"""{count} pictures for a projector of {plan.width} x {plan.height} pixels.

1. Set the projector to exactly {plan.width} x {plan.height}, without keystone correction, zoom or
   sharpening, and let it warm up. Show the pictures full-screen, pixel by pixel.
2. Fix camera and projector to one bar, 10 to 30 cm apart, both looking at a point about 60 cm away. Focus
   both there. After calibration neither may move, zoom or refocus.
3. Camera: manual exposure of a multiple of 1/60 s (1/50 s where the mains has 50 Hz), manual white balance,
   no automatic anything. In the white picture the brightest skin should stay below 240 of 255.
4. Take one picture of each pattern, in this order, and store them in one folder per pose as PNG, TIFF, BMP or
   JPEG (PNG is best), named so that sorting by name gives the order: 000.png, 001.png, ...
5. Calibrate once with ten or more poses of a flat board, tilted up to 40 degrees to all sides, near and far:
     hilbrace scan calibrate captures --patterns THIS_FOLDER --board charuco:7x5:30:22
   where captures holds one folder per pose. The board must not move while its pictures are taken.
6. Scan: several views of the limb, each a folder of its own:
     hilbrace scan decode leg_front leg_left leg_back --patterns THIS_FOLDER --calibration calibration.toml
"""
