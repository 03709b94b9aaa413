"""The stages in order, and what each reads, writes and reports."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.analysis import compute_joint_loads
from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.biomech.loads_csv import write_joint_loads_csv
from hilbrace.biomech.marker_report import load_bearing, write_marker_errors_csv
from hilbrace.biomech.muscle_tables import write_muscle_tables
from hilbrace.biomech.muscles import MOVED
from hilbrace.body.body import Body
from hilbrace.body.build import build_body
from hilbrace.config import Config, departures
from hilbrace.domain.animation import write_animation
from hilbrace.domain.build import build_domain
from hilbrace.domain.distortion import advice, map_distortion
from hilbrace.domain.domain import Domain
from hilbrace.domain.frame_report import report_frames, write_frame_report
from hilbrace.errors import ConfigError
from hilbrace.motion.marker_maps import read_marker_map
from hilbrace.motion.synthetic import generate, write_recording
from hilbrace.motion.trial import Trial
from hilbrace.motion.trial_reader import read_trial
from hilbrace.optimize.build import optimize_design
from hilbrace.optimize.design import LOSSES, Design
from hilbrace.optimize.film import write_film, write_film_glb
from hilbrace.optimize.flexion_moment import moment_figures
from hilbrace.optimize.history import told, write_history_csv, write_history_picture
from hilbrace.optimize.predictions import prediction_figures
from hilbrace.pattern.build import build_pattern, build_solid
from hilbrace.pattern.export import write_surface
from hilbrace.pattern.pattern import Pattern, Solid
from hilbrace.pipeline.stage import Inputs, Outcome, Stage
from hilbrace.report.build import build_report
from hilbrace.units import GRAVITY, MM_PER_M

SYNTHETIC_RATE_HZ = 100.0


def motion(inputs: Inputs) -> Outcome:
    """Read the recording; the synthetic subject's is written first and goes through the same readers."""
    settings = inputs.config.motion
    files = ()
    if settings.synthetic:
        made = generate(settings.synthetic, rate_hz=SYNTHETIC_RATE_HZ)
        paths = write_recording(made, inputs.folder / "recording")
        files = tuple(paths.values())
        source = {"markers": paths["c3d"], "static": paths["static_c3d"], "marker_map": "hilbrace"}
        subject = inputs.config.subject
        if subject.height_m is None:
            subject = subject.model_copy(update={"height_m": made.height_m})
        trial = read_trial(settings.model_copy(update=source), subject)
        trial = replace(trial, name=f"synthetic {settings.synthetic}", origin="synthetic")
    elif settings.markers is None:
        raise ConfigError(
            "no motion is named",
            where="motion",
            hint="set motion.markers to a C3D or TRC file, or motion.synthetic",
        )
    else:
        trial = read_trial(settings, inputs.config.subject)
    force = np.linalg.norm(trial.ground_force.sum(axis=1), axis=1)
    figures = {
        "name": trial.name,
        "origin": trial.origin,
        "frames": len(trial.time),
        "rate_hz": trial.rate_hz,
        "markers": len(trial.marker_names),
        "subject_mass_kg": round(trial.mass_kg, 3),
        "ground_force_peak_bw": _rounded(force.max() / (trial.mass_kg * GRAVITY)),
        "hidden_marker_samples": int(np.isnan(trial.markers[..., 0]).sum()),
        "notes": list(trial.notes),
    }
    return Outcome(trial, files, {"motion": figures})


def body(inputs: Inputs) -> Outcome:
    """Fit the skin to the subject's figures."""
    record = build_body(inputs.records["motion"], inputs.config.body)
    skin = inputs.folder / "skin.ply"
    write_surface(skin, record.vertices, record.triangles)
    figures = {
        "model": record.model,
        "height_m": _rounded(record.height_m),
        "joint_fit_error_mm": _rounded(record.fit_error_mm.max()),
        "height_error_mm": _rounded(record.height_error_mm),
    }
    return Outcome(record, (skin,), {"body": figures})


