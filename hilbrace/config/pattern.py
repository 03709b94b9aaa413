"""Sections ``pattern`` and ``solid``: the microstructure on the surface, and the closed body."""

from __future__ import annotations

from pydantic import Field

from hilbrace.config.section import Section


class PatternSettings(Section):
    """The microstructure on the surface."""

    scale: float | None = Field(
        default=None,
        gt=0.01,
        lt=0.5,
        description="period of the cells in the flat map (paper: 0.08); from period_mm if left out",
    )
    period_mm: float | None = Field(
        default=None,
        gt=5,
        lt=300,
        description="period of the cells on the limb [mm]; 80 on a knee and 60 on an ankle if left out. Wide "
        "cells can be thinned out further before their struts are too narrow to cast",
    )
    min_strut_mm: float = Field(default=1.5, gt=0, description="narrowest strut that can be cast [mm]")
    min_slit_mm: float = Field(default=1.0, ge=0, description="narrowest slit that can be cast [mm]")
    rim_mm: float = Field(default=8.0, ge=2, description="width of the solid bands at both edges [mm]")
    seam_mm: float = Field(
        default=3.0,
        gt=0,
        description="width of the solid strip that joins both sides of the seam of a map that does not close "
        "around the limb (lscm, slim), never narrower than min_strut_mm [mm]",
    )
    blend_mm: float = Field(default=30.0, gt=0, description="width of the transition from firm to soft [mm]")
    resolution_mm: float | None = Field(
        default=None,
        gt=0.1,
        lt=5,
        description="mean edge of the refined surface, at most 0.55 min_strut_mm; that, but no more than "
        "1.0, if left out [mm]",
    )


class SolidSettings(Section):
    """The closed body."""

    simplify_mm: float = Field(
        default=0.05, ge=0, description="largest deviation of the simplified mesh [mm]"
    )
