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

PIXELS = 900
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
        across = pulls[0] + 0.6 * across
    elif across[0] < 0:
        across = -across
    across /= np.linalg.norm(across)
    side = np.cross(axis, across)
    return view_from(across + 0.35 * side + 0.38 * axis, axis)


def exploded_view(scene: Scene) -> Figure:
    """All pieces drawn apart, with their names."""
    ways = exploded(scene.mold)
    parts = {name: moved(body, ways[name]) for name, body in scene.bodies.items()}
    figure, axes = canvas(scene.view, parts.values(), margin=(0.16, 0.05))
    paint(axes, scene.view, parts.values())
    for piece in scene.mold.pieces:
        if piece.kind != "fixture":
            _name(axes, scene.view, piece, parts[piece.name])
    return figure


def undercut_map(scene: Scene) -> Figure:
    """The inner face of each shell as its core sees it, coloured by how it stands to the pull."""
    mold = scene.mold
    shells = _shell_groups(mold)
    figure = Figure(figsize=(3.4 * len(shells) + 1.2, 5.4), layout="constrained")
    steps = [-90, -30, -10, -3, 0, 1, 5, 90]
    colours = ListedColormap(["#1f6f5c", "#4d9f86", "#8cc7ad", "#d3e8dc", "#f6e7b4", "#eda35f", "#c0392b"])
    norm = BoundaryNorm(steps, colours.N)
    for number, pieces in enumerate(shells):
        pull = pieces[0].pull
        if pull is None:
            continue
        view = view_from(-pull, mold.core.axis)
        chosen = mold.shell_of == number if len(mold.shell_of) else np.zeros(0, bool)
        tones = np.asarray(colours(norm(mold.undercut_deg[chosen])))[:, :3]
        surface = mold.casting.outer - 0.05 * mold.casting.direction
        face = Drawn(surface, mold.casting.triangles[chosen][:, ::-1], tones)
        bodies = [plain(scene.bodies[piece.name]) for piece in pieces]
        axes = figure.add_subplot(1, len(shells), number + 1)
        frame(axes, view, bodies, (0.02, 0.02))
        paint(axes, view, [*bodies, face])
        area = mold.undercut.get(pieces[0].name.split("_part")[0], 0.0)
        title = pieces[0].title.split(",")[0] if len(pieces) > 1 else pieces[0].title
        axes.set_title(f"{title}: {area:.0f} mm² undercut", fontsize=9, color=INK)
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=figure.axes, shrink=0.7, pad=0.02)
    bar.set_label("lean against the pull [deg]: green comes off, red hinders", fontsize=8, color=INK)
    bar.ax.tick_params(labelsize=8)
    return figure


def step_core(scene: Scene) -> Figure:
    """The core on its base."""
    standing = [piece.name for piece in scene.mold.pieces if piece.kind in ("core", "base")]
    return _drawing(scene, {name: scene.bodies[name] for name in standing})


def step_close(scene: Scene) -> Figure:
    """The first shell in its place, the others on their way."""
    shells = _shell_groups(scene.mold)
    first = {piece.name for piece in shells[0]}
    ways = exploded(scene.mold)
    axis = scene.mold.core.axis
    parts = {}
    for piece in scene.mold.pieces:
        away = piece.kind == "shell" and (piece.name not in first or len(shells) == 1)
        way = ways[piece.name] - (ways[piece.name] @ axis) * axis
        parts[piece.name] = moved(scene.bodies[piece.name], 0.7 * way if away else np.zeros(3))
    return _drawing(scene, parts)


