"""Section ``optimize``: what the design strives for, and how."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section

ANGLES = {"knee": ("flexion", "adduction", "rotation"), "ankle": ("dorsiflexion", "inversion")}
"""Angles of each joint that a brace can be asked to preserve or to prevent: sagittal, frontal, axial."""


class LossWeights(Section):
    """Weights of L1..L5 (paper, Sec. 5)."""

    joint_stability: float = Field(default=0.5, ge=0)
    elastic_energy: float = Field(default=0.8, ge=0)
    compliance: float = Field(default=0.6, ge=0)
    volume: float = Field(default=0.3, ge=0)
    seam: float = Field(default=0.02, ge=0)


class OptimizeSettings(Section):
    """The optimizer."""

    seed: int = Field(default=0, description="seed of everything random")
    iterations: int = Field(default=100, ge=1, le=10000, description="iterations")
    learning_rate: float = Field(default=0.3, gt=0, description="step of Adam")
    sigma: float = Field(default=20.0, gt=0, description="sharpness of the Gaussians (paper: 4)")
    volume_fraction: float = Field(default=0.4, gt=0.1, lt=0.65, description="target volume fraction [-]")
    weights: LossWeights = LossWeights()
    p_norm: float = Field(default=20.0, ge=1, description="exponent of the worst-frame norm")
    coupling: Literal["stiffness", "paper"] = Field(
        default="stiffness",
        description="how the brace acts on the joint in the design: by the stiffness between its edges, or "
        "by the reactions to its load as in the paper; the report states both",
    )
    preserve: tuple[str, ...] | None = Field(
        default=None,
        description="angles to keep: flexion, adduction, rotation of a knee, dorsiflexion, inversion of an "
        "ankle; the sagittal one if left out",
    )
    prevent: tuple[str, ...] | None = Field(
        default=None, description="angles to bring to zero, as above; the frontal one if left out"
    )
    geometry: str = Field(
        default="rest",
        pattern="^(rest|frame|clusters:[1-9][0-9]{0,3})$",
        description="shapes in which the frames' loads act: rest, clusters:k for the k that stand best for "
        "all frames, or frame for one each (slow)",
    )
    skin_n_per_mm3: float = Field(
        default=0.0,
        ge=0,
        description="stiffness of the skin that bears the loaded brace from inside [N/mm^3]; 0 is no skin",
    )
    solver: Literal["auto", "pardiso", "scipy", "cholespy"] = Field(
        default="auto", description="library that solves the shell; the fastest installed if auto"
    )
    load_share: float = Field(
        default=0.01, gt=0, le=1, description="share of the acting force that the brace carries [-]"
    )
    load_window_mm: float = Field(
        default=40.0, gt=0, description="width of the load's window about the joint line [mm]"
    )
    passive_frontal_nm_per_deg: float = Field(
        default=5.0, gt=0, description="assumed passive stiffness of the joint, frontal; a knee's"
    )
    passive_sagittal_nm_per_deg: float = Field(
        default=0.5, gt=0, description="assumed passive stiffness of the joint, sagittal; a knee's"
    )
    passive_axial_nm_per_deg: float = Field(
        default=1.5, gt=0, description="assumed passive stiffness of the joint, axial; a knee's"
    )
    muscle_stiffness: Literal["direct", "coupled", "none"] = Field(
        default="direct",
        description="what the muscles' tension adds to the joint's stiffness: about each angle by itself, "
        "also between the angles as muscles of constant activation couple them, or nothing",
    )
    checkpoint_every: int = Field(default=5, ge=1, description="iterations between checkpoints")


def controlled_angles(settings: OptimizeSettings, joint: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the angles that a brace shall preserve and prevent.

    Args:
        settings: The optimizer's settings.
        joint: ``knee`` or ``ankle``.
    """
    sagittal, frontal, *_ = ANGLES[joint]
    preserve = (sagittal,) if settings.preserve is None else settings.preserve
    return preserve, (frontal,) if settings.prevent is None else settings.prevent
