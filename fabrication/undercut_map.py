"""The undercut map: how every face of the shells stands to the way in which its shell comes off."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import KDTree

from fabrication.mold import Casting, Mold, Piece
from fabrication.render import Drawn, view_from
from fabrication.scene import INK, Scene, frame, paint, plain, shell_groups

Array = np.ndarray

BEYOND_MM = 40.0
"""How far the limb's axis is drawn out beyond its ends [mm]."""

SHOWN_MM = 0.2
"""How far the coloured faces lie before the shells that they belong to [mm]."""

LEAN_DEG = (-90, -30, -10, -3, 0, 1, 5, 90)
LEAN_COLOURS = ("#1f6f5c", "#4d9f86", "#8cc7ad", "#d3e8dc", "#f6e7b4", "#eda35f", "#c0392b")
"""Steps of the lean against the pull and their colours."""


def undercut_map(scene: Scene) -> Figure:
    """How every face of the shells stands to the pull: the inside of each shell, and all of it unrolled."""
    mold = scene.mold
    shells = shell_groups(mold)
    figure = Figure(figsize=(9.0, 7.4), layout="constrained")
    grid = figure.add_gridspec(2, len(shells), height_ratios=(1.0, 0.62))
    colours, norm = ListedColormap(LEAN_COLOURS), BoundaryNorm(LEAN_DEG, len(LEAN_COLOURS))
    for number, pieces in enumerate(shells):
        pull = pieces[0].pull
        if pull is None:
            continue
        view = view_from(-pull, _upright(mold, pull))
        chosen = mold.shell_of == number
        tones = np.asarray(colours(norm(mold.undercut_deg[chosen])))[:, :3]
        surface = mold.casting.outer - SHOWN_MM * mold.casting.direction
        face = Drawn(surface, mold.casting.triangles[chosen][:, ::-1], tones)
        bodies = [plain(scene.bodies[piece.name]) for piece in pieces]
        axes = figure.add_subplot(grid[0, number])
        frame(axes, view, bodies, (0.02, 0.02))
        paint(axes, view, [*bodies, face], pixels=520)
        axes.set_title(f"inside of {_shell_title(pieces)}", fontsize=9, color=INK)
    _unrolled(figure.add_subplot(grid[1, :]), mold, shells, colours, norm)
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=figure.axes, shrink=0.6, pad=0.02)
    bar.set_label("lean against the pull [deg]: green comes off, red hinders", fontsize=9, color=INK)
    return figure


def _unrolled(
    axes: Axes, mold: Mold, shells: list[list[Piece]], colours: ListedColormap, norm: BoundaryNorm
) -> None:
    """The worst lean in each small patch, by angle around the limb and way along it."""
    across, along, label = _flat_places(mold, shells[0][0])
    columns = np.linspace(across.min(), across.max(), 181)
    rows = np.linspace(along.min(), along.max(), 90)
    worst = np.full((len(rows) - 1, len(columns) - 1), -np.inf)
    place = np.searchsorted(rows[1:-1], along), np.searchsorted(columns[1:-1], across)
    np.maximum.at(worst, place, mold.undercut_deg)
    shown = np.ma.masked_where(~np.isfinite(worst), worst)
    axes.pcolormesh(columns, rows, shown, cmap=colours, norm=norm, rasterized=True)
    owner = np.full(worst.shape, np.nan)
    owner[place] = mold.shell_of
    middles = 0.5 * (columns[1:] + columns[:-1]), 0.5 * (rows[1:] + rows[:-1])
    if len(shells) > 1:
        levels = np.arange(len(shells) - 1) + 0.5
        axes.contour(*middles, np.ma.masked_invalid(owner), levels=levels, colors=INK, linewidths=1.0)
    total = sum(mold.undercut.values())
    axes.set_title(f"unrolled; lines part the shells; {total:.0f} mm² undercut in all", fontsize=9, color=INK)
    axes.set(xlabel=label, ylabel="way along the limb [mm]")
    axes.spines[["top", "right"]].set_visible(False)


def _flat_places(mold: Mold, shell: Piece) -> tuple[Array, Array, str]:
    """Each triangle across and along the limb: around its bent axis from the first pull, or on a sheet."""
    casting = mold.casting
    places = casting.outer[casting.triangles].mean(axis=1)
    pull = shell.pull if shell.pull is not None else _upright(mold, mold.core.axis)
    if casting.flat:
        axis = mold.core.axis
        return places @ np.cross(axis, pull), places @ axis, "across [mm]"
    line, tangent, way = _axis_line(casting)
    _, nearest = KDTree(line).query(places)
    away, along = places - line[nearest], tangent[nearest]
    start = pull - (along @ pull)[:, None] * along
    start /= np.maximum(np.linalg.norm(start, axis=1, keepdims=True), 1e-12)
    side = np.cross(along, start)
    angle = np.arctan2((away * side).sum(axis=1), (away * start).sum(axis=1))
    return np.rad2deg(angle) % 360, way[nearest] + (away * along).sum(axis=1), "angle around the limb [deg]"


def _axis_line(casting: Casting) -> tuple[Array, Array, Array]:
    """The limb's axis, straight beyond its ends: points every 2 mm, unit tangents, and way along it [mm]."""
    line = casting.centreline
    ends = np.array([line[0] + BEYOND_MM * casting.down, line[-1] + BEYOND_MM * casting.up])
    line = np.concatenate([ends[:1], line, ends[1:]])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    even = np.arange(0.0, way[-1], 2.0)
    points = np.stack([np.interp(even, way, line[:, k]) for k in range(3)], axis=1)
    tangent = gaussian_filter1d(np.gradient(points, axis=0), 5.0, axis=0, mode="nearest")
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return points, tangent, even - BEYOND_MM


def _upright(mold: Mold, pull: Array) -> Array:
    """The mold's axis, or any direction across a pull that runs along it."""
    axis = mold.core.axis
    if abs(axis @ pull) < 0.95 * np.linalg.norm(axis):
        return axis
    return np.eye(3)[int(np.argmin(np.abs(pull)))]


def _shell_title(pieces: list[Piece]) -> str:
    """A shell's title without the number of its part."""
    return pieces[0].title.split(", part")[0].lower()