def step_fill(scene: Scene) -> Figure:
    """The closed mold, with the way in and the ways out."""
    filling, axis = scene.mold.filling, scene.mold.core.axis
    view = view_from(filling.inlet + 0.45 * np.cross(axis, filling.inlet) + 0.35 * axis, axis)
    parts = scene.bodies.values()
    figure, axes = canvas(view, parts, margin=(0.16, 0.08))
    paint(axes, view, parts)
    start, end = view.flat(np.stack([filling.port + 75 * filling.inlet, filling.port + 22 * filling.inlet]))
    _arrow(axes, start, end, "silicone in", SILICONE)
    top = np.concatenate([body.vertices for body in parts]) @ axis
    crown = scene.mold.core.upper.mean(axis=0)
    crown = crown + (top.max() - crown @ axis) * axis
    low, high = view.flat(np.stack([crown, crown + 0.12 * np.ptp(top) * axis]))
    _arrow(axes, low, high, "air out", "#2a6f97")
    for vent in filling.vents:
        axes.plot(*view.flat(vent[None])[0], "o", mfc="none", mec="#2a6f97", ms=9)
    return figure


def step_open(scene: Scene) -> Figure:
    """The shells drawn off, the casting on its core."""
    ways = exploded(scene.mold)
    axis = scene.mold.core.axis
    parts = {}
    for piece in scene.mold.pieces:
        way = ways[piece.name] - (ways[piece.name] @ axis) * axis
        parts[piece.name] = moved(scene.bodies[piece.name], way)
    raised = moved(scene.brace, np.zeros(3))
    return _drawing(scene, {**parts, "casting": raised})


def canvas(view: View, bodies: Iterable[Drawn], margin: tuple[float, float]) -> tuple[Figure, Axes]:
    """A figure as large as the bodies need, with room for words at its sides.

    Args:
        view: Where one looks from.
        bodies: What will be drawn.
        margin: Room left and right, below and above, in parts of the drawing.
    """
    figure = Figure(figsize=(6.0, 6.0))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    left, right, bottom, top = frame(axes, view, bodies, margin)
    width, height = right - left, top - bottom
    longest = max(width, height)
    figure.set_size_inches(PIXELS / DPI * width / longest, PIXELS / DPI * height / longest)
    return figure, axes


def frame(
    axes: Axes, view: View, bodies: Iterable[Drawn], margin: tuple[float, float]
) -> tuple[float, float, float, float]:
    """Let axes show bodies and nothing else; returns left, right, bottom and top [mm]."""
    corners = np.concatenate([view.flat(body.vertices) for body in bodies])
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = np.asarray(margin) * (high - low).max() + 2.0
    (left, bottom), (right, top) = low - room, high + room
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.axis("off")
    return float(left), float(right), float(bottom), float(top)


def paint(axes: Axes, view: View, bodies: Iterable[Drawn]) -> None:
    """Draw bodies into axes whose limits are set."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    figure = axes.get_figure()
    inches = max(figure.get_size_inches()) if figure is not None else 6.0
    resolution = inches * DPI / max(right - left, top - bottom)
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


def _name(axes: Axes, view: View, piece: Piece, body: Drawn) -> None:
    """A piece's title beside it, on the side where there is room."""
    flat = view.flat(body.vertices)
    centre = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    (left, right), _ = axes.get_xlim(), axes.get_ylim()
    on_left = centre[0] < 0.5 * (left + right) - 1.0
    edge = flat[:, 0].min() if on_left else flat[:, 0].max()
    axes.annotate(
        piece.title,
        xy=(edge + (0.12 if on_left else -0.12) * np.ptp(flat[:, 0]), centre[1]),
        xytext=(left + 0.01 * (right - left) if on_left else right - 0.01 * (right - left), centre[1]),
        ha="left" if on_left else "right",
        va="center",
        fontsize=9,
        color=INK,
        zorder=4,
        bbox={"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "#c9d1d6", "linewidth": 0.6},
        arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.7},
    )


def _arrow(axes: Axes, start: Array, end: Array, text: str, colour: object) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 2.4, "mutation_scale": 16}
    axes.annotate("", xy=end, xytext=start, arrowprops=style, zorder=5)
    tail = np.asarray(start) if np.linalg.norm(np.asarray(end) - start) else np.asarray(end)
    axes.text(*tail, f" {text} ", color=colour, fontsize=10, ha="center", va="bottom", zorder=6)