def biomech(inputs: Inputs) -> Outcome:
    """Inverse kinematics and net joint loads, OpenSim in its worker process."""
    trial: Trial = inputs.records["motion"]
    loads = compute_joint_loads(
        trial,
        inputs.records["body"],
        read_marker_map(trial.marker_map),
        inputs.config.motion,
        inputs.config.biomech,
        inputs.progress,
    )
    table = inputs.folder / "joint_loads.csv"
    write_joint_loads_csv(loads, table)
    about, errors = table.with_suffix(".json"), inputs.folder / "marker_errors.csv"
    write_marker_errors_csv(loads.time, loads.marker_names, loads.marker_error, errors)
    files = (table, about, errors, *write_muscle_tables(loads, inputs.folder))
    return Outcome(loads, files, {"biomech": _load_figures(loads, braced_joint(inputs))})


def domain(inputs: Inputs) -> Outcome:
    """Cut the brace's surface out of the skin, mesh it, flatten it and move it."""
    record = build_domain(inputs.records["body"], inputs.records["biomech"], inputs.config.domain)
    surface = inputs.folder / "domain.ply"
    write_surface(surface, record.vertices, record.triangles)
    distortion = map_distortion(record)
    frames = report_frames(record.vertices, record.posed, record.triangles, record.deformation, record.time)
    table, moving = inputs.folder / "frames.csv", inputs.folder / "motion.glb"
    write_frame_report(frames, table)
    write_animation(moving, record.vertices, record.triangles, record.posed, record.time)
    figures = {
        "joint": record.joint,
        "triangles": len(record.triangles),
        **distortion.figures(),
        "frames": len(record.time),
        "area_ratio_min": _rounded(np.linalg.det(record.deformation).min()),
        "area_ratio_max": _rounded(np.linalg.det(record.deformation).max()),
        **frames.figures(),
        "notes": list(advice(distortion, record.flatten)),
    }
    return Outcome(record, (surface, table, moving), {"domain": figures})


def optimize(inputs: Inputs) -> Outcome:
    """Find the distribution of the microstructures."""
    config = inputs.config
    design, seconds = optimize_design(
        inputs.records["biomech"],
        inputs.records["domain"],
        config.optimize,
        config.material,
        config.pattern,
        checkpoint=inputs.folder / "checkpoint.npz",
        key=inputs.key,
        watches=(lambda now: inputs.progress(now.iteration, now.iterations, told(now)),),
    )
    table = inputs.folder / "history.csv"
    write_history_csv(design, table)
    course = inputs.folder / "history.png"
    write_history_picture(design, course)
    films = _films(inputs, design)
    figures = _design_figures(design, seconds)
    figures["optimize"] |= _course_figures(config, design)
    figures["brace"] |= prediction_figures(design, inputs.records["biomech"], inputs.records["domain"])
    figures["brace"] |= moment_figures(design)
    return Outcome(design, (table, course, *films), figures)


def _course_figures(config: Config, design: Design) -> dict[str, object]:
    """What the design was asked for beyond its losses, and how its loop ended."""
    out_of_patience = design.iterations < config.optimize.iterations
    return {
        "preset": config.preset,
        "preset_departures": list(departures(config.preset, config)),
        "field": config.optimize.field,
        "volume": config.optimize.volume,
        "ended": "patience" if out_of_patience else "iterations",
        "snapshots": len(design.film),
    }


def _films(inputs: Inputs, design: Design) -> tuple[Path, ...]:
    """The evolving field as a film to look at and one to turn; none where no snapshots were kept."""
    if not len(design.film):
        return ()
    flat, turnable = inputs.folder / "film.gif", inputs.folder / "film.glb"
    write_film(inputs.records["domain"], design, flat)
    write_film_glb(inputs.records["domain"], design, turnable)
    return flat, turnable


def pattern(inputs: Inputs) -> Outcome:
    """Draw the struts on the skin."""
    config = inputs.config
    record = build_pattern(
        inputs.records["domain"], inputs.records["optimize"], config.pattern, config.material
    )
    surface = inputs.folder / "pattern.ply"
    write_surface(surface, record.vertices, record.triangles, record.fields)
    figures = {
        "triangles": len(record.triangles),
        "area_fraction": _rounded(record.area_fraction),
        "level_shift": _rounded(record.level_shift),
        "islands_dropped": record.islands_dropped,
        "min_strut_mm": _rounded(record.strut_width_min_mm),
        "median_strut_mm": _rounded(record.strut_width_median_mm),
        "min_slit_mm": _rounded(record.slit_width_min_mm),
    }
    return Outcome(record, (surface,), {"pattern": figures})


