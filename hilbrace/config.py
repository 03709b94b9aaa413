"""The configuration of a run: one TOML file, one frozen section per stage.

Unknown keys are refused by name with the nearest known one. Every value has a default, so that the
shortest useful file names a recording and a joint.
"""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hilbrace.errors import ConfigError


class Section(BaseModel):
    """A part of the configuration: frozen, and closed to unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)


class SubjectSettings(Section):
    """Who moves."""

    name: str = Field(default="subject", description="name used in reports")
    mass_kg: float | None = Field(
        default=None, gt=10, lt=300, description="mass [kg]; read from the forces if left out"
    )
    height_m: float | None = Field(
        default=None, gt=0.8, lt=2.6, description="height [m]; from the markers if left out"
    )


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


class BodySettings(Section):
    """The skin."""

    weight_smoothing_mm: float = Field(
        default=40.0, ge=0, description="diffusion length of the skinning weights [mm]"
    )


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


class DomainSettings(Section):
    """Where the brace sits and how its surface is meshed."""

    joint: Literal["knee"] = Field(default="knee", description="braced joint")
    side: Literal["left", "right"] = Field(default="left", description="braced side")
    above: float = Field(
        default=0.40, gt=0.1, lt=0.8, description="upper edge, fraction of the thigh above the knee"
    )
    below: float = Field(
        default=0.38, gt=0.1, lt=0.8, description="lower edge, fraction of the shank below the knee"
    )
    triangles: int = Field(default=4000, ge=400, le=60000, description="target number of triangles")
    seam_azimuth_deg: float = Field(
        default=180.0, description="seam around the limb: 0 anterior, 180 posterior [deg]"
    )
    flatten: Literal["lscm", "periodic"] = Field(default="periodic", description="flat map")
    frames_per_second: float = Field(
        default=15.0, gt=0, description="frames of the motion used by the design [1/s]"
    )


class MaterialSettings(Section):
    """The cast rubber and the two microstructures."""

    youngs_modulus_mpa: float = Field(default=1.15, gt=0, description="Young's modulus of the rubber [MPa]")
    poisson: float = Field(default=0.45, gt=0, lt=0.5, description="Poisson's ratio [-]")
    density_g_per_ml: float = Field(default=1.08, gt=0, description="density of the rubber [g/ml]")
    thickness_mm: float = Field(default=4.0, gt=0.5, lt=20, description="thickness of the brace [mm]")
    firm: Literal["voronoi_open"] = Field(default="voronoi_open", description="firm microstructure")
    soft: Literal["sinusoidal"] = Field(default="sinusoidal", description="soft microstructure")


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


class PatternSettings(Section):
    """The microstructure on the surface."""

    scale: float = Field(
        default=0.08, gt=0.01, lt=0.5, description="period of the cells in the flat map (paper: 0.08)"
    )
    min_strut_mm: float = Field(default=1.5, gt=0, description="narrowest strut that can be cast [mm]")
    min_slit_mm: float = Field(default=1.0, ge=0, description="narrowest slit that can be cast [mm]")
    rim_mm: float = Field(default=8.0, ge=2, description="width of the solid bands at both edges [mm]")
    blend_mm: float = Field(default=30.0, gt=0, description="width of the transition from firm to soft [mm]")
    resolution_mm: float = Field(
        default=1.0,
        gt=0.1,
        lt=5,
        description="longest edge of the refined surface, which is never longer than 0.55 min_strut_mm [mm]",
    )


class SolidSettings(Section):
    """The closed body."""

    simplify_mm: float = Field(
        default=0.05, ge=0, description="largest deviation of the simplified mesh [mm]"
    )


class Config(Section):
    """Everything a run depends on."""

    subject: SubjectSettings = SubjectSettings()
    motion: MotionSettings = MotionSettings()
    body: BodySettings = BodySettings()
    biomech: BiomechSettings = BiomechSettings()
    domain: DomainSettings = DomainSettings()
    material: MaterialSettings = MaterialSettings()
    optimize: OptimizeSettings = OptimizeSettings()
    pattern: PatternSettings = PatternSettings()
    solid: SolidSettings = SolidSettings()


def read_config(path: Path, overrides: dict[str, str] | None = None) -> Config:
    """Read a ``run.toml``; paths inside are relative to the file.

    Args:
        path: The TOML file.
        overrides: Values by dotted key, as texts (``{"optimize.iterations": "50"}``).

    Raises:
        ConfigError: The file is missing, is no TOML, or a key or value is wrong.
    """
    try:
        content = tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise ConfigError(
            "no such file", where=str(path), hint="check the path, or start from `hilbrace demo`"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise ConfigError(f"not valid TOML: {fault}", where=str(path), hint="mend the line named") from None
    apply_overrides(content, overrides or {})
    config = parse_config(content, str(path))
    return _absolute(config, path.parent)


def parse_config(content: dict[str, Any], where: str) -> Config:
    """Check a parsed TOML document.

    Raises:
        ConfigError: Names the first wrong key, and the nearest right one.
    """
    try:
        config = Config.model_validate(content)
    except ValidationError as fault:
        raise _explain(fault, where) from None
    _check_angles(config, where)
    return config


def controlled_angles(settings: OptimizeSettings, joint: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the angles that a brace shall preserve and prevent.

    Args:
        settings: The optimizer's settings.
        joint: ``knee`` or ``ankle``.
    """
    sagittal, frontal, *_ = ANGLES[joint]
    preserve = (sagittal,) if settings.preserve is None else settings.preserve
    return preserve, (frontal,) if settings.prevent is None else settings.prevent


