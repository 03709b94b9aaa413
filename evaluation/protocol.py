"""The marker protocol: which markers sit where, and how angles come from them.

The paper's protocol has 13 markers on one leg: a cluster of four on the thigh, one of four on the shank, and
five that calibrate them while standing: the hip, and the lateral and medial knee and ankle.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from evaluation.conventions import Side
from hilbrace.config import Section

HipModel = Literal["marker", "trochanter", "body", "bell", "harrington", "offset"]


class MarkerLabels(Section):
    """Labels of the markers, without the subject's prefix."""

    thigh: tuple[str, ...] = Field(
        default=("TH1", "TH2", "TH3", "TH4"), min_length=3, description="cluster on the thigh"
    )
    shank: tuple[str, ...] = Field(
        default=("SH1", "SH2", "SH3", "SH4"), min_length=3, description="cluster on the shank"
    )
    hip: str | None = Field(default="HIP", description="marker at the hip; only some hip models need it")
    knee_lateral: str = Field(default="KNL", description="lateral epicondyle")
    knee_medial: str = Field(default="KNM", description="medial epicondyle")
    ankle_lateral: str = Field(default="ANL", description="lateral malleolus")
    ankle_medial: str = Field(default="ANM", description="medial malleolus")
    foot: tuple[str, ...] = Field(
        default=(), description="three or more markers that track the foot; ankle angles need them"
    )
    heel: str | None = Field(default=None, description="heel, for the foot's direction while standing")
    toe: str | None = Field(default=None, description="toe, for the foot's direction while standing")
    left_asis: str | None = Field(default=None, description="left anterior superior iliac spine")
    right_asis: str | None = Field(default=None, description="right anterior superior iliac spine")
    left_psis: str | None = Field(default=None, description="left posterior superior iliac spine")
    right_psis: str | None = Field(default=None, description="right posterior superior iliac spine")


class HipSettings(Section):
    """Where the hip joint centre is; the paper does not say, so it has to be chosen."""

    model: HipModel = Field(
        description="marker: the hip marker itself; trochanter: medially of it by a quarter of the distance "
        "between the trochanters; body: medially of it as far as the centre lies under the skin of a fitted "
        "body; bell, harrington: regressions on the pelvis markers; offset: a stated vector from the marker"
    )
    trochanter_width_m: float | None = Field(
        default=None, gt=0.15, lt=0.6, description="distance between the greater trochanters [m]"
    )
    body: Path | None = Field(default=None, description="body record of a run (body/body.npz)")
    marker_radius_m: float = Field(
        default=0.007, ge=0, lt=0.03, description="height of the marker's centre above the skin [m]"
    )
    offset_m: tuple[float, float, float] | None = Field(
        default=None, description="from the hip marker to the centre: anterior, up, medial [m]"
    )


class Processing(Section):
    """From marker paths to angles."""

    cutoff_hz: float = Field(
        default=6.0,
        ge=0,
        description="cut-off of the zero-lag low-pass filter of the markers [Hz]; 0 leaves them unfiltered",
    )
    longest_gap_s: float = Field(
        default=0.05, ge=0, le=0.5, description="longest gap that a spline may fill [s]"
    )
    shank_axis: Literal["ankle", "knee", "both"] = Field(
        default="ankle",
        description="flexion axis of the shank: the malleoli, the epicondyles, or the plane nearest to all",
    )
    cross_talk: bool = Field(
        default=False,
        description="turn the thigh's frame about its long axis, once for all conditions, so that the "
        "frontal angle varies least; needs a calibration movement",
    )


class Protocol(Section):
    """Everything that turns markers into angles; the same for all trials of a study."""

    side: Side = Field(description="which leg is measured")
    markers: MarkerLabels = Field(default_factory=MarkerLabels, description="labels")
    hip: HipSettings = Field(description="hip joint centre")
    processing: Processing = Field(default_factory=Processing, description="filter, gaps, axes")
    vertical_axis: Literal["y", "z"] | None = Field(
        default=None, description="up axis of the files; z for C3D, y for TRC"
    )
