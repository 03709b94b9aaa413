"""QTM's settings, as its XML states them: labels, rate, vertical axis and force plates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from evaluation.sources.stream import LabError, PlateInfo
from hilbrace.errors import InputError

Array = np.ndarray

MOST_XML_BYTES = 2**20

_LENGTH_TO_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


@dataclass(frozen=True)
class QtmPlate:
    """A force plate.

    Attributes:
        number: Its identifier in the stream.
        info: What it delivers and where it is.
    """

    number: int
    info: PlateInfo


@dataclass(frozen=True)
class QtmSettings:
    """What a measurement is made of.

    Attributes:
        labels: Names of the markers in their order in every frame.
        rate_hz: Camera frames per second [Hz].
        up: The vertical axis, ``"y"`` or ``"z"``.
        plates: The force plates.
    """

    labels: tuple[str, ...]
    rate_hz: float
    up: str
    plates: tuple[QtmPlate, ...]


def read_settings(text: bytes, where: str) -> QtmSettings:
    """Settings from the answer to ``getparameters general 3d force``.

    Args:
        text: The XML.
        where: Address, for messages.

    Raises:
        LabError: The XML is damaged, or lacks the frame rate.
        InputError: The vertical axis is neither +y nor +z, or a label is given twice.
    """
    root = _parse(text, where)
    rate = _number(root, "General/Frequency", where)
    if not rate > 0:
        raise _unusable("the frame rate is not positive", where)
    labels = tuple((name.text or "").strip() for name in root.iterfind("The_3D/Label/Name"))
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise InputError(
            f"two trajectories are called '{twice[0]}'", where=where, hint="rename one in QTM's label list"
        )
    up = (root.findtext("The_3D/AxisUpwards") or "+Z").strip().upper()
    if up not in ("+Y", "+Z"):
        raise InputError(
            f"the vertical axis of the laboratory is {up}",
            where=where,
            hint="calibrate QTM with +Z or +Y upwards",
        )
    unit = _LENGTH_TO_M.get((root.findtext("Force/Unit_Length") or "mm").strip(), math.nan)
    plates = tuple(_plate(element, unit, where) for element in root.iterfind("Force/Plate"))
    return QtmSettings(labels, rate, up[1].lower(), plates)


def plate_axes(corners: Float[Array, "4 3"]) -> Float[Array, "3 3"]:
    """Axes of a plate as columns, from its corners in the order of the C3D standard.

    The first corner lies in the plate's quadrant of positive x and y, the others follow round through
    negative x; z points into the ground.
    """
    x = corners[0] + corners[3] - corners[1] - corners[2]
    y = corners[0] + corners[1] - corners[2] - corners[3]
    x = x / np.linalg.norm(x)
    y = y - x * (x @ y)
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def _plate(element: ElementTree.Element, unit_m: float, where: str) -> QtmPlate:
    number = int(_number(element, "Plate_ID", where))
    name = (element.findtext("Name") or "").strip() or f"plate {number}"
    corners = unit_m * np.array(
        [[_number(element, f"Location/Corner{k}/{axis}", where) for axis in "XYZ"] for k in range(1, 5)]
    )
    sides = [np.linalg.norm(corners[1] - corners[0]), np.linalg.norm(corners[3] - corners[0])]
    if not np.isfinite(corners).all() or min(sides) < 1e-3:
        raise InputError(
            f"the corners of '{name}' span no surface", where=where, hint="enter the plate's location in QTM"
        )
    info = PlateInfo(
        name,
        _number(element, "Frequency", where),
        ("Fx", "Fy", "Fz", "Mx", "My", "Mz"),
        ("N", "N", "N", "N*m", "N*m", "N*m"),
        -np.eye(6),
        plate_axes(corners),
        corners.mean(axis=0),
        corners,
        zeroed=True,
    )
    return QtmPlate(number, info)


def _parse(text: bytes, where: str) -> ElementTree.Element:
    if len(text) > MOST_XML_BYTES or b"<!" in text:
        raise _unusable("the settings are too long, or define entities", where)
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as fault:
        raise _unusable(f"the settings are no XML: {fault}", where) from fault


def _number(element: ElementTree.Element, path: str, where: str) -> float:
    try:
        value = float(element.findtext(path) or "")
    except ValueError as fault:
        raise _unusable(f"the settings lack a number at {path}", where) from fault
    if not math.isfinite(value):
        raise _unusable(f"the settings have {value} at {path}", where)
    return value


def _unusable(what: str, where: str) -> LabError:
    return LabError(what, where=where, hint="connect again; if it stays, update QTM to 2023.1 or later")
