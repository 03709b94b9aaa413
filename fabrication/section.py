"""The closed mold cut through: along its axis, across it, and a groove from near."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path

from fabrication.mold import Casting, Mold

Array = np.ndarray

INK = "#22313f"
RUBBER = (0.78, 0.30, 0.33)
GUTTER = (0.93, 0.66, 0.66)
NEAR_MM = 44.0
"""Height of the groove's close view [mm]."""


@dataclass(frozen=True)
class Plane:
    """A plane to cut in, with directions on paper.

    Attributes:
        origin: A point of it [mm].
        right: Unit direction to the right on paper.
        up: Unit direction up on paper.
    """

    origin: Float[Array, "3"]
    right: Float[Array, "3"]
    up: Float[Array, "3"]

    @property
    def turn(self) -> Float[Array, "3 3"]:
        """Rows: right, up, and towards the eye."""
        return np.stack([self.right, self.up, np.cross(self.right, self.up)])

    def flat(self, points: Float[Array, "point 3"]) -> Float[Array, "point 2"]:
        """Points on paper [mm]."""
        return (points - self.origin) @ self.turn[:2].T

    def cut(self, solid: Manifold) -> list[Float[Array, "corner 2"]]:
        """Outlines of a body in the plane: outer ones anticlockwise, holes clockwise [mm]."""
        turn = self.turn
        placed = solid.transform(np.column_stack([turn, -turn @ self.origin]))
        return [np.asarray(outline) for outline in placed.slice(0.0).to_polygons()]


def section(mold: Mold) -> Figure:
    """Cut a mold along its axis and across it."""
    along, across = planes(mold)
    figure = Figure(figsize=(9.4, 6.2), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.0), height_ratios=(1.0, 1.0))
    left = figure.add_subplot(grid[:, 0])
    fill(left, mold, along)
    left.set_title("along the axis", fontsize=10, color=INK)
    place = _groove(mold.casting, along)
    near = figure.add_subplot(grid[0, 1])
    fill(near, mold, along)
    half = 0.5 * NEAR_MM
    near.set(xlim=(place[0] - 1.4 * half, place[0] + 1.4 * half), ylim=(place[1] - half, place[1] + half))
    near.spines[:].set_visible(True)
    near.set_title(f"grooves, {mold.casting.thickness_mm:.1f} mm deep", fontsize=10, color=INK)
    corner = (float(place[0] - 1.4 * half), float(place[1] - half))
    left.add_patch(Rectangle(corner, 2.8 * half, 2 * half, fill=False, ec=INK, lw=1.0, clip_on=False))
    low = figure.add_subplot(grid[1, 1])
    fill(low, mold, across)
    low.set_title("across the axis", fontsize=10, color=INK)
    handles = [Rectangle((0, 0), 1, 1, facecolor=colour, ec=INK, lw=0.6) for _, colour in _legend(mold)]
    names = [name for name, _ in _legend(mold)]
    figure.legend(handles, names, loc="outside lower center", ncols=6, frameon=False, fontsize=9)
    return figure


def planes(mold: Mold) -> tuple[Plane, Plane]:
    """The plane that holds axis and first pull, and the one across the axis half-way up."""
    axis = mold.core.axis / np.linalg.norm(mold.core.axis)
    pulls = [piece.pull for piece in mold.pieces if piece.pull is not None]
    right = pulls[0] - (pulls[0] @ axis) * axis if pulls else np.cross(axis, np.eye(3)[0])
    right = right / np.linalg.norm(right)
    box = np.reshape(mold.casting.brace.bounding_box(), (2, 3))
    middle = box.mean(axis=0)
    return Plane(middle, right, axis), Plane(middle, right, np.cross(axis, right))


def fill(axes: Axes, mold: Mold, plane: Plane) -> None:
    """Fill what a plane cuts: pieces in their colours, silicone in red."""
    for piece in mold.pieces:
        _patch(axes, plane.cut(piece.solid), piece.colour, 1)
    _patch(axes, plane.cut(mold.core.gutter), GUTTER, 2)
    _patch(axes, plane.cut(mold.casting.brace), RUBBER, 3)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def _patch(axes: Axes, outlines: list[Array], colour: tuple[float, float, float], order: int) -> None:
    if not outlines:
        return
    path = Path.make_compound_path(*(Path(np.vstack([line, line[:1]]), closed=True) for line in outlines))
    axes.add_patch(PathPatch(path, facecolor=colour, edgecolor=INK, linewidth=0.5, zorder=order))


def _groove(casting: Casting, plane: Plane) -> Float[Array, "2"]:
    """A place of the cut where silicone and land alternate: the outermost cut of the brace half-way up."""
    outlines = plane.cut(casting.brace)
    if not outlines:
        return np.zeros(2)
    centres = np.array([outline.mean(axis=0) for outline in outlines])
    outer = (
        centres[:, 0] >= np.quantile(centres[:, 0], 0.6) if len(centres) > 2 else np.ones(len(centres), bool)
    )
    near = centres[outer]
    return near[int(np.argmin(np.abs(near[:, 1])))]


def _legend(mold: Mold) -> list[tuple[str, tuple[float, float, float]]]:
    seen: dict[tuple[float, float, float], str] = {}
    for piece in mold.pieces:
        if piece.kind != "fixture":
            seen.setdefault(piece.colour, piece.title.split(", part")[0])
    return [("silicone", RUBBER), ("gutter", GUTTER), *((title, colour) for colour, title in seen.items())]
