"""Section ``domain``: where the brace sits and how its surface is meshed."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section


class DomainSettings(Section):
    """Where the brace sits and how its surface is meshed."""

    joint: Literal["knee"] = Field(default="knee", description="braced joint")
    side: Literal["left", "right"] = Field(default="left", description="braced side")
    above: float = Field(
        default=0.40, gt=0.1, lt=0.8, description="upper edge, fraction of the thigh above the knee"
    )
    below: float = Field(
        default=0.38, gt=0.1, lt=0.8, description="lower edge, fraction of the shank below the knee"
    )
    triangles: int = Field(default=4000, ge=400, le=60000, description="target number of triangles")
    seam_azimuth_deg: float = Field(
        default=180.0, description="seam around the limb: 0 anterior, 180 posterior [deg]"
    )
    flatten: Literal["lscm", "periodic"] = Field(default="periodic", description="flat map")
    frames_per_second: float = Field(
        default=15.0, gt=0, description="frames of the motion used by the design [1/s]"
    )
