"""Pictures of a mold: drawn apart, cut through, its undercuts, and each step of the casting."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fabrication.exploded import exploded
from fabrication.fixtures.stand import STANDING
from fabrication.mold import Mold
from fabrication.render import Drawn, view_from
from fabrication.scene import DPI, INK, SILICONE, Scene, canvas, moved, paint, prepare, shell_groups
from fabrication.section import section
from fabrication.undercut_map import undercut_map
from hilbrace.run.records import write_atomic

Array = np.ndarray

STEP_PIXELS = 560
"""Pixels along the longer side of the steps' pictures, which are shown small."""

AIR = "#2a6f97"
MOUTH_MM = 24.0
"""From the cavity to the tip of the arrow at the port [mm]."""


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


def exploded_view(scene: Scene) -> Figure:
    """All pieces drawn apart and numbered, with their names below."""
    ways = exploded(scene.mold)
    parts = {name: moved(body, ways[name]) for name, body in scene.bodies.items()}
    rows = -(-len(parts) // 2) if len(parts) > 4 else len(parts)
    figure, axes = canvas(scene.view, parts.values(), margin=(0.03, 0.02), below=0.02 + 0.033 * rows)
    paint(axes, scene.view, parts.values())
    names = []
    for number, piece in enumerate(scene.mold.pieces, 1):
        _number(axes, scene.view.flat(parts[piece.name].vertices), str(number))
        names.append(f"{number}  {piece.title}")
    for column in range(-(-len(names) // rows)):
        text = "\n".join(names[column * rows : (column + 1) * rows])
        place = (0.03 + 0.5 * column, 0.012)
        axes.text(*place, text, transform=axes.transAxes, fontsize=7.5, color=INK, va="bottom")
    return figure


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
    shells = shell_groups(scene.mold)
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
    figure, axes = canvas(view, parts, margin=(0.10, 0.14), pixels=STEP_PIXELS)
    paint(axes, view, parts, STEP_PIXELS)
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


def _drawing(scene: Scene, parts: dict[str, Drawn]) -> Figure:
    figure, axes = canvas(scene.view, parts.values(), margin=(0.03, 0.03), pixels=STEP_PIXELS)
    paint(axes, scene.view, parts.values(), STEP_PIXELS)
    return figure


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
