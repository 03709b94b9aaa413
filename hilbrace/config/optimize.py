"""Section ``optimize``: what the design strives for, and how."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PositiveInt

from hilbrace.config.section import Section

ANGLES = {"knee": ("flexion", "adduction", "rotation"), "ankle": ("dorsiflexion", "inversion")}
"""Angles of each joint that a brace can be asked to preserve or to prevent: sagittal, frontal, axial."""

ASSUMED_PASSIVE = {"knee": (0.5, 5.0, 1.5), "ankle": (0.4, 0.25, 0.25)}
"""Assumed passive stiffness about the sagittal, frontal and axial angle [N*m/deg]. None was measured on the
subject. A relaxed ankle is weaker in inversion and eversion than in the sagittal plane (Lee et al. 2011, J.
Biomech. 44:1901); the sizes are assumptions."""


class LossWeights(Section):
    """Weights of L1..L5; the paper (Sec. 5) has 0.5, 0.8, 0.6, 0.3, 0.02.

    With the paper's, the energy and the compliance under the acting force outweigh the freedom of the joint:
    they gave a frontal over sagittal stiffness of 4.7 times the uniform brace's where these gave 8.1, the
    joint straight, and 3.0 where these gave 4.6 at 59 deg (left knee of the built-in serve).
    """

    joint_stability: float = Field(default=2.0, ge=0)
    elastic_energy: float = Field(default=0.8, ge=0)
    compliance: float = Field(default=0.1, ge=0)
    volume: float = Field(default=0.6, ge=0)
    seam: float = Field(default=0.02, ge=0)


class OptimizeSettings(Section):
    """The optimizer."""

    seed: int = Field(default=0, description="seed of everything random")
    iterations: int = Field(default=100, ge=1, le=10000, description="iterations")
    learning_rate: float = Field(default=0.3, gt=0, description="step of Adam at the first iteration")
    learning_rate_end: float = Field(
        default=0.1,
        gt=0,
        le=1,
        description="step of the last iteration over that of the first; in between it falls as a cosine",
    )
    gradient_limit: float = Field(
        default=1.0, ge=0, description="largest norm of the gradient, longer ones are shortened; 0 for none"
    )
    gradient_noise: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="random part of the first gradient over its norm, fading to none at the end; 0 is none",
    )
    patience: int = Field(
        default=0,
        ge=0,
        description="iterations that the total loss may go without falling by a thousandth before the design "
        "counts as done; 0 runs all iterations",
    )
    field: Literal["gaussian", "network"] = Field(
        default="gaussian",
        description="how the field is written: the paper's layer of 10,000 Gaussians, or a network of layers",
    )
    sigma: float = Field(default=20.0, gt=0, description="sharpness of the Gaussians (paper: 4)")
    network_layers: tuple[PositiveInt, ...] = Field(
        default=(32, 32), min_length=1, description="neurons in each hidden layer of the network"
    )
    network_waves: int = Field(
        default=6, ge=1, le=40, description="waves along each axis of the map that enter the network"
    )
    volume: Literal["penalised", "exact"] = Field(
        default="penalised",
        description="how the volume fraction is kept: by the loss L4 alone, or exactly in every iteration, "
        "the level of the field being solved for",
    )
    volume_fraction: float = Field(
        default=0.4,
        gt=0.0,
        lt=1.0,
        description="target volume fraction [-]; one that no casting reaches is refused with the range",
    )
    weights: LossWeights = LossWeights()
    p_norm: float = Field(default=20.0, ge=1, description="exponent of the worst-frame norm")
    p_norm_start: float | None = Field(
        default=None,
        ge=1,
        description="exponent at the first iteration, rising evenly in logarithms; p_norm if left out",
    )
    sharpness_end: float = Field(
        default=1.0,
        gt=0,
        le=100,
        description="slope of the projection at the last iteration over that at the first, rising evenly in "
        "logarithms; large ones leave little between thin and thick struts",
    )
    segmentation_every: int = Field(
        default=0,
        ge=0,
        description="iterations between two segmentations by the energy of the present moduli, as in the "
        "paper; 0 segments once, by the energy for one modulus everywhere",
    )
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
    support_until_deg: float = Field(
        default=75.0,
        ge=0,
        description="flexion up to which the brace shall hold the angles to bring to zero as firmly as a "
        "uniform brace of the same volume [deg]",
    )
    support_beyond: float = Field(
        default=0.7, ge=0, le=1, description="share of that firmness that is enough past this flexion [-]"
    )
    geometry: str = Field(
        default="rest",
        pattern="^(rest|frame|clusters:[1-9][0-9]{0,3})$",
        description="shapes in which the frames' loads act: rest, clusters:k for the k that stand best for "
        "all frames, or frame for one each (slow; 10,000 triangles and 300 frames need 5 GB)",
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
    passive_frontal_nm_per_deg: float | None = Field(
        default=None, gt=0, description="assumed passive stiffness of the joint, frontal; 5 of a knee"
    )
    passive_sagittal_nm_per_deg: float | None = Field(
        default=None, gt=0, description="assumed passive stiffness of the joint, sagittal; 0.5 of a knee"
    )
    passive_axial_nm_per_deg: float | None = Field(
        default=None, gt=0, description="assumed passive stiffness of the joint, axial; 1.5 of a knee"
    )
    muscle_stiffness: Literal["direct", "coupled", "none"] = Field(
        default="direct",
        description="what the muscles' tension adds to the joint's stiffness: about each angle by itself, "
        "also between the angles as muscles of constant activation couple them, or nothing",
    )
    checkpoint_every: int = Field(default=5, ge=1, description="iterations between checkpoints")
    snapshots: int = Field(
        default=30, ge=0, le=400, description="pictures of the evolving field in its film; 0 for no film"
    )


def controlled_angles(settings: OptimizeSettings, joint: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the angles that a brace shall preserve and prevent.

    Args:
        settings: The optimizer's settings.
        joint: ``knee`` or ``ankle``.
    """
    sagittal, frontal, *_ = ANGLES[joint]
    preserve = (sagittal,) if settings.preserve is None else settings.preserve
    return preserve, (frontal,) if settings.prevent is None else settings.prevent


def passive_stiffness(settings: OptimizeSettings, joint: str) -> tuple[float, float, float]:
    """Assumed passive stiffness about the sagittal, frontal and axial angle [N*m/deg].

    Args:
        settings: The optimizer's settings; what they leave out is assumed.
        joint: ``knee`` or ``ankle``.
    """
    sagittal, frontal, axial = ASSUMED_PASSIVE[joint]
    return (
        settings.passive_sagittal_nm_per_deg or sagittal,
        settings.passive_frontal_nm_per_deg or frontal,
        settings.passive_axial_nm_per_deg or axial,
    )