def solid(inputs: Inputs) -> Outcome:
    """Thicken the struts into one closed body."""
    config, drawn = inputs.config, inputs.records["pattern"]
    record = build_solid(
        drawn, inputs.records["domain"], inputs.records["optimize"], config.material, config.solid
    )
    files = tuple(inputs.folder / f"brace.{kind}" for kind in ("stl", "ply", "glb"))
    for path in files:
        write_surface(path, record.vertices, record.triangles, record.fields)
    figures = {
        "volume_ml": _rounded(record.volume_mm3 / 1000.0),
        "mass_g": _rounded(record.mass_g),
        "watertight": record.watertight,
        "parts": record.parts,
        "manifold_status": record.manifold_status,
        "genus": record.genus,
        "triangles": len(record.triangles),
        "min_strut_mm": _rounded(drawn.strut_width_min_mm),
        "expected_volume_ml": _rounded(record.expected_volume_mm3 / 1000.0),
        "volume_error": _rounded(record.volume_mm3 / record.expected_volume_mm3 - 1.0),
        "thickness_p01_mm": _rounded(record.thickness_p01_mm),
        "thickness_min_mm": _rounded(record.thickness_min_mm),
        "folded_triangles": record.folded_triangles,
    }
    return Outcome(record, files, {"solid": figures})


def report(inputs: Inputs) -> Outcome:
    """Draw the pictures and write the page."""
    files = build_report(inputs.folder, inputs.config, inputs.records, inputs.metrics)
    return Outcome(None, tuple(files))


def braced_joint(inputs: Inputs) -> str:
    """Name of the braced joint, as in `JointLoads.joints`."""
    settings = inputs.config.domain
    return f"{settings.joint}_{settings.side[0]}"


def _load_figures(loads: JointLoads, joint: str) -> dict[str, object]:
    index = loads.joints.index(joint)
    weight = loads.body_mass_kg * GRAVITY
    error = loads.marker_error[np.isfinite(loads.marker_error)]
    legs = load_bearing(loads.marker_names, loads.marker_bodies, loads.marker_error)
    knee = loads.joints.index(f"knee_{joint[-1]}")
    flexion, adduction, rotation = np.rad2deg(loads.angles[:, knee]).T
    return {
        "coordinates": len(loads.coordinate_names),
        "muscles": loads.muscles,
        "marker_rms_mm": _rounded(MM_PER_M * np.sqrt((error**2).mean())),
        "marker_max_mm": _rounded(MM_PER_M * error.max()),
        "marker_legs_rms_mm": _rounded(MM_PER_M * legs.rms),
        "marker_legs_max_mm": _rounded(MM_PER_M * legs.largest),
        "joint": joint,
        "joint_sagittal_range_deg": _range(np.rad2deg(loads.angles[:, index, 0])),
        "joint_frontal_range_deg": _range(np.rad2deg(loads.angles[:, index, 1])),
        "knee_flexion_max_deg": _rounded(flexion.max()),
        "knee_adduction_range_deg": _range(adduction),
        "knee_rotation_range_deg": _range(rotation),
        "acting_force_peak_bw": _rounded(np.linalg.norm(loads.acting_force[:, index], axis=1).max() / weight),
        **_muscle_figures(loads, joint),
        "pelvis_residual_rms_n": _rounded(np.sqrt((loads.pelvis_residual_force**2).sum(1).mean())),
        **{name: _rounded(value) for name, value in loads.residuals.items()},
        "cutoff_hz": loads.cutoff_hz,
        "notes": list(loads.notes),
    }


