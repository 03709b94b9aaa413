"""Section ``motion``: what was recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section


class MotionSettings(Section):
    """What was recorded: a C3D file, or TRC markers with MOT forces, or a built-in synthetic motion."""

    synthetic: Literal["serve", "gait", "squat"] | None = Field(
        default=None, description="built-in synthetic motion"
    )
    markers: Path | None = Field(default=None, description="C3D or TRC file of the motion")
    forces: Path | None = Field(
        default=None, description="MOT, STO or GroundLink (.pth) file of ground reactions; C3D holds its own"
    )
    forces_rate_hz: float | None = Field(
        default=None, gt=0, description="samples per second of a GroundLink file, which does not say it [Hz]"
    )
    static: Path | None = Field(default=None, description="C3D or TRC file of the subject standing still")
    static_forces: Path | None = Field(
        default=None, description="MOT or STO file that weighs the standing subject"
    )
    marker_map: str = Field(default="hilbrace", description="built-in marker map, or the path of a TOML file")
    plates: dict[str, Literal["right", "left", "unused"]] = Field(
        default={},
        description="foot on each force plate, e.g. {1 = 'right'}; found from the markers if empty",
    )
    vertical_axis: Literal["y", "z"] | None = Field(
        default=None, description="up axis of the file; z for C3D, y for TRC"
    )
    window: tuple[float, float] | None = Field(default=None, description="part of the recording to use [s]")
    cutoff_hz: float = Field(
        default=12.0,
        gt=0,
        description="low-pass cut-off for markers' motion and forces alike [Hz]: 6 for gait and squats, 12 "
        "for running and mixed motion, 15 to 20 for landings, whose impact a lower one takes away",
    )
    force_threshold_n: float = Field(
        default=20.0, ge=0, description="vertical force below which a foot is unloaded [N]"
    )
