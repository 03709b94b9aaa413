"""Three and more shells: wedges about the limb's centreline, which bend where it bends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold

from fabrication.bodies import body_of
from fabrication.seams import Seam

Array = np.ndarray

ROW_MM = 3.0
"""Spacing of the rows along the centreline [mm]."""


@dataclass(frozen=True)
class Wedges:
    """Equal wedges about a line: every section across the axis is cut into the same angles.

    Attributes:
        axes: Rows: two unit directions across the limb, and along it.
        line: Centre of the limb at each row [mm].
        turn: Angle of the first wedge's first side from the first axis [rad].
        count: How many wedges.
    """

    axes: Float[Array, "3 3"]
    line: Float[Array, "row 3"]
    turn: float
    count: int

    @property
    def pulls(self) -> Float[Array, "wedge 3"]:
        """Ways in which the wedges come off: through their middles."""
        return self._direction(self.turn + (np.arange(self.count) + 0.5) * 2 * np.pi / self.count)

    def wedge_of(self, points: Float[Array, "point 3"]) -> Int[Array, " point"]:
        """Wedge that each point lies in."""
        away = (points - self._centre(points)) @ self.axes.T
        angle = (np.arctan2(away[:, 1], away[:, 0]) - self.turn) % (2 * np.pi)
        return np.minimum((angle / (2 * np.pi) * self.count).astype(int), self.count - 1)

    def depth(self, points: Float[Array, "point 3"], pull: Float[Array, "3"]) -> Float[Array, " point"]:
        """How far points lie from the centreline along a pull [mm]."""
        return (points - self._centre(points)) @ pull

    def bodies(self, reach_mm: float) -> tuple[Manifold, ...]:
        """The wedges as far as a reach; neighbours share the very triangles of the side between them."""
        ring = self.turn + np.arange(self.count) * 2 * np.pi / self.count
        spokes = self.line[:, None, :] + 4.0 * reach_mm * self._direction(ring)
        return tuple(
            _stack(np.stack([self.line, spokes[:, k], spokes[:, (k + 1) % self.count]], axis=1))
            for k in range(self.count)
        )

    def seams(self, reach_mm: float) -> tuple[Seam, ...]:
        """The sides between the wedges."""
        angles = self.turn + np.arange(self.count) * 2 * np.pi / self.count
        steps = np.arange(0.0, reach_mm, ROW_MM)
        out = []
        for k, angle in enumerate(angles):
            spoke, across = self._direction(angle), self._direction(angle + np.pi / 2)
            points = self.line[None, :, :] + steps[:, None, None] * spoke
            out.append(Seam((k - 1) % self.count, k, points, across))
        return tuple(out)

    def _direction(self, angle: float | Array) -> Array:
        return np.multiply.outer(np.cos(angle), self.axes[0]) + np.multiply.outer(np.sin(angle), self.axes[1])

    def _centre(self, points: Array) -> Array:
        height, at = points @ self.axes[2], self.line @ self.axes[2]
        return np.stack([np.interp(height, at, self.line[:, i]) for i in range(3)], axis=1)


def limb_wedges(
    centreline: Float[Array, "point 3"],
    low: float,
    high: float,
    turn: float,
    count: int,
    axes: Float[Array, "3 3"],
) -> Wedges:
    """Wedges about a centreline, prolonged straight to where the mold begins and ends.

    Args:
        centreline: Points along the limb's axis [mm].
        low: Where the mold begins along the axis [mm].
        high: Where it ends.
        turn: Angle of the first side [rad].
        count: How many wedges.
        axes: Rows: two unit directions across the limb, and along it.
    """
    local = centreline @ axes.T
    local = local[np.argsort(local[:, 2], kind="stable")]
    rows = np.linspace(low, high, int(np.ceil((high - low) / ROW_MM)) + 1)
    across = [np.interp(rows, local[:, 2], local[:, i]) for i in (0, 1)]
    return Wedges(axes, np.stack([*across, rows], axis=1) @ axes, turn, count)


def _stack(rings: Float[Array, "row corner 3"]) -> Manifold:
    """The body through polygons one above the other."""
    rows, corners = rings.shape[:2]
    number = np.arange(rows * corners).reshape(rows, corners)
    ahead = np.roll(number, -1, axis=1)
    a, b, c, d = number[:-1], ahead[:-1], ahead[1:], number[1:]
    # Both bodies beside a wall must cut its quads the same way: from the side of the first corner of the wall
    # that lies at the centreline, whichever way the polygon runs.
    first = np.stack([a, b, c, a, c, d], axis=-1)
    other = np.stack([a, b, d, b, c, d], axis=-1)
    to_centre = np.zeros(corners, bool)
    to_centre[-1] = True
    walls = np.where(to_centre[None, :, None], other, first).reshape(-1, 3)
    fan = np.stack([np.zeros(corners - 2, int), np.arange(1, corners - 1), np.arange(2, corners)], axis=1)
    triangles = np.concatenate([walls, fan[:, ::-1], fan + (rows - 1) * corners])
    body = body_of(rings.reshape(-1, 3), triangles, "parting")
    return body if body.volume() > 0 else body_of(rings.reshape(-1, 3), triangles[:, ::-1], "parting")
