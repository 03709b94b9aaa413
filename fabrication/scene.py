"""A mold made ready for drawing: its bodies as meshes, where one looks from, and paper to draw on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import matplotlib

matplotlib.use("Agg")

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fabrication.bodies import mesh_of
from fabrication.mold import Mold, Piece
from fabrication.render import Drawn, View, draw, view_from

Array = np.ndarray

INK = "#22313f"
SILICONE = (0.78, 0.30, 0.33)
PLAIN = (0.87, 0.88, 0.89)
TOLERANCE_MM = 0.08
"""How far a picture's bodies may lie from the mold [mm]."""

PIXELS = 760
"""Pixels along the longer side of a drawing."""

DPI = 150


@dataclass(frozen=True)
class Scene:
    """A mold made ready for drawing.

    Attributes:
        mold: The mold.
        bodies: Each piece's mesh, by its name.
        brace: The casting's mesh.
        view: Where one looks from.
    """

    mold: Mold
    bodies: dict[str, Drawn]
    brace: Drawn
    view: View


def prepare(mold: Mold) -> Scene:
    """Simplify the bodies of a mold for drawing and choose where to look from."""
    bodies = {piece.name: _drawn(piece.solid, piece.colour) for piece in mold.pieces}
    return Scene(mold, bodies, _drawn(mold.casting.brace, SILICONE), oblique(mold))


def oblique(mold: Mold) -> View:
    """From the front of a leg, else across the first pull, turned a little and from above."""
    axis = mold.core.axis / np.linalg.norm(mold.core.axis)
    pulls = [piece.pull for piece in mold.pieces if piece.pull is not None]
    across = np.cross(pulls[0], axis) if pulls else np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    if mold.casting.flat:
        across = 0.55 * pulls[0] + 0.8 * across
    elif across[0] < 0:
        across = -across
    across /= np.linalg.norm(across)
    side = np.cross(axis, across)
    return view_from(across + 0.35 * side + 0.38 * axis, axis)


def canvas(
    view: View,
    bodies: Iterable[Drawn],
    margin: tuple[float, float],
    below: float = 0.0,
    pixels: int = PIXELS,
) -> tuple[Figure, Axes]:
    """A figure as large as the bodies need, with room for words at its sides.

    Args:
        view: Where one looks from.
        bodies: What will be drawn.
        margin: Room left and right, below and above, in parts of the drawing.
        below: More room below.
        pixels: Along the longer side.
    """
    figure = Figure(figsize=(6.0, 6.0))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    left, right, bottom, top = frame(axes, view, bodies, margin, below)
    width, height = right - left, top - bottom
    longest = max(width, height)
    figure.set_size_inches(pixels / DPI * width / longest, pixels / DPI * height / longest)
    return figure, axes


def frame(
    axes: Axes, view: View, bodies: Iterable[Drawn], margin: tuple[float, float], below: float = 0.0
) -> tuple[float, float, float, float]:
    """Let axes show bodies and nothing else; returns left, right, bottom and top [mm]."""
    corners = np.concatenate([view.flat(body.vertices) for body in bodies])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float((high - low).max())
    room = np.asarray(margin) * size + 2.0
    (left, bottom), (right, top) = low - room, high + room
    bottom -= below * size
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.axis("off")
    return float(left), float(right), float(bottom), float(top)


def paint(axes: Axes, view: View, bodies: Iterable[Drawn], pixels: int = PIXELS) -> None:
    """Draw bodies into axes whose limits are set, so many pixels along the longer side."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    resolution = pixels / max(right - left, top - bottom)
    image = draw(list(bodies), view, (left, right, bottom, top), resolution)
    axes.imshow(np.clip(image, 0, 1), extent=(left, right, bottom, top), interpolation="none", zorder=1)
    axes.set(xlim=(left, right), ylim=(bottom, top))


def moved(body: Drawn, way: Float[Array, "3"]) -> Drawn:
    """A body elsewhere."""
    return Drawn(body.vertices + way, body.triangles, body.colours)


def plain(body: Drawn) -> Drawn:
    """A body in light grey."""
    return Drawn(body.vertices, body.triangles, np.array([PLAIN]))


def _drawn(solid: Manifold, colour: tuple[float, float, float]) -> Drawn:
    vertices, triangles = mesh_of(solid.simplify(TOLERANCE_MM))
    return Drawn(vertices, triangles, np.array([colour]))


def shell_groups(mold: Mold) -> list[list[Piece]]:
    """Shells by the way in which they come off: parts of one shell together."""
    groups: list[list[Piece]] = []
    for piece in mold.of("shell"):
        known = next((group for group in groups if _same_way(group[0], piece)), None)
        if known is None:
            groups.append([piece])
        else:
            known.append(piece)
    return groups


def _same_way(first: Piece, second: Piece) -> bool:
    return first.pull is not None and second.pull is not None and bool(np.allclose(first.pull, second.pull))
