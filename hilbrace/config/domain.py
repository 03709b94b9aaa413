"""Section ``domain``: where the brace sits and how its surface is meshed."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section


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
