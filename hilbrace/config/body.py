"""Section ``body``: the skin."""

from __future__ import annotations

from pydantic import Field

from hilbrace.config.section import Section


class BodySettings(Section):
    """The skin."""

    weight_smoothing_mm: float = Field(
        default=40.0, ge=0, description="diffusion length of the skinning weights [mm]"
    )
