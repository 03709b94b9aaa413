"""Section ``mold``: the casting mold, the printer that makes it and the silicone that fills it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section


class MoldSettings(Section):
    """The casting mold."""

    printer: str = Field(
        default="prusa_mk4",
        description="profile of the printer, or a bed of your own as WIDTHxDEPTHxHEIGHT in mm: 250x210x210",
    )
    process: Literal["fdm", "sla"] | None = Field(
        default=None,
        description="how the printer works: sets clearances and least walls; as the profile says, fdm for a "
        "bed of your own, if left out",
    )
    shells: int | None = Field(
        default=None,
        ge=2,
        le=4,
        description="outer shells, 2 to 4; the fewest that the undercut scan proves removable if left out",
    )
    wall_mm: float = Field(default=6.0, ge=2, le=20, description="wall of the outer shells [mm]")
    flange_mm: float = Field(default=14.0, ge=8, le=40, description="width of the flanges [mm]")
    bolt_mm: float = Field(default=4.0, ge=2, le=8, description="nominal diameter of the bolts (M4) [mm]")
    bolt_spacing_mm: float = Field(
        default=60.0, ge=20, le=150, description="largest distance between bolts [mm]"
    )
    shrinkage_percent: float = Field(
        default=0.1,
        ge=0,
        le=5,
        description="linear shrinkage of the casting, made up for by a larger mold; 0.1 of platinum "
        "silicone [%]",
    )
    draft_deg: float = Field(default=2.0, ge=0, le=10, description="draft of the groove walls [deg]")
    gutter_mm: float = Field(
        default=10.0, ge=4, le=30, description="height of the open gutter along the upper rim [mm]"
    )
    foot_mm: float = Field(
        default=16.0, ge=8, le=60, description="how far the core goes on below the brace's lower edge [mm]"
    )
    resolution_mm: float = Field(
        default=0.8,
        gt=0.1,
        lt=5,
        description="mean edge of the limb's surface under a brace given as a file; that of a run is its "
        "pattern's [mm]",
    )
