"""Section ``domain``: where the brace sits and how its surface is meshed."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section

Point = tuple[float, float, float]


class EdgeSettings(Section):
    """A plane that the brace ends at: through a landmark, or anywhere."""

    landmark: str | None = Field(
        default=None,
        description="landmark that the edge runs through, across the segment there; at the knee patella, "
        "tibial_tuberosity, fibular_head, lateral_condyle, medial_condyle, popliteal_fossa; at the ankle "
        "heel, lateral_malleolus, medial_malleolus, achilles_tendon, instep, navicular, "
        "fifth_metatarsal_base",
    )
    offset_mm: float = Field(
        default=0.0, description="distance of the edge from the landmark, away from the joint [mm]"
    )
    point_mm: Point | None = Field(
        default=None, description="a point of the plane from the joint's centre: front, up, to the right [mm]"
    )
    normal: Point | None = Field(
        default=None, description="normal of that plane; across the segment if left out"
    )


class WindowSettings(Section):
    """A hole in the brace around a landmark."""

    at: str = Field(description="landmark in the middle of the window")
    width_mm: float | None = Field(
        default=None, gt=5, description="width around the limb [mm]; has a default at patella and heel"
    )
    height_mm: float | None = Field(
        default=None, gt=5, description="height along the limb [mm]; has a default at patella and heel"
    )


class ReliefSettings(Section):
    """A place where the brace stands off the skin, or presses on it."""

    at: str | None = Field(default=None, description="landmark in its middle")
    painted: Path | None = Field(
        default=None, description="or its vertices on the body's skin: list (.txt) or painted mesh (.ply)"
    )
    height_mm: float = Field(
        ge=-15,
        le=30,
        description="how far the brace stands off in the middle [mm]; presses on the skin if negative",
    )
    radius_mm: float = Field(
        default=25.0,
        ge=5,
        le=80,
        description="distance from the landmark, or from paint, where it fades out [mm]",
    )


class DomainSettings(Section):
    """Where the brace sits and how its surface is meshed."""

    joint: Literal["knee", "ankle"] = Field(default="knee", description="braced joint")
    side: Literal["left", "right"] = Field(default="left", description="braced side")
    above: float | None = Field(
        default=None,
        gt=0.1,
        lt=0.8,
        description="upper edge, fraction of the thigh above the knee (0.40 if left out) or of the shank "
        "above the ankle (0.42)",
    )
    below: float | None = Field(
        default=None,
        gt=0.1,
        lt=0.8,
        description="lower edge, fraction of the shank below the knee (0.38 if left out), or of the way from "
        "the ankle to the tips of the toes (0.42)",
    )
    upper_edge: EdgeSettings | None = Field(
        default=None, description="upper edge by a landmark or a plane, instead of domain.above"
    )
    lower_edge: EdgeSettings | None = Field(
        default=None, description="lower edge by a landmark or a plane, instead of domain.below"
    )
    painted: Path | None = Field(
        default=None,
        description="brace by its vertices on the body's skin, instead of edges: list (.txt) or painted mesh "
        "(.ply); unpainted islands are windows",
    )
    windows: tuple[WindowSettings, ...] | None = Field(
        default=None,
        description="holes in the brace, [] for none; if left out, the open heel of an ankle",
    )
    reliefs: tuple[ReliefSettings, ...] = Field(
        default=(), description="places where the brace stands off the skin"
    )
    compression_percent: float = Field(
        default=0.0, ge=0, lt=40, description="how much less than the limb the brace measures around [%]"
    )
    upper_rim_mm: float | None = Field(
        default=None,
        ge=2,
        description="width of the solid band at the upper edge [mm], or pattern.rim_mm",
    )
    lower_rim_mm: float | None = Field(default=None, ge=2, description="the same at the lower edge [mm]")
    window_rim_mm: float | None = Field(default=None, ge=2, description="the same around the windows [mm]")
    triangles: int = Field(default=4000, ge=400, le=60000, description="target number of triangles")
    seam_azimuth_deg: float | None = Field(
        default=None,
        description="seam around the limb: 0 anterior or on the foot's back, 90 lateral, 180 posterior or "
        "under the sole [deg]; 180 at the knee and 0 at the ankle, away from the open heel, if left out",
    )
    flatten: Literal["lscm", "periodic", "slim"] = Field(default="periodic", description="flat map")
    frames_per_second: float = Field(
        default=15.0, gt=0, description="frames of the motion used by the design [1/s]"
    )
