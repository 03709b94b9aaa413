"""The ablation of a design: the same task without a loss, at other volumes, and against a uniform brace.

The paper's figure of the ablation and its findings (Sec. 7.1): without the elastic energy L2 the brace
hinders the bend more, without the compliance L3 it holds the frontal plane less.

Every variant is a run folder of its own that shares the stages before the optimizer; so it goes on from its
checkpoint after an interruption, and `hilbrace run` on it makes the solid.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from rich.console import Console

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.config import Config, OptimizeSettings
from hilbrace.domain.domain import Domain
from hilbrace.errors import SolverError
from hilbrace.optimize.ablation import DESIGN, UNIFORM, AblationRow, BraceFigures
from hilbrace.optimize.design import LOSSES, Design
from hilbrace.optimize.problem import build_problem
from hilbrace.optimize.uniform_outcome import UniformOutcome, uniform_outcome
from hilbrace.pipeline.runner import run_stages
from hilbrace.report.ablation import Ablation, AblationField, write_ablation
from hilbrace.run.folder import locked
from hilbrace.run.records import load
from hilbrace.run.reuse import reuse_stages

SHARED = ("motion", "body", "biomech", "domain")
"""Stages that no variant changes."""

VOLUMES = (0.3, 0.5, 0.7)
"""Volume fractions of the paper's figure [-]."""

BENT_DEG = 60.0
"""The bent posture that the table tells: the one nearest to this flexion [deg]."""


@dataclass(frozen=True)
class Variant:
    """One design of the ablation.

    Attributes:
        name: Its folder.
        label: How people call it.
        settings: The optimizer's settings.
    """

    name: str
    label: str
    settings: OptimizeSettings


def variants(settings: OptimizeSettings) -> tuple[Variant, ...]:
    """The design itself, without L2, without L3, and with the volumes of the paper's figure.

    Args:
        settings: The optimizer's settings of the design; a volume that it has already is not repeated.
    """
    own = settings.volume_fraction
    found = [Variant(DESIGN, f"design (volume {own:g})", settings)]
    for key, label in (("elastic_energy", "without L2"), ("compliance", "without L3")):
        weights = settings.weights.model_copy(update={key: 0.0})
        found.append(Variant(f"without_{key}", label, settings.model_copy(update={"weights": weights})))
    for volume in VOLUMES:
        if abs(volume - own) > 1e-9:
            name = f"volume_{100 * volume:.0f}_percent"
            changed = settings.model_copy(update={"volume_fraction": volume})
            found.append(Variant(name, f"volume {volume:g}", changed))
    return tuple(found)


def run_ablation(config: Config, source: Path | None, out: Path, quiet: bool = False) -> Ablation:
    """Run all variants, and write the table, the picture and the page.

    Finished variants are left alone and interrupted ones go on from their checkpoints.

    Args:
        config: Configuration of the design.
        source: Run folder whose finished stages are taken over; ``None`` for none.
        out: Folder of the ablation; every variant has its folder in it.
        quiet: Show no progress.

    Returns:
        The rows of the table, the fields and the verdict on the paper's findings.

    Raises:
        BusyError: Another process works in one of the folders.
        HilbraceError: A stage before the variants, or the design itself, fails.
    """
    console = Console(stderr=True, quiet=quiet)
    rows: list[AblationRow] = []
    fields: list[AblationField] = []
    with locked(out):
        planned = variants(config.optimize)
        for place, variant in enumerate(planned, start=1):
            console.print(f"[bold]{variant.label}[/bold] ({place} of {len(planned)})")
            made = _run_variant(config, variant, source, out, quiet)
            rows.append(made)
            fields.append(AblationField(variant.label, _field(out / variant.name) if made.figures else None))
        uniform_row, uniform_field = _uniform(config, out / DESIGN)
        domain = load(Domain, out / DESIGN / "domain" / "domain.npz")
        ablation = Ablation(
            config.subject.name,
            f"{config.domain.side} {config.domain.joint}",
            config.preset,
            config.optimize,
            (*rows, uniform_row),
            (*fields, uniform_field),
        )
        write_ablation(ablation, domain, out)
    return ablation


