"""Pictures of a mold: drawn apart, cut through, its undercuts, and each step of the casting."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from fabrication.bodies import mesh_of
from fabrication.exploded import exploded
from fabrication.fixtures.stand import STANDING
from fabrication.mold import Mold, Piece
from fabrication.render import Drawn, View, draw, view_from
from fabrication.section import section
from hilbrace.run.records import write_atomic

Array = np.ndarray

INK = "#22313f"
SILICONE = (0.78, 0.30, 0.33)
PLAIN = (0.87, 0.88, 0.89)
TOLERANCE_MM = 0.08
"""How far a picture's bodies may lie from the mold [mm]."""

PIXELS = 760
"""Pixels along the longer side of a drawing."""

DPI = 150

AIR = "#2a6f97"
MOUTH_MM = 24.0
"""From the cavity to the tip of the arrow at the port [mm]."""

SHOWN_MM = 0.2
"""How far the coloured faces lie before the shells that they belong to [mm]."""

LEAN_DEG = (-90, -30, -10, -3, 0, 1, 5, 90)
LEAN_COLOURS = ("#1f6f5c", "#4d9f86", "#8cc7ad", "#d3e8dc", "#f6e7b4", "#eda35f", "#c0392b")
"""Steps of the lean against the pull and their colours."""


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


def write_pictures(folder: Path, mold: Mold) -> dict[str, bytes]:
    """Draw and write all pictures of a mold as PNG files.

    Args:
        folder: Where they go; it exists.
        mold: The mold.

    Returns:
        The files' contents by their names without ending.
    """
    scene = prepare(mold)
    drawn = {
        "exploded": exploded_view(scene),
        "section": section(mold),
        "undercut": undercut_map(scene),
        "step_core": step_core(scene),
        "step_close": step_close(scene),
        "step_fill": step_fill(scene),
        "step_open": step_open(scene),
    }
    contents = {}
    for name, figure in drawn.items():
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
        contents[name] = buffer.getvalue()
        write_atomic(folder / f"{name}.png", contents[name])
    return contents


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