def _check_angles(config: Config, where: str) -> None:
    """Angles to preserve and prevent must be angles of the braced joint, each named once in all."""
    joint = config.domain.joint
    preserve, prevent = controlled_angles(config.optimize, joint)
    for key, names in (("preserve", preserve), ("prevent", prevent)):
        for name in names:
            if name not in ANGLES[joint]:
                raise ConfigError(
                    f"'optimize.{key}': a {joint} has no angle '{name}'",
                    where=where,
                    hint=f"use {', '.join(ANGLES[joint])}",
                )
    for name in ANGLES[joint]:
        if (preserve + prevent).count(name) > 1:
            raise ConfigError(
                f"'optimize.preserve' and 'optimize.prevent' name '{name}' more than once",
                where=where,
                hint="name each angle once, in one of the two",
            )


def apply_overrides(content: dict[str, Any], overrides: dict[str, str]) -> None:
    """Write values by dotted key into a TOML document, as ``--set`` does.

    Args:
        content: The document; changed in place.
        overrides: Values as TOML texts; what is no TOML value is taken as a string.

    Raises:
        ConfigError: A key names no section.
    """
    for key, text in overrides.items():
        _set(content, key, text)


def known_keys(section: type[BaseModel] = Config, prefix: str = "") -> list[str]:
    """All dotted keys of the configuration."""
    keys: list[str] = []
    for name, field in section.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            keys += known_keys(kind, f"{prefix}{name}.")
        else:
            keys.append(prefix + name)
    return keys


def _explain(fault: ValidationError, where: str) -> ConfigError:
    first = fault.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        sections = list(Config.model_fields)
        near = difflib.get_close_matches(key, known_keys() + sections, n=1, cutoff=0.5)
        leaf = difflib.get_close_matches(key.split(".")[-1], [k.split(".")[-1] for k in known_keys()], n=1)
        if not near and leaf:
            near = [k for k in known_keys() if k.split(".")[-1] == leaf[0]][:1]
        hint = f"did you mean '{near[0]}'?" if near else f"known sections: {', '.join(sections)}"
        return ConfigError(f"unknown key '{key}'", where=where, hint=hint)
    return ConfigError(f"'{key}' = {first['input']!r}: {first['msg']}", where=where, hint="correct the value")


def _set(content: dict[str, Any], key: str, text: str) -> None:
    *path, leaf = key.split(".")
    if not path:
        near = [k for k in known_keys() if k.endswith("." + key)][:1]
        hint = f"write it as '{near[0]}'" if near else "write section.key=value"
        raise ConfigError(f"'{key}' names no section", where="--set", hint=hint)
    for part in path:
        content = content.setdefault(part, {})
    try:
        content[leaf] = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        content[leaf] = text


def _absolute(config: Config, folder: Path) -> Config:
    motion = config.motion
    moved: dict[str, Any] = {
        name: (folder / value).resolve()
        for name in ("markers", "forces", "static", "static_forces")
        if (value := getattr(motion, name)) is not None
    }
    if motion.marker_map.endswith(".toml"):
        moved["marker_map"] = str((folder / motion.marker_map).resolve())
    biomech = config.biomech
    if biomech.model is not None:
        biomech = biomech.model_copy(update={"model": (folder / biomech.model).resolve()})
    return config.model_copy(update={"motion": motion.model_copy(update=moved), "biomech": biomech})
