"""A folder of pictures, one of each projected pattern.

Sorting the names gives the order; numbers in names count as numbers. Pictures are read one at a time.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hilbrace.errors import InputError
from hilbrace.scan.patterns import PatternPlan, sequence

Array = np.ndarray

SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm", ".ppm")
SMALLEST_SIDE = 64

ORDER_HINT = (
    "store one picture of each pattern, in the order of projection, named so that sorting gives that order"
)


@dataclass(frozen=True)
class Capture:
    """Pictures of one view or one pose of the board.

    Attributes:
        folder: Where they lie.
        plan: What was projected.
        files: One per pattern of `sequence`.
        size: Width and height of all pictures [px].
    """

    folder: Path
    plan: PatternPlan
    files: tuple[Path, ...]
    size: tuple[int, int]

    def place(self, kind: str, axis: str = "", index: int = 0) -> int:
        """Number of a pattern in the sequence.

        Raises:
            KeyError: The plan has no such pattern.
        """
        for number, pattern in enumerate(sequence(self.plan)):
            if (pattern.kind, pattern.axis, pattern.index) == (kind, axis, index):
                return number
        raise KeyError(kind, axis, index)

    def grey(self, number: int) -> Float[Array, "row column"]:
        """One picture, mean of its channels [grey levels of 255].

        Raises:
            InputError: It cannot be read, or has another size than the first.
        """
        picture = self._read(number)
        if picture.ndim == 3:
            return picture.mean(axis=2, dtype=np.float32)
        return picture.astype(np.float32, copy=False)

    def brightest(self, number: int) -> Float[Array, "row column"]:
        """One picture, the brightest of its channels [grey levels of 255]."""
        picture = self._read(number)
        return picture.max(axis=2) if picture.ndim == 3 else picture

    def colours(self, number: int) -> UInt8[Array, "row column 3"]:
        """One picture in red, green and blue."""
        picture = np.clip(np.rint(self._read(number)), 0, 255).astype(np.uint8)
        if picture.ndim == 2:
            return np.repeat(picture[..., None], 3, axis=2)
        return np.ascontiguousarray(picture[..., ::-1])

    def _read(self, number: int) -> Float[Array, "row column ..."]:
        picture = _load(self.files[number])
        if (picture.shape[1], picture.shape[0]) != self.size:
            raise InputError(
                f"{picture.shape[1]} x {picture.shape[0]} pixels, the first picture has"
                f" {self.size[0]} x {self.size[1]}",
                where=str(self.files[number]),
                hint="take all pictures of a capture with the same settings of the camera",
            )
        return picture


def open_capture(folder: Path, plan: PatternPlan) -> Capture:
    """The pictures of a folder, as many as there are patterns.

    Raises:
        InputError: There is no such folder, pictures are missing or too many, or the first cannot be read.
    """
    if not folder.is_dir():
        raise InputError("no such folder", where=str(folder), hint="name folders of pictures")
    files = sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.name[0] != "."),
        key=lambda path: _natural(path.name),
    )
    _check_count(folder, files, plan)
    height, width = _load(files[0]).shape[:2]
    if min(height, width) < SMALLEST_SIDE:
        raise InputError(
            f"a picture of {width} x {height} pixels is too small", where=str(files[0]), hint=ORDER_HINT
        )
    return Capture(folder, plan, tuple(files), (width, height))


def _check_count(folder: Path, files: list[Path], plan: PatternPlan) -> None:
    patterns = sequence(plan)
    if len(files) == len(patterns):
        return
    if not files:
        raise InputError(
            "the folder holds no pictures",
            where=str(folder),
            hint=f"it must hold {len(patterns)} of {', '.join(SUFFIXES)}",
        )
    if len(files) > len(patterns):
        raise InputError(
            f"{len(files)} pictures for {len(patterns)} patterns, the first too many is"
            f" {files[len(patterns)].name}",
            where=str(folder),
            hint=f"{ORDER_HINT}; is --patterns the folder that was projected?",
        )
    gap = _gap(files)
    if gap is not None and gap < len(patterns):
        what = f"the picture of pattern {gap} ({patterns[gap].name}) is missing:"
        what += f" the names go from {files[gap - 1].name} to {files[gap].name}" if gap else ""
    else:
        missing = ", ".join(pattern.name for pattern in patterns[len(files) :][:3])
        what = (
            f"{len(files)} pictures for {len(patterns)} patterns; if the first are there, these are missing: "
        )
        what += missing + (", ..." if len(patterns) - len(files) > 3 else "")
    raise InputError(what, where=str(folder), hint=f"take the pictures again: {ORDER_HINT}")


def _gap(files: list[Path]) -> int | None:
    """Place of the first number that names leave out, if they are numbered."""
    numbers = [re.findall(r"\d+", path.stem) for path in files]
    if not all(numbers):
        return None
    for spot in (-1, 0):
        run = [int(found[spot]) for found in numbers]
        steps = np.diff(run)
        jumps = np.flatnonzero(steps != 1)
        if len(jumps) and (steps > 0).all() and len(jumps) < len(steps) / 2:
            return int(jumps[0]) + 1
    return None


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Key that sorts numbers in names as numbers."""
    parts = re.split(r"(\d+)", name.lower())
    return tuple((1, int(part), "") if part.isdigit() else (0, 0, part) for part in parts)


def _load(path: Path) -> Float[Array, "row column ..."]:
    """A picture as its file has it, grey or blue-green-red [grey levels of 255]."""
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    picture = None
    if len(content):
        try:
            picture = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
        except cv2.error as fault:
            raise InputError(
                f"no readable picture: {fault.err}", where=str(path), hint="take it again"
            ) from None
    if picture is None:
        raise InputError(
            "no readable picture; the file is empty, cut short or of another kind",
            where=str(path),
            hint="copy it from the camera again, or take the whole capture again",
        )
    if picture.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"pixels are of type {picture.dtype}", where=str(path), hint="store 8 or 16 bits a channel"
        )
    scale = 1.0 if picture.dtype == np.uint8 else 255.0 / 65535.0
    if picture.ndim == 3:
        picture = picture[..., :3] if picture.shape[2] > 2 else picture[..., 0]
    return picture.astype(np.float32) * np.float32(scale)
