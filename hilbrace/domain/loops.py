"""The open edges of a sleeve: its two ends, and its windows."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Float, Int

from hilbrace.domain.limb import Limb, Surface
from hilbrace.errors import GeometryError

Array = np.ndarray


@dataclass(frozen=True)
class Loops:
    """The open edges of a sleeve, each in order around.

    Attributes:
        upper: Vertices of the proximal edge.
        lower: Vertices of the distal edge.
        windows: Vertices of the edge of each window.
    """

    upper: Int[Array, " upper"]
    lower: Int[Array, " lower"]
    windows: tuple[Int[Array, " _corner"], ...]


def loops_of(surface: Surface, limb: Limb) -> Loops:
    """The open edges of a sleeve: those that go around the limb are its ends, all others are windows.

    Raises:
        GeometryError: The surface has more or fewer than two ends.
    """
    loops = open_loops(surface)
    around = [abs(turns_about(surface.vertices[loop], limb)) == 1 for loop in loops]
    ends = [loop for loop, end in zip(loops, around, strict=True) if end]
    if len(ends) != 2:
        raise GeometryError(
            f"a sleeve has 2 edges around the limb, this surface has {len(ends)}",
            where="design domain",
            hint="change domain.above, domain.below or domain.triangles a little",
        )
    upper, lower = sorted(ends, key=lambda loop: -surface.vertices[loop, 1].mean())
    windows = tuple(loop for loop, end in zip(loops, around, strict=True) if not end)
    return Loops(upper, lower, windows)


def open_loops(surface: Surface) -> list[Int[Array, " _corner"]]:
    """Closed lines of open edges."""
    return [np.asarray(loop, np.int64) for loop in igl.boundary_loop_all(surface.triangles)]


def turns_about(loop: Float[Array, "point 3"], limb: Limb) -> int:
    """How often a closed line goes around the axis of the limb."""
    azimuth = limb.azimuth(loop)
    step = np.diff(azimuth, append=azimuth[:1])
    return round(float(np.sum((step + np.pi) % (2.0 * np.pi) - np.pi) / (2.0 * np.pi)))


def enclosed_area(surface: Surface, loop: Int[Array, " corner"]) -> float:
    """Length of the vector area of a closed line of vertices [mm^2]."""
    corners = surface.vertices[loop] - surface.vertices[loop].mean(axis=0)
    return float(0.5 * np.linalg.norm(np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)))


def loop_length(surface: Surface, loop: Int[Array, " corner"]) -> float:
    """Length of a closed line of vertices [mm]."""
    points = surface.vertices[loop]
    return float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())
