"""Section ``body``: the skin."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section

Direction = Literal["x", "-x", "y", "-y", "z", "-z"]


class BodySettings(Section):
    """The skin."""

    model: Literal["anny", "skel", "mesh", "scan"] = Field(
        default="anny",
        description="embedded body (anny), the user's own SKEL file (skel), a surface as it is (mesh), or "
        "the body that `hilbrace scan fit` made of a scan (scan)",
    )
    model_file: Path | None = Field(
        default=None,
        description="converted SKEL file (.npz), mesh (.ply, .obj, .stl), or fitted scan (body.npz)",
    )
    gender: Literal["male", "female"] | None = Field(
        default=None, description="gender that the SKEL file must have"
    )
    skinning: Literal["dual_quaternion", "linear"] = Field(
        default="dual_quaternion", description="how the bones' motions are blended on the skin"
    )
    weight_smoothing_mm: float | None = Field(
        default=None,
        ge=0,
        description="diffusion length of the skinning weights [mm]; 40, or what bent knees need, if left out",
    )
    mesh_units: Literal["m", "cm", "mm", "inch"] = Field(default="m", description="unit of the mesh file")
    mesh_up: Direction = Field(default="y", description="axis of the mesh file that points up")
    mesh_forward: Direction = Field(default="z", description="axis of the mesh file that points forward")
    mesh_legs: Literal["both", "left", "right"] = Field(default="both", description="legs that the mesh has")
    landmarks: dict[str, tuple[float, float, float]] = Field(
        default={},
        description="points of the mesh, in its own axes and unit: joint centres (hip_r, knee_r, ankle_r, "
        "hip_l, ...), or a pair on both sides of a joint (knee_r_lateral, knee_r_medial)",
    )
