"""What to buy for a mold: metric bolts, nuts, washers and dowel pins, and the sizes that they have."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from fabrication.mold import Hardware
from hilbrace.errors import ConfigError, GeometryError


@dataclass(frozen=True)
class Fastener:
    """Sizes of a metric bolt, its nut and its washer [mm].

    Attributes:
        size: Nominal diameter.
        hole: Diameter of a clearance hole, medium fit (ISO 273).
        head: Largest diameter of the head of a socket screw (ISO 4762).
        head_height: Largest height of that head (ISO 4762).
        flats: Largest width of the nut across flats (ISO 4032).
        corners: Least width of the nut across corners (ISO 4032).
        nut_height: Largest height of the nut (ISO 4032).
        washer: Outer diameter of the washer (ISO 7089).
        washer_height: Its nominal thickness (ISO 7089).
    """

    size: float
    hole: float
    head: float
    head_height: float
    flats: float
    corners: float
    nut_height: float
    washer: float
    washer_height: float

    @property
    def name(self) -> str:
        """``M4``."""
        return f"M{self.size:g}"


FASTENERS = {
    fastener.size: fastener
    for fastener in (
        Fastener(2.0, 2.4, 3.8, 2.0, 4.0, 4.32, 1.6, 5.0, 0.3),
        Fastener(2.5, 2.9, 4.5, 2.5, 5.0, 5.45, 2.0, 6.0, 0.5),
        Fastener(3.0, 3.4, 5.5, 3.0, 5.5, 6.01, 2.4, 7.0, 0.5),
        Fastener(4.0, 4.5, 7.0, 4.0, 7.0, 7.66, 3.2, 9.0, 0.8),
        Fastener(5.0, 5.5, 8.5, 5.0, 8.0, 8.79, 4.7, 10.0, 1.0),
        Fastener(6.0, 6.6, 10.0, 6.0, 10.0, 11.05, 5.2, 12.0, 1.6),
        Fastener(8.0, 9.0, 13.0, 8.0, 13.0, 14.38, 6.8, 16.0, 1.6),
    )
}
"""ISO 4762:2004, ISO 4032:2012, ISO 7089:2000 and ISO 273:1979 by nominal diameter."""

BOLT_LENGTHS = (6, 8, 10, 12, 16, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 80, 90, 100)
"""Lengths of socket screws that are sold (ISO 4762) [mm]."""

PIN_LENGTHS = {
    3.0: (8, 10, 12, 14, 16, 18, 20, 24, 28, 30),
    4.0: (10, 12, 14, 16, 18, 20, 24, 28, 30, 32, 35, 40),
    6.0: (16, 18, 20, 24, 28, 30, 32, 35, 40, 45, 50, 60),
    8.0: (20, 24, 28, 30, 32, 35, 40, 45, 50, 60, 80),
}
"""Parallel dowel pins that are sold, lengths by diameter (ISO 2338) [mm]."""


def fastener(bolt_mm: float) -> Fastener:
    """Sizes of a bolt.

    Args:
        bolt_mm: Nominal diameter, 4 for M4 [mm].

    Raises:
        ConfigError: No metric bolt has this diameter.
    """
    found = FASTENERS.get(float(bolt_mm))
    if found is None:
        raise ConfigError(
            f"there is no metric bolt of {bolt_mm:g} mm",
            where="mold.bolt_mm",
            hint=f"use one of {', '.join(f'{size:g}' for size in FASTENERS)}",
        )
    return found


def bolt_length(grip_mm: float) -> int:
    """Shortest bolt on sale that reaches through a grip.

    Args:
        grip_mm: From under the head to the far face of the nut [mm].

    Raises:
        GeometryError: No bolt is long enough.
    """
    for length in BOLT_LENGTHS:
        if length >= grip_mm:
            return length
    raise GeometryError(
        f"a bolt would have to be {grip_mm:.0f} mm long",
        where="mold.bolt_mm",
        hint="use thinner flanges",
    )


def pin_length(diameter_mm: float, room_mm: float) -> int:
    """Longest dowel pin on sale that fits a hole.

    Args:
        diameter_mm: Its diameter, a key of `PIN_LENGTHS` [mm].
        room_mm: Length of the hole [mm].

    Raises:
        GeometryError: Even the shortest pin is too long.
    """
    fitting = [length for length in PIN_LENGTHS[diameter_mm] if length <= room_mm]
    if not fitting:
        raise GeometryError(
            f"no dowel pin of {diameter_mm:g} mm is as short as {room_mm:.0f} mm",
            where="bed split",
            hint="use a thinner pin, or cut where more of the piece is left",
        )
    return max(fitting)


def shopping_list(items: Iterable[Hardware]) -> tuple[Hardware, ...]:
    """Items of one name as one item, in the order in which they first appear."""
    counts: Counter[str] = Counter()
    for item in items:
        counts[item.name] += item.count
    return tuple(Hardware(count, name) for name, count in counts.items() if count)
