"""Section ``subject``: who moves."""

from __future__ import annotations

from pydantic import Field

from hilbrace.config.section import Section


class SubjectSettings(Section):
    """Who moves."""

    name: str = Field(default="subject", description="name used in reports")
    mass_kg: float | None = Field(
        default=None, gt=10, lt=300, description="mass [kg]; read from the forces if left out"
    )
    height_m: float | None = Field(
        default=None, gt=0.8, lt=2.6, description="height [m]; from the markers if left out"
    )
