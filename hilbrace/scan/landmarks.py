"""Landmarks of a leg: a small text file, and the vertices of the body model that they mean.

One landmark a line: its name and three coordinates in the scan's own axes and unit, separated by blanks or
commas; ``#`` begins a comment. MeshLab's picked points (``.pp``) are read as well.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from hilbrace.errors import InputError
from hilbrace.scan.fit_limb import Limb
from hilbrace.scan.fit_pose import Marks
from hilbrace.scan.surface_scan import SurfaceScan
from hilbrace.units import MESH_TO_M, MM_PER_M

Array = np.ndarray

_OUT, _UP, _FORE = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
PLACES: dict[str, tuple[str, Float[Array, "3"]]] = {
    "knee_lateral": ("knee", 0.08 * _OUT),
    "knee_medial": ("knee", -0.08 * _OUT),
    "kneecap": ("knee", 0.10 * _FORE),
    "knee_back": ("knee", -0.10 * _FORE),
    "ankle_lateral": ("ankle", 0.05 * _OUT + 0.01 * _UP),
    "ankle_medial": ("ankle", -0.05 * _OUT + 0.02 * _UP),
    "heel": ("ankle", -0.10 * _FORE - 0.05 * _UP),
    "trochanter": ("hip", 0.12 * _OUT - 0.01 * _UP),
}
"""Each landmark's joint, and a step from its centre towards the skin [m]: of the right leg, left mirrored."""
OFF_SCAN = 0.1
"""A landmark farther from the scan than this is none of it; a heel below the cut may be near [m]."""
_COUNT = 4


def read_landmarks(path: Path) -> dict[str, Float[Array, "3"]]:
    """Landmarks by name, in the scan's own axes and unit.

    Raises:
        InputError: There is no such file, it names none, or a line is none of a landmark.
    """
    if not path.is_file():
        raise InputError("no such file", where=str(path), hint="check --landmarks")
    try:
        text = path.read_text("utf-8")
    except UnicodeDecodeError:
        raise InputError("not a text file", where=str(path), hint="store landmarks as plain text") from None
    if path.suffix.lower() == ".pp":
        return _picked(text, path)
    found: dict[str, Float[Array, "3"]] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            place = np.array([float(word) for word in words[1:]])
        except ValueError:
            place = np.zeros(0)
        if len(words) != _COUNT or len(place) != _COUNT - 1 or not np.isfinite(place).all():
            raise InputError(
                f"line {number} is '{line.strip()}'",
                where=str(path),
                hint="write a name and three coordinates: knee_lateral 12.5 430 88",
            )
        found[words[0]] = place
    if not found:
        raise InputError("it names no landmark", where=str(path), hint=f"name three of {', '.join(PLACES)}")
    return found


def marks_of(limb: Limb, places: dict[str, Float[Array, "3"]], metres: float, where: str) -> Marks:
    """Landmarks as vertices of the limb.

    Args:
        limb: The limb; with both legs, names end in ``_r`` or ``_l``.
        places: Landmarks in the scan's axes and unit.
        metres: Metres per unit.
        where: Their file, for errors.

    Raises:
        InputError: A name is none of `PLACES`.
    """
    joints = limb.model.joints(np.zeros(0))
    vertices, wanted = [], []
    only = limb.sides[0]
    for name, place in places.items():
        # A name alone is one of the only leg.
        plain, side = (name[:-2], name[-1]) if name[-2:] in ("_r", "_l") else (name, only)
        if plain not in PLACES or side not in limb.sides or (len(limb.sides) > 1 and plain == name):
            ending = " with _r or _l" if len(limb.sides) > 1 else ""
            raise InputError(
                f"unknown landmark '{name}'", where=where, hint=f"use {', '.join(PLACES)}{ending}"
            )
        joint, step = PLACES[plain]
        mirrored = step * np.array([1.0, 1.0, 1.0 if side == "r" else -1.0])
        target = joints[f"{joint}_{side}"] + mirrored
        vertices.append(int(np.linalg.norm(limb.template - target, axis=1).argmin()))
        wanted.append(place * metres)
    return Marks(np.array(wanted).reshape(-1, 3), np.array(vertices, dtype=np.int64))


def check_near(
    limb: Limb, marks: Marks, places: dict[str, Float[Array, "3"]], scan: SurfaceScan, where: str
) -> None:
    """Are the landmarks points of the scan, and as far apart as a person's?

    Args:
        limb: The limb.
        marks: Landmarks as vertices of the limb.
        places: The same by name, in the scan's axes and unit.
        scan: The scan.
        where: Their file, for errors.

    Raises:
        InputError: One lies far from the scan, or all lie much closer together or farther apart than on a
            leg: they were written in another unit, or picked in another file.
    """
    tree, points = cKDTree(scan.points), np.stack(list(places.values()))
    gaps = tree.query(marks.places)[0]
    own, real = (_extent(each) for each in (marks.places, limb.template[marks.vertex]))
    alike = [
        unit
        for unit, metres in MESH_TO_M.items()
        if tree.query(points * metres)[0].max() < OFF_SCAN and _alike(_extent(points * metres), real)
    ]
    hint = (
        f"they would lie on it in {alike[0]}: write them in the scan's own unit"
        if alike
        else "pick the landmarks in the scan's own file, in its axes and unit"
    )
    worst = int(gaps.argmax())
    if gaps[worst] > OFF_SCAN:
        raise InputError(
            f"landmark '{list(places)[worst]}' is {gaps[worst] * MM_PER_M:.0f} mm away from the scan,"
            f" which is in {scan.unit}",
            where=where,
            hint=hint,
        )
    if not _alike(own, real):
        raise InputError(
            f"the landmarks are {own * MM_PER_M:.0f} mm apart, on a leg they are {real * MM_PER_M:.0f} mm",
            where=where,
            hint=hint,
        )


def _extent(points: Float[Array, "mark 3"]) -> float:
    """Largest distance between any two points [m]."""
    return float(np.linalg.norm(points[:, None] - points, axis=2).max())


def _alike(own: float, real: float) -> bool:
    """Two distances of which neither is more than double the other."""
    return real / 2.0 <= own <= 2.0 * real


def _picked(text: str, path: Path) -> dict[str, Float[Array, "3"]]:
    try:
        points = ElementTree.fromstring(text).iter("point")
        return {
            point.attrib["name"]: np.array([float(point.attrib[axis]) for axis in "xyz"]) for point in points
        }
    except (ElementTree.ParseError, KeyError, ValueError) as fault:
        raise InputError(
            f"no picked points: {fault}", where=str(path), hint="save them in MeshLab again"
        ) from None
