"""Section ``material``: the cast rubber and the microstructures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from hilbrace.config.section import Section

CELLS = (
    "voronoi_open",
    "voronoi_tri",
    "honeycomb",
    "star",
    "reentrant",
    "sinusoidal",
    "square",
    "diamond",
    "octagon",
)
"""Names of the built-in microstructures; `hilbrace.material.skeleton_file` reads the skeleton of each."""


def _known_cell(name: str) -> str:
    if name in CELLS or name.endswith(".toml"):
        return name
    raise ValueError(f"no such microstructure; choose {', '.join(CELLS)}, or a skeleton file (.toml)")


CellName = Annotated[str, AfterValidator(_known_cell)]
"""Name of a built-in microstructure, or path of a skeleton file."""


class MaterialSettings(Section):
    """The cast rubber and the two microstructures."""

    youngs_modulus_mpa: float = Field(default=1.15, gt=0, description="Young's modulus of the rubber [MPa]")
    poisson: float = Field(default=0.45, gt=0, lt=0.5, description="Poisson's ratio [-]")
    density_g_per_ml: float = Field(default=1.08, gt=0, description="density of the rubber [g/ml]")
    thickness_mm: float = Field(default=4.0, gt=0.5, lt=20, description="thickness of the brace [mm]")
    lame: Literal["plane_stress", "plane_strain"] = Field(
        default="plane_stress",
        description="first Lame constant of the skin's energy: that of a sheet, or the paper's",
    )
    segmentation: Literal["graphcut", "spectral"] = Field(
        default="graphcut",
        description="how soft and firm skin are told apart by their energy: graphcut calls the strongly "
        "strained soft, spectral is the paper's self-tuning clustering, about half and half",
    )
    firm: CellName = Field(
        default="voronoi_open", description="firm microstructure: a built-in name or a skeleton file (.toml)"
    )
    soft: CellName = Field(
        default="sinusoidal", description="soft microstructure: a built-in name or a skeleton file (.toml)"
    )
