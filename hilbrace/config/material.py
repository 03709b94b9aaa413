"""Section ``material``: the cast rubber and the microstructures."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section


class MaterialSettings(Section):
    """The cast rubber and the two microstructures."""

    youngs_modulus_mpa: float = Field(default=1.15, gt=0, description="Young's modulus of the rubber [MPa]")
    poisson: float = Field(default=0.45, gt=0, lt=0.5, description="Poisson's ratio [-]")
    density_g_per_ml: float = Field(default=1.08, gt=0, description="density of the rubber [g/ml]")
    thickness_mm: float = Field(default=4.0, gt=0.5, lt=20, description="thickness of the brace [mm]")
    firm: Literal["voronoi_open"] = Field(default="voronoi_open", description="firm microstructure")
    soft: Literal["sinusoidal"] = Field(default="sinusoidal", description="soft microstructure")
