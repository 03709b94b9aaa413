"""Section ``biomech``: the musculoskeletal model and what is asked of it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from hilbrace.config.section import Section


class BiomechSettings(Section):
    """The musculoskeletal model and the inverse kinematics."""

    model: Path | None = Field(
        default=None, description="your own .osim file; the built-in 41-DoF model if left out"
    )
    convention: Literal["intersegmental", "paper_literal"] = Field(
        default="intersegmental",
        description="acting force of Eq. 1: muscles counted as their pull on the proximal bone (net force "
        "across the joint), or on the distal bone as the formula reads literally",
    )
    muscle_criterion: Literal["activation_and_contact", "activation"] = Field(
        default="activation_and_contact",
        description="what muscle forces minimise: squared activations and squared loads of joint surfaces, "
        "or squared activations alone as OpenSim's static optimisation",
    )
    kneecap: Literal["lever", "pulley"] = Field(
        default="lever",
        description="how the quadriceps' tension reaches the tibia: by the balance of the tibia over the "
        "kneecap, or unchanged as in OpenSim's joint reaction analysis",
    )
    knee_regularisation: float = Field(
        default=0.03,
        ge=0,
        description="inverse-kinematics weight that holds knee adduction and rotation near zero against skin "
        "motion; the default weighs about as much as the markers of a leg, 0 believes the markers; it fades "
        "where the markers fit better than markers on skin",
    )