def _muscle_figures(loads: JointLoads, joint: str) -> dict[str, object]:
    """Peaks of contact and muscles; ``None`` where the model has no muscles."""
    weight = loads.body_mass_kg * GRAVITY
    peaks = np.linalg.norm(loads.contact_force, axis=2).max(axis=0) / weight
    known = {
        name: _rounded(peak) for name, peak in zip(loads.joints, peaks, strict=True) if np.isfinite(peak)
    }
    asked = [k for k, name in enumerate(loads.coordinate_names) if name[:-2] in MOVED]
    rest = loads.reserve[:, asked]
    return {
        "contact_force_peak_bw": known.get(joint),
        "contact_force_peaks_bw": known,
        "muscle_activation_max": _rounded(loads.muscle_activation.max()) if loads.muscle_names else None,
        "muscle_reserve_rms_nm": _rounded(np.sqrt((rest**2).mean())) if loads.muscle_names else None,
        "muscle_reserve_max_nm": _rounded(np.abs(rest).max()) if loads.muscle_names else None,
    }


def _design_figures(design: Design, seconds: float) -> dict[str, dict[str, object]]:
    names = (*LOSSES, "total")
    brace = dict(zip(("sagittal", "frontal", "axial"), design.stiffness, strict=True))
    uniform = dict(zip(("sagittal", "frontal", "axial"), design.stiffness_uniform, strict=True))
    ratio = (brace["frontal"] / brace["sagittal"]) / (uniform["frontal"] / uniform["sagittal"])
    figures: dict[str, object] = {}
    for plane in ("frontal", "sagittal", "axial"):
        figures[f"stiffness_{plane}_nm_per_deg"] = float(f"{brace[plane]:.6g}")
        figures[f"stiffness_{plane}_uniform_nm_per_deg"] = float(f"{uniform[plane]:.6g}")
    figures["stiffness_ratio_vs_uniform"] = _rounded(ratio)
    figures["postures"] = [
        {
            "flexion_deg": _rounded(np.rad2deg(flexion)),
            "frontal_nm_per_deg": float(f"{own[1]:.6g}"),
            "sagittal_nm_per_deg": float(f"{own[0]:.6g}"),
            "frontal_uniform_nm_per_deg": float(f"{plain[1]:.6g}"),
            "sagittal_uniform_nm_per_deg": float(f"{plain[0]:.6g}"),
        }
        for flexion, own, plain in zip(
            design.stiffness_flexions, design.stiffness_posed, design.stiffness_posed_uniform, strict=True
        )
    ]
    figures["volume_fraction"] = _rounded(design.volume_fraction)
    figures["volume_fraction_uniform"] = _rounded(design.volume_fraction_uniform)
    change = np.rad2deg(np.abs(design.angle_change).max(axis=0))
    figures["predicted_frontal_change_max_deg"] = float(f"{change[1]:.4g}")
    figures["predicted_sagittal_change_max_deg"] = float(f"{change[0]:.4g}")
    steps = {
        "iterations": design.iterations,
        "seconds_per_iteration": round(seconds, 4),
        "shell_solver": design.solver,
        "shell_shapes": design.shapes,
        "losses_initial": dict(zip(LOSSES, map(float, design.losses_initial), strict=True)),
        "losses_final": dict(zip(LOSSES, map(float, design.losses_final), strict=True)),
        "normalised_initial": dict(zip(names, map(float, design.history[0]), strict=True)),
        "normalised_final": dict(zip(names, map(float, design.history[-1]), strict=True)),
    }
    return {"optimize": steps, "brace": figures}


def _range(values: Float[np.ndarray, " frame"]) -> list[float]:
    return [_rounded(values.min()), _rounded(values.max())]


def _rounded(value: float) -> float:
    return round(float(value), 4)


STAGES: tuple[Stage, ...] = (
    Stage("motion", (), ("motion", "subject"), Trial, motion),
    Stage("body", ("motion",), ("body",), Body, body),
    Stage("biomech", ("motion", "body"), ("biomech", "motion"), JointLoads, biomech),
    Stage("domain", ("body", "biomech"), ("domain",), Domain, domain),
    Stage("optimize", ("biomech", "domain"), ("optimize", "material", "pattern", "preset"), Design, optimize),
    Stage("pattern", ("domain", "optimize"), ("pattern", "material"), Pattern, pattern),
    Stage("solid", ("domain", "optimize", "pattern"), ("solid", "material"), Solid, solid),
    Stage(
        "report",
        ("motion", "body", "biomech", "domain", "optimize", "pattern", "solid"),
        ("subject", "domain", "pattern"),
        None,
        report,
    ),
)
