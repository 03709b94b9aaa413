"""Where a brace is firm, and which loss wants it so: in words and as a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from hilbrace.body.body import Body
from hilbrace.domain.domain import Domain
from hilbrace.domain.limb import find_limb
from hilbrace.optimize.design import Design
from hilbrace.optimize.pulls import shares_of_pull
from hilbrace.report.figures import INK
from hilbrace.report.paint import BACK, FRONT, LEFT, RIGHT, paint
from hilbrace.report.words import listed

Array = np.ndarray

SIDES = ("front", "lateral side", "back", "medial side")
THIRDS = ("lower", "middle", "upper")

WANTS = ("L1 joint stability", "L2 elastic energy", "L3 compliance", "L4 volume", "L5 seam")
"""How people call the losses."""

DISTINCT = 0.1
"""A side whose mean design variable differs by this from the whole brace's is called firm or open [-]."""

PULL_COLOURS = "BrBG"


@dataclass(frozen=True)
class Zones:
    """The brace's triangles by side and height.

    Attributes:
        side: Place in `SIDES`.
        third: Place in `THIRDS`.
        areas: Areas of the triangles that the design is free in [mm^2]; zero in the solid rims.
    """

    side: Float[Array, " triangle"]
    third: Float[Array, " triangle"]
    areas: Float[Array, " triangle"]


def zones(body: Body, domain: Domain, design: Design) -> Zones:
    """Sort the triangles by the side of the limb they lie on, and by thirds of the brace's height.

    Args:
        body: The body.
        domain: The brace's surface.
        design: The design, whose rims are left out.
    """
    joint, letter = domain.joint.split("_")
    limb = find_limb(body, joint, "left" if letter == "l" else "right")
    corners = domain.vertices[domain.triangles]
    azimuth = np.rad2deg(limb.azimuth(limb.rest_frame(corners.mean(axis=1))))
    height = domain.uv[domain.cut_triangles, 1].mean(axis=1)
    share = (height - height.min()) / max(float(np.ptp(height)), 1e-12)
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    return Zones(
        np.round(azimuth / 90.0) % 4.0,
        np.minimum(np.floor(3.0 * share), 2.0),
        np.where(design.rim, 0.0, areas),
    )


def reasons(design: Design, found: Zones) -> list[str]:
    """Sentences: which sides are firm or open, over what height, and which losses want it.

    Args:
        design: The finished design.
        found: Its triangles by side and height.
    """
    whole = _mean(design, found.areas)
    sides = [_mean(design, found.areas * (found.side == side)) for side in range(len(SIDES))]
    order = sorted(range(len(SIDES)), key=lambda side: -sides[side])
    told = [
        _sentence(design, found, side, sides[side], whole)
        for side in order
        if abs(sides[side] - whole) >= DISTINCT
    ]
    if not any(mean - whole >= DISTINCT for mean in sides):
        told.insert(0, _firmest(design, found, whole))
    return told


def pull_picture(domain: Domain, design: Design) -> Figure:
    """Where L1, L2 and L3 want the brace firmer (green) and where more open (brown), each on its own scale.

    L4 is left out: it asks for the same volume everywhere. The pulls are averaged over neighbours.

    Args:
        domain: The brace's surface.
        design: The finished design.
    """
    shown = [place for place in range(3) if np.abs(design.pulls[place]).max(initial=0.0) > 0.0]
    outer, inner = (RIGHT, LEFT) if domain.joint.endswith("_r") else (LEFT, RIGHT)
    views = (("front", FRONT), ("lateral", outer), ("back", BACK), ("medial", inner))
    figure = Figure(figsize=(9.6, 3.0 * max(len(shown), 1)), layout="constrained")
    norm = Normalize(-1.0, 1.0)
    for row, place in enumerate(shown):
        pull = _averaged(domain, design.pulls[place])
        colours = colormaps[PULL_COLOURS](norm(pull / max(float(np.quantile(np.abs(pull), 0.99)), 1e-300)))
        for column, (name, towards) in enumerate(views):
            axes = figure.add_subplot(len(shown), 4, 4 * row + column + 1)
            paint(axes, domain.vertices, domain.triangles, colours[:, :3], towards)
            if row == 0:
                axes.set_title(name, fontsize=9, color=INK)
            if column == 0:
                axes.text(
                    -0.1, 0.5, WANTS[place], rotation=90, va="center", ha="right", transform=axes.transAxes,
                    color=INK, fontsize=9,
                )  # fmt: skip
    if shown:
        bar = figure.colorbar(
            ScalarMappable(norm, PULL_COLOURS), ax=figure.axes, shrink=0.35, aspect=18, pad=0.01
        )
        bar.set_ticks([-1, 0, 1], labels=["more open", "content", "firmer"])
    return figure


def _averaged(
    domain: Domain, values: Float[Array, " triangle"], rounds: int = 3
) -> Float[Array, " triangle"]:
    """Means over the triangles around each vertex, and back."""
    corners, count = domain.triangles.ravel(), len(domain.vertices)
    shared = np.bincount(corners, minlength=count).clip(1)
    for _ in range(rounds):
        at_vertices = np.bincount(corners, np.repeat(values, 3), count) / shared
        values = at_vertices[domain.triangles].mean(axis=1)
    return values


def _sentence(design: Design, found: Zones, side: int, mean: float, whole: float) -> str:
    firm = mean > whole
    there = found.areas * (found.side == side)
    thirds = [
        name
        for third, name in enumerate(THIRDS)
        if _differs(_mean(design, there * (found.third == third)) - whole, firm)
    ]
    return (
        f"The {SIDES[side]} is {'firm' if firm else 'open'} {_where(thirds)} (mean design variable "
        f"{mean:.2f}, {whole:.2f} over the whole brace){_wanted(design, there, firm)}"
    )


def _firmest(design: Design, found: Zones, whole: float) -> str:
    """The firmest third of a side, where no whole side is firm."""
    places = [(side, third) for side in range(len(SIDES)) for third in range(len(THIRDS))]
    parts = [found.areas * (found.side == side) * (found.third == third) for side, third in places]
    means = [_mean(design, part) for part in parts]
    best = int(np.argmax(means))
    if means[best] - whole < DISTINCT:
        return f"The brace is about equally firm all around (mean design variable {whole:.2f})."
    side, third = places[best]
    wanted = _wanted(design, parts[best], firmer=True)
    return (
        f"No side is firm as a whole; the firmest place is the {THIRDS[third]} third of the {SIDES[side]} "
        f"(mean design variable {means[best]:.2f}, {whole:.2f} over the whole brace){wanted}"
    )


def _wanted(design: Design, part: Float[Array, " triangle"], firmer: bool) -> str:
    """The losses that pull a part one way, the strongest first, as the end of a sentence."""
    shares = shares_of_pull(design, part, firmer)
    names = [
        f"{WANTS[place]} ({100.0 * shares[place]:.0f} % of the pull)"
        for place in np.argsort(-shares, kind="stable")
        if shares[place] >= 0.1
    ]
    return f": wanted by {listed(names)}." if names else "; no loss pulls it there any more."


def _where(thirds: list[str]) -> str:
    if len(thirds) in (0, len(THIRDS)):
        return "from edge to edge"
    return f"in its {listed(thirds[::-1])} third"


def _differs(difference: float, firm: bool) -> bool:
    return difference >= DISTINCT if firm else difference <= -DISTINCT


def _mean(design: Design, areas: Float[Array, " triangle"]) -> float:
    return float(areas @ design.d_triangle / max(float(areas.sum()), 1e-300))
