"""The cavity of the closed mold, measured on the pieces themselves and held against the brace.

The volume comes from a body that reaches from just under the grooves to just inside the shells' walls: what
neither core nor shells fill of it is cavity, gutter or port. No two of the bodies that are intersected for it
share a face, which keeps the arithmetic exact and fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from manifold3d import Manifold, OpType

from fabrication.bodies import body_of
from fabrication.ends import border_loops, find_ends
from fabrication.mold import Casting, Mold

Array = np.ndarray

BELOW_MM, ABOVE_MM = 1.0, 0.5
"""How far the measuring body reaches under the limb's surface and into the shells [mm]."""

COARSE_MM = 0.1
"""The measuring body need not be fine: its own volume is known, and it lies clear of all faces [mm]."""

RAYS = 4000
"""Places at which the depth of the cavity is measured."""

CRUMB_MM3 = 0.1
"""Smaller bodies are left by rounding [mm^3]."""

TOUCH_MM = 0.2
"""Bodies this close are one cavity [mm]."""


@dataclass(frozen=True)
class Cavity:
    """What the closed mold leaves free.

    Attributes:
        volume_mm3: Volume of the cavity without gutter, port and vents [mm^3].
        brace_mm3: Volume of the brace [mm^3].
        parts: Cavities that do not hang together, gutter and port counted in.
        depth_error_mm: 99 of 100 places of the cavity are as deep as the brace is thick within this [mm].
    """

    volume_mm3: float
    brace_mm3: float
    parts: int
    depth_error_mm: float

    @property
    def volume_error(self) -> float:
        """Difference of cavity and brace, as a part of the brace [-]."""
        return abs(self.volume_mm3 / self.brace_mm3 - 1.0)


def measure_cavity(mold: Mold) -> Cavity:
    """Measure the cavity of a closed mold.

    Args:
        mold: The mold with everything in its place.
    """
    casting = mold.casting
    room = room_of(casting)
    filled = sum((room ^ piece.solid).volume() for piece in mold.pieces if piece.kind in ("core", "shell"))
    other = (room ^ _all([mold.core.gutter, *mold.channels, *mold.gaps])) - casting.brace
    return Cavity(
        volume_mm3=room.volume() - filled - other.volume(),
        brace_mm3=casting.brace.volume(),
        parts=_parts(mold),
        depth_error_mm=_depth_error(mold),
    )


def room_of(casting: Casting) -> Manifold:
    """The body from just under the limb's surface to just inside the shells.

    Args:
        casting: What is cast.
    """
    count = len(casting.vertices)
    top = casting.outer + ABOVE_MM * casting.direction
    bottom = casting.vertices - BELOW_MM * casting.direction
    walls = []
    for loop in border_loops(casting.triangles):
        a, b = loop, np.roll(loop, -1)
        walls += [np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)]
    triangles = np.concatenate([casting.triangles, casting.triangles[:, ::-1] + count, *walls])
    room = body_of(np.concatenate([top, bottom]), triangles, "room of the cavity").simplify(COARSE_MM)
    for end in () if casting.flat else find_ends(casting):
        room = end.trim(room)
    return room


def _parts(mold: Mold) -> int:
    """Bodies that brace and gutter make, when what touches counts as one; crumbs of rounding left out."""
    down = -TOUCH_MM * mold.core.axis
    bodies = (mold.casting.brace + mold.core.gutter.translate(tuple(down))).decompose()
    return sum(body.volume() > CRUMB_MM3 for body in bodies)


def _depth_error(mold: Mold) -> float:
    """How far the depth of the cavity is from the thickness of the brace, at the 99th percentile [mm]."""
    casting = mold.casting
    if casting.covered is None:
        return 0.0
    chosen = np.flatnonzero(_inside(casting.triangles, casting.covered))
    if not len(chosen):
        return 0.0
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(RAYS, len(chosen))).astype(int)]
    corners = casting.triangles[chosen]
    way = casting.direction[corners].mean(axis=1)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    thickness = casting.thickness[corners].mean(axis=1)
    middle = casting.vertices[corners].mean(axis=1) + 0.5 * thickness[:, None] * way
    reach = 2.0 * thickness[:, None] * way
    cores = [piece.solid for piece in mold.of("core")]
    shells = [piece.solid for piece in mold.of("shell")]
    depth = _first_hit(cores, middle, middle - reach) + _first_hit(shells, middle, middle + reach)
    return float(np.quantile(np.abs(depth - thickness), 0.99))


def _inside(triangles: Array, covered: Array) -> Bool[Array, " triangle"]:
    """Covered triangles that touch no other: away from the grooves' drafted walls."""
    bare = np.zeros(int(triangles.max()) + 1, bool)
    bare[triangles[~covered]] = True
    return covered & ~bare[triangles].any(axis=1)


def _first_hit(bodies: Sequence[Manifold], starts: Array, ends: Array) -> Float[Array, " ray"]:
    """Distance to the first face of any body on each way; the length of the way where there is none."""
    lengths = np.linalg.norm(ends - starts, axis=1)
    for index, (start, end) in enumerate(zip(starts, ends, strict=True)):
        for body in bodies:
            hits = body.ray_cast(tuple(start), tuple(end))
            if hits:
                lengths[index] = min(lengths[index], np.linalg.norm(np.asarray(hits[0].position) - start))
    return lengths


def _all(bodies: Sequence[Manifold]) -> Manifold:
    return Manifold.batch_boolean(list(bodies), OpType.Add)