def exploded_view(scene: Scene) -> Figure:
    """All pieces drawn apart and numbered, with their names below."""
    ways = exploded(scene.mold)
    parts = {name: moved(body, ways[name]) for name, body in scene.bodies.items()}
    figure, axes = canvas(scene.view, parts.values(), margin=(0.03, 0.02), below=0.09)
    paint(axes, scene.view, parts.values())
    names = []
    for number, piece in enumerate(scene.mold.pieces, 1):
        _number(axes, scene.view.flat(parts[piece.name].vertices), str(number))
        names.append(f"{number}  {piece.title}")
    columns = 2 if len(names) > 4 else 1
    rows = -(-len(names) // columns)
    for column in range(columns):
        text = "\n".join(names[column * rows : (column + 1) * rows])
        place = (0.06 + 0.5 * column, 0.015)
        axes.text(*place, text, transform=axes.transAxes, fontsize=8.5, color=INK, va="bottom")
    return figure


def undercut_map(scene: Scene) -> Figure:
    """How every face of the shells stands to the pull: the inside of each shell, and all of it unrolled."""
    mold = scene.mold
    shells = _shell_groups(mold)
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
    """The worst lean in each small patch, by angle around the limb and height along it."""
    casting = mold.casting
    axis = mold.core.axis / np.linalg.norm(mold.core.axis)
    first = shells[0][0].pull
    start = _upright(mold, axis) if first is None else first - (first @ axis) * axis
    if mold.casting.flat:
        start = np.cross(axis, casting.direction.mean(axis=0))
    start = start / np.linalg.norm(start)
    side = np.cross(axis, start)
    places = casting.outer[casting.triangles].mean(axis=1)
    height = places @ axis
    line = casting.centreline
    order = np.argsort(line @ axis)
    centre = np.stack([np.interp(height, (line @ axis)[order], line[order, k]) for k in range(3)], axis=1)
    away = places - centre
    if casting.flat:
        across, label = places @ start, "across [mm]"
    else:
        across = np.rad2deg(np.arctan2(away @ side, away @ start)) % 360
        label = "angle around the limb [deg]"
    columns = np.linspace(across.min(), across.max(), 181)
    rows = np.linspace(height.min(), height.max(), 90)
    worst = np.full((len(rows) - 1, len(columns) - 1), -np.inf)
    place = np.searchsorted(rows[1:-1], height), np.searchsorted(columns[1:-1], across)
    np.maximum.at(worst, place, mold.undercut_deg)
    shown = np.ma.masked_where(~np.isfinite(worst), worst)
    axes.pcolormesh(columns, rows, shown, cmap=colours, norm=norm, rasterized=True)
    owner = np.full(worst.shape, np.nan)
    owner[place] = mold.shell_of
    middles = 0.5 * (columns[1:] + columns[:-1]), 0.5 * (rows[1:] + rows[:-1])
    if len(shells) > 1:
        levels = np.arange(len(shells) - 1) + 0.5
        axes.contour(*middles, np.nan_to_num(owner), levels=levels, colors=INK, linewidths=1.0)
    total = sum(mold.undercut.values())
    axes.set_title(f"unrolled; lines part the shells; {total:.0f} mm² undercut in all", fontsize=9, color=INK)
    axes.set(xlabel=label, ylabel="height [mm]")
    axes.spines[["top", "right"]].set_visible(False)


def _upright(mold: Mold, pull: Array) -> Array:
    """The mold's axis, or any direction across a pull that runs along it."""
    axis = mold.core.axis
    if abs(axis @ pull) < 0.95 * np.linalg.norm(axis):
        return axis
    return np.eye(3)[int(np.argmin(np.abs(pull)))]


def _shell_title(pieces: list[Piece]) -> str:
    """A shell's title without the number of its part."""
    return pieces[0].title.split(", part")[0].lower()


def cradled(mold: Mold) -> bool:
    """Whether the closed mold lies in a cradle; else its core stands on a plate."""
    return mold.casting.flat or float(-mold.core.axis @ mold.casting.down) < STANDING


def step_core(scene: Scene) -> Figure:
    """The core, on its base if it stands on one."""
    kinds = ("core",) if cradled(scene.mold) else ("core", "base")
    standing = [piece.name for piece in scene.mold.pieces if piece.kind in kinds]
    return _drawing(scene, {name: scene.bodies[name] for name in standing})


def step_close(scene: Scene) -> Figure:
    """The first shell in its place, the others on their way."""
    shells = _shell_groups(scene.mold)
    first = {piece.name for piece in shells[0]}
    ways = exploded(scene.mold)
    axis = scene.mold.core.axis
    parts = {}
    for piece in scene.mold.pieces:
        if piece.kind == "base" and cradled(scene.mold):
            continue
        away = piece.kind == "shell" and (piece.name not in first or len(shells) == 1)
        way = ways[piece.name] - (ways[piece.name] @ axis) * axis
        parts[piece.name] = moved(scene.bodies[piece.name], 0.7 * way if away else np.zeros(3))
    return _drawing(scene, parts)


def step_fill(scene: Scene) -> Figure:
    """The closed mold, with the way in and the ways out."""
    filling, axis = scene.mold.filling, scene.mold.core.axis
    view = view_from(filling.inlet + 1.2 * np.cross(axis, filling.inlet) + 0.45 * axis, axis)
    parts = scene.bodies.values()
    figure, axes = canvas(view, parts, margin=(0.10, 0.14))
    paint(axes, view, parts)
    points = np.concatenate([body.vertices for body in parts])
    long = 0.13 * float(np.ptp(points @ axis))
    mouth = filling.port + MOUTH_MM * filling.inlet
    way_in = view.flat(np.stack([mouth + long * filling.inlet, mouth]))
    _arrow(axes, way_in, "silicone in", SILICONE, at_tip=False)
    middle = scene.mold.core.upper.mean(axis=0)
    crown = middle + ((scene.mold.core.upper @ axis).max() + 12.0 - middle @ axis) * axis
    _arrow(axes, view.flat(np.stack([crown, crown + long * axis])), "air out", AIR, at_tip=True)
    for vent in filling.vents:
        if (vent - middle) @ np.cross(view.right, axis) > 0:
            x, y = view.flat(vent[None])[0]
            axes.plot(x, y, "o", mfc="none", mec=AIR, ms=9, zorder=5)
    return figure


def step_open(scene: Scene) -> Figure:
    """The shells drawn off, the casting on its core."""
    ways = exploded(scene.mold)
    axis = scene.mold.core.axis
    parts = {}
    for piece in scene.mold.pieces:
        if piece.kind == "base" and cradled(scene.mold):
            continue
        way = ways[piece.name] - (ways[piece.name] @ axis) * axis
        parts[piece.name] = moved(scene.bodies[piece.name], way)
    return _drawing(scene, {**parts, "casting": scene.brace})


def canvas(
    view: View, bodies: Iterable[Drawn], margin: tuple[float, float], below: float = 0.0
) -> tuple[Figure, Axes]:
    """A figure as large as the bodies need, with room for words at its sides.

    Args:
        view: Where one looks from.
        bodies: What will be drawn.
        margin: Room left and right, below and above, in parts of the drawing.
        below: More room below.
    """
    figure = Figure(figsize=(6.0, 6.0))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    left, right, bottom, top = frame(axes, view, bodies, margin, below)
    width, height = right - left, top - bottom
    longest = max(width, height)
    figure.set_size_inches(PIXELS / DPI * width / longest, PIXELS / DPI * height / longest)
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


def _drawing(scene: Scene, parts: dict[str, Drawn]) -> Figure:
    figure, axes = canvas(scene.view, parts.values(), margin=(0.03, 0.03))
    paint(axes, scene.view, parts.values())
    return figure


def _shell_groups(mold: Mold) -> list[list[Piece]]:
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


def _number(axes: Axes, flat: Float[Array, "point 2"], text: str) -> None:
    """A number in a circle on the middle of what is drawn."""
    x, y = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    style = {"boxstyle": "circle,pad=0.25", "facecolor": "white", "edgecolor": INK, "linewidth": 0.9}
    axes.text(x, y, text, ha="center", va="center", fontsize=9, color=INK, zorder=6, bbox=style)


def _arrow(
    axes: Axes, way: Float[Array, "2 2"], text: str, colour: str | tuple[float, float, float], at_tip: bool
) -> None:
    """An arrow on paper with a word at its tail, or at its tip."""
    start, end = ((float(x), float(y)) for x, y in way)
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 2.6, "mutation_scale": 18}
    axes.annotate("", xy=end, xytext=start, arrowprops=style, zorder=5)
    x, y = end if at_tip else start
    axes.text(
        x,
        y,
        text,
        color=colour,
        fontsize=10,
        ha="center",
        va="top" if end[1] > start[1] and not at_tip else "bottom",
        zorder=6,
        bbox={"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
    )
