"""What an ablation found: one row per variant, and whether the paper's findings came out.

The paper (Sec. 7.1 and the figure of the ablation): without the elastic energy L2 the brace gains connections
that hinder the bend, without the compliance L3 it loses those that hold the frontal plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hilbrace.config import OptimizeSettings

DESIGN, WITHOUT_L2, WITHOUT_L3, UNIFORM = "design", "without_elastic_energy", "without_compliance", "uniform"
"""Names of the variants that the findings compare."""

NOTICEABLE = 0.02
"""Relative change of a stiffness that counts as a change [-]."""


@dataclass(frozen=True)
class BraceFigures:
    """What a brace of the ablation is and does.

    Attributes:
        losses: L1 [rad^2], L2 [MPa], L3 [N*mm], L4 [-], L5 [-], not normalised and without weights.
        frontal_nm_per_deg: Stiffness in the frontal plane, straight joint [N*m/deg].
        sagittal_nm_per_deg: Stiffness in the sagittal plane, straight joint [N*m/deg].
        ratio_vs_uniform: Frontal over sagittal against the uniform brace of the same volume [-].
        bent_deg: The posture nearest to 60 degrees of flexion [deg].
        bent_frontal_nm_per_deg: Stiffness in the frontal plane in that posture [N*m/deg].
        bent_sagittal_nm_per_deg: The same in the sagittal plane [N*m/deg].
        bent_ratio_vs_uniform: The ratio against the uniform brace in that posture [-].
        frontal_change_deg: Largest predicted change of the frontal angle over the motion [deg].
        sagittal_change_deg: The same of the sagittal angle [deg].
        volume_fraction: Mean volume fraction, rims included [-].
    """

    losses: tuple[float, ...]
    frontal_nm_per_deg: float
    sagittal_nm_per_deg: float
    ratio_vs_uniform: float
    bent_deg: float
    bent_frontal_nm_per_deg: float
    bent_sagittal_nm_per_deg: float
    bent_ratio_vs_uniform: float
    frontal_change_deg: float
    sagittal_change_deg: float
    volume_fraction: float


@dataclass(frozen=True)
class AblationRow:
    """One variant.

    Attributes:
        name: Its folder.
        label: How people call it.
        figures: What came out; ``None`` where there is no such brace.
        reason: Why there is none.
    """

    name: str
    label: str
    figures: BraceFigures | None
    reason: str = ""


@dataclass(frozen=True)
class Finding:
    """One of the paper's findings beside what came out here.

    Attributes:
        claim: What the paper found.
        came_out: Whether it came out; ``None`` where a variant that it compares is missing.
        sentence: What came out, in words and figures.
        why: Why it did not, as far as the settings tell.
    """

    claim: str
    came_out: bool | None
    sentence: str
    why: str = ""


def findings(rows: Sequence[AblationRow], settings: OptimizeSettings) -> tuple[Finding, ...]:
    """The paper's findings on its losses, each with the verdict.

    Args:
        rows: The variants' rows.
        settings: The optimizer's settings of the design.
    """
    less_free = "hinders the bend more: the stiffness in the sagittal plane rises."
    return (
        _finding(rows, settings, WITHOUT_L2, f"Without L2 the brace {less_free}", "sagittal", 1.0),
        _finding(
            rows, settings, WITHOUT_L3,
            "Without L3 the brace supports less: the stiffness in the frontal plane falls.", "frontal", -1.0,
        ),
        _finding(
            rows, settings, UNIFORM, f"A uniform firm brace of the same volume {less_free}", "sagittal", 1.0
        ),
    )  # fmt: skip


def _finding(
    rows: Sequence[AblationRow],
    settings: OptimizeSettings,
    name: str,
    claim: str,
    plane: str,
    sign: float,
) -> Finding:
    by_name = {row.name: row for row in rows}
    design, other = by_name[DESIGN].figures, by_name[name].figures
    if design is None or other is None:
        return Finding(claim, None, f"Not known: {by_name[name].reason or by_name[DESIGN].reason}.")
    change = _of(other, plane) / _of(design, plane) - 1.0
    bent = _of(other, f"bent_{plane}") / _of(design, f"bent_{plane}") - 1.0
    sentence = (
        f"{plane.capitalize()} stiffness of '{by_name[name].label}' against the design: {_signed(change)} "
        f"with the joint straight, {_signed(bent)} at {other.bent_deg:.0f} degrees."
    )
    came_out = sign * change > NOTICEABLE
    return Finding(claim, came_out, sentence, "" if came_out else _why(name, settings))


def _why(name: str, settings: OptimizeSettings) -> str:
    """Why a finding did not come out, as far as the settings tell."""
    weights = settings.weights
    weight = {WITHOUT_L2: weights.elastic_energy, WITHOUT_L3: weights.compliance}.get(name)
    if weight == 0.0:
        return "The design itself has no such loss."
    if name == WITHOUT_L3 and settings.segmentation_every and settings.coupling == "paper":
        return (
            f"The design is segmented anew every {settings.segmentation_every} iterations by the energy of "
            "its present moduli, as the paper's W_e has them. The firm cells store more energy for being "
            "firm and are called soft at the next time, and the firm maps of two variants drift apart by "
            "more than L3 moves. Segmented once (optimize.segmentation_every = 0) the finding came out on a "
            "coarse mesh of the built-in serve: the frontal stiffness fell by 41 % without L3, and the "
            "sagittal one rose by 64 % without L2."
        )
    if weight is None or settings.coupling != "stiffness":
        return "The settings do not tell why; section 3 of the report shows which loss pulls where."
    if name == WITHOUT_L3:
        return (
            "In the coupling 'stiffness' L1 itself does not let the frontal stiffness fall below the uniform "
            f"brace's, with a weight of {weights.joint_stability:g} against L3's {weight:g}: the design "
            "rests on that floor, with L3 and without. In the paper's coupling L1 does not feel the "
            "stiffness, and L3 alone asks for support (hilbrace ablate --preset paper)."
        )
    return (
        "In the coupling 'stiffness' L1 itself frees the bend, with a weight of "
        f"{weights.joint_stability:g} against L2's {weight:g}: L2 has little left to free. In the paper's "
        "coupling L1 does not feel the stiffness (hilbrace ablate --preset paper)."
    )


def _of(figures: BraceFigures, plane: str) -> float:
    return getattr(figures, f"{plane}_nm_per_deg")


def _signed(change: float) -> str:
    return f"{100.0 * change:+.0f} %" if abs(change) < 10.0 else f"{change + 1.0:.0f} times"