def _run_variant(
    config: Config, variant: Variant, source: Path | None, out: Path, quiet: bool
) -> AblationRow:
    """A variant's row, which says why where there is no such brace. The design itself must succeed."""
    folder = out / variant.name
    if variant.name != DESIGN:
        reuse_stages(out / DESIGN, folder, SHARED)
    elif source is not None:
        reuse_stages(source, folder, (*SHARED, "optimize"))
    changed = config.model_copy(update={"optimize": variant.settings})
    try:
        metrics = run_stages(changed, folder, until="optimize", quiet=quiet)
    except SolverError as fault:
        if variant.name == DESIGN:
            raise
        return AblationRow(variant.name, variant.label, None, f"{fault.what}; {fault.where}")
    return AblationRow(variant.name, variant.label, _figures(metrics))


def _field(folder: Path) -> Float[np.ndarray, " triangle"]:
    return load(Design, folder / "optimize" / "optimize.npz").d_triangle


def _figures(metrics: dict[str, Any]) -> BraceFigures:
    brace, steps = metrics["brace"], metrics["optimize"]
    bent = min(brace["postures"], key=lambda posture: abs(posture["flexion_deg"] - BENT_DEG))
    frontal, sagittal = bent["frontal_nm_per_deg"], bent["sagittal_nm_per_deg"]
    plain = bent["frontal_uniform_nm_per_deg"] / bent["sagittal_uniform_nm_per_deg"]
    return BraceFigures(
        losses=tuple(float(steps["losses_final"][name]) for name in LOSSES),
        frontal_nm_per_deg=brace["stiffness_frontal_nm_per_deg"],
        sagittal_nm_per_deg=brace["stiffness_sagittal_nm_per_deg"],
        ratio_vs_uniform=brace["stiffness_ratio_vs_uniform"],
        bent_deg=bent["flexion_deg"],
        bent_frontal_nm_per_deg=frontal,
        bent_sagittal_nm_per_deg=sagittal,
        bent_ratio_vs_uniform=frontal / sagittal / plain,
        frontal_change_deg=brace["predicted_frontal_change_max_deg"],
        sagittal_change_deg=brace["predicted_sagittal_change_max_deg"],
        volume_fraction=brace["volume_fraction"],
    )


def _uniform(config: Config, folder: Path) -> tuple[AblationRow, AblationField]:
    """The uniform firm brace of the design's volume."""
    loads = load(JointLoads, folder / "biomech" / "biomech.npz")
    domain = load(Domain, folder / "domain" / "domain.npz")
    design = load(Design, folder / "optimize" / "optimize.npz")
    problem = build_problem(loads, domain, config.optimize, config.material, config.pattern)
    outcome = uniform_outcome(problem, loads, design.volume_fraction)
    label = "uniform firm"
    field = AblationField(label, np.full(len(design.d_triangle), outcome.d))
    return AblationRow(UNIFORM, label, _uniform_figures(design, outcome)), field


def _uniform_figures(design: Design, outcome: UniformOutcome) -> BraceFigures:
    flexions = np.rad2deg(design.stiffness_flexions)
    bent = int(np.abs(flexions - BENT_DEG).argmin())
    sagittal, frontal, _ = map(float, design.stiffness_uniform)
    bent_sagittal, bent_frontal, _ = map(float, design.stiffness_posed_uniform[bent])
    change = np.rad2deg(np.abs(outcome.angle_change).max(axis=0))
    return BraceFigures(
        losses=tuple(map(float, outcome.losses)),
        frontal_nm_per_deg=frontal,
        sagittal_nm_per_deg=sagittal,
        ratio_vs_uniform=1.0,
        bent_deg=float(flexions[bent]),
        bent_frontal_nm_per_deg=bent_frontal,
        bent_sagittal_nm_per_deg=bent_sagittal,
        bent_ratio_vs_uniform=1.0,
        frontal_change_deg=float(change[1]),
        sagittal_change_deg=float(change[0]),
        volume_fraction=outcome.volume_fraction,
    )
