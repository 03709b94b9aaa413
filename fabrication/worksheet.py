"""The work sheet: one page that leads a person from the printed pieces to the casting."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

from jinja2 import Environment
from markupsafe import Markup

from fabrication.checks import overhang_mm2
from fabrication.mold import Mold
from fabrication.pictures import cradled
from fabrication.printable import Printable
from fabrication.slicer import INFILL, PERIMETERS
from hilbrace import __version__
from hilbrace.config.mold import MoldSettings

if TYPE_CHECKING:
    from fabrication.files import MoldResult

DENSITY_G_PER_ML = 1.08
"""Density of platinum silicone of Shore 30A, as its makers state it [g/ml]."""

WASTE = 0.15
"""What stays in cups, syringes and hoses, as a part of what is needed."""

SYRINGE_ML = 60.0
"""Volume of the largest common Luer syringe [ml]."""

SUPPORT_MM2 = 300.0
"""Overhanging area from which a piece is printed with supports [mm^2]."""


@dataclass(frozen=True)
class Silicone:
    """How much silicone to mix.

    Attributes:
        brace_ml: Volume of the brace's cavity [ml].
        gutter_ml: Volume of gutter and port [ml].
        waste_ml: What stays behind [ml].
    """

    brace_ml: float
    gutter_ml: float
    waste_ml: float

    @property
    def total_ml(self) -> float:
        """Volume to mix [ml]."""
        return self.brace_ml + self.gutter_ml + self.waste_ml

    @property
    def total_g(self) -> float:
        """Mass to mix [g]."""
        return DENSITY_G_PER_ML * self.total_ml

    @property
    def component_g(self) -> float:
        """Mass of component A, and of component B: they are mixed one to one [g]."""
        return 0.5 * self.total_g

    @property
    def component_ml(self) -> float:
        """Volume of component A, and of component B [ml]."""
        return 0.5 * self.total_ml


def silicone_needed(mold: Mold) -> Silicone:
    """How much silicone a mold takes: brace, gutter and port, and what is lost."""
    brace = mold.casting.brace.volume() / 1000.0
    extra = (mold.core.gutter.volume() + sum(body.volume() for body in mold.channels)) / 1000.0
    return Silicone(brace, extra, WASTE * (brace + extra))


def worksheet(result: MoldResult, settings: MoldSettings, pictures: dict[str, bytes]) -> str:
    """The page as HTML that needs no other file and no network.

    Args:
        result: The mold, its checks and its pieces.
        settings: Section ``mold``.
        pictures: PNG files by name.
    """
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(
        resources.files("fabrication").joinpath("worksheet.html.j2").read_text("utf-8")
    )

    def figure(name: str, caption: str) -> Markup:
        source = f"data:image/png;base64,{base64.b64encode(pictures[name]).decode()}"
        return Markup('<figure><img alt="{}" src="{}"><figcaption>{}</figcaption></figure>').format(
            caption, Markup(source), caption
        )

    mold, casting = result.mold, result.mold.casting
    silicone = silicone_needed(mold)
    shells = mold.of("shell")
    return template.render(
        figure=figure,
        name=casting.name,
        what=_what(mold),
        version=__version__,
        silicone=silicone,
        syringes=max(1, -int(-silicone.total_ml // SYRINGE_ML)),
        syringe_ml=SYRINGE_ML,
        density=DENSITY_G_PER_ML,
        waste=WASTE,
        printer=result.printer,
        infill=INFILL,
        perimeters=PERIMETERS,
        pieces=[_row(piece, result) for piece in result.pieces],
        sliced=bool(result.slicings),
        total=_total(result),
        hardware=mold.hardware,
        checks=list(result.checks.values()),
        failed=result.failed,
        vents=len(mold.filling.vents),
        shells=len({piece.title.split(",")[0] for piece in shells}),
        shrinkage=settings.shrinkage_percent,
        thickness=casting.thickness_mm,
        repairs=casting.repairs,
        split=_split(mold),
        cradled=cradled(mold),
        lid=casting.flat,
    )


def _what(mold: Mold) -> str:
    casting = mold.casting
    return f"{casting.side} {casting.joint} brace".strip() if casting.joint else "brace"


def _split(mold: Mold) -> bool:
    return any("part" in piece.name for piece in mold.pieces)


def _row(piece: Printable, result: MoldResult) -> dict[str, Any]:
    slicing = result.slicings.get(piece.piece.name)
    return {
        "title": piece.piece.title,
        "file": f"stl/{piece.piece.name}.stl",
        "size": " x ".join(f"{length:.0f}" for length in piece.size),
        "volume": f"{piece.volume_mm3 / 1000:.0f}",
        "supports": _supports(piece, result),
        "time": hours(slicing.minutes) if slicing else "",
        "filament": f"{slicing.filament_g:.0f}" if slicing else "",
        "colour": "#" + "".join(f"{round(255 * value):02x}" for value in piece.piece.colour),
    }


def _supports(piece: Printable, result: MoldResult) -> str:
    """What to tell the slicer: a core's ceilings are as short as the brace is thick and need none."""
    if piece.piece.kind == "core" or overhang_mm2(piece, result.printer) < SUPPORT_MM2:
        return "none"
    return "from the bed only"


def _total(result: MoldResult) -> dict[str, str]:
    minutes = sum(slicing.minutes for slicing in result.slicings.values())
    grams = sum(slicing.filament_g for slicing in result.slicings.values())
    return {"time": hours(minutes), "filament": f"{grams:.0f}"}


def hours(minutes: float) -> str:
    """A duration as people read it: ``9 h 28 min``."""
    whole = round(minutes)
    return f"{whole // 60} h {whole % 60:02d} min" if whole >= 60 else f"{whole} min"
