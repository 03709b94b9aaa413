"""The configuration of a run: one TOML file, one frozen section per stage.

Unknown keys are refused by name with the nearest known one. Every value has a default, so that the
shortest useful file names a recording and a joint.
"""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, ValidationError

from hilbrace.config.biomech import BiomechSettings
from hilbrace.config.body import BodySettings
from hilbrace.config.domain import DomainSettings
from hilbrace.config.material import MaterialSettings
from hilbrace.config.mold import MoldSettings
from hilbrace.config.motion import MotionSettings
from hilbrace.config.optimize import ANGLES, OptimizeSettings, controlled_angles
from hilbrace.config.pattern import PatternSettings, SolidSettings
from hilbrace.config.presets import PresetName, with_preset
from hilbrace.config.section import Section
from hilbrace.config.subject import SubjectSettings
from hilbrace.errors import ConfigError


class Config(Section):
    """Everything a run depends on."""

    preset: PresetName = Field(
        default="default",
        description="values for what the file leaves out: default, smooth (a field of sigma 10), or paper "
        "(everything as published)",
    )
    subject: SubjectSettings = SubjectSettings()
    motion: MotionSettings = MotionSettings()
    body: BodySettings = BodySettings()
    biomech: BiomechSettings = BiomechSettings()
    domain: DomainSettings = DomainSettings()
    material: MaterialSettings = MaterialSettings()
    optimize: OptimizeSettings = OptimizeSettings()
    pattern: PatternSettings = PatternSettings()
    solid: SolidSettings = SolidSettings()
    mold: MoldSettings = MoldSettings()


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
        config = Config.model_validate(with_preset(content))
    except ValidationError as fault:
        raise _explain(fault, where) from None
    _check_angles(config, where)
    if config.pattern.scale is not None and config.pattern.period_mm is not None:
        raise ConfigError(
            "'pattern.scale' and 'pattern.period_mm' both say how wide the cells are",
            where=where,
            hint="keep one of the two",
        )
    return config


def _check_angles(config: Config, where: str) -> None:
    """Angles to preserve and prevent must be angles of the braced joint, each named once in all."""
    joint = config.domain.joint
    preserve, prevent = controlled_angles(config.optimize, joint)
    if not preserve + prevent:
        raise ConfigError(
            "'optimize.preserve' and 'optimize.prevent' are both empty: the brace would have nothing to do",
            where=where,
            hint=f"name angles of the {joint} in one of the two: {', '.join(ANGLES[joint])}",
        )
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
    if not path and leaf not in known_keys():
        near = [k for k in known_keys() if k.endswith("." + key)][:1]
        hint = f"write it as '{near[0]}'" if near else "write section.key=value"
        raise ConfigError(f"'{key}' names no section", where="--set", hint=hint)
    for part in path:
        content = content.setdefault(part, {})
        if not isinstance(content, dict):
            raise ConfigError(f"'{part}' is no section", where=f"--set {key}", hint="write section.key=value")
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
    body = config.body
    if body.model_file is not None:
        body = body.model_copy(update={"model_file": (folder / body.model_file).resolve()})
    domain = _absolute_paint(config.domain, folder)
    material = _absolute_cells(config.material, folder)
    return config.model_copy(
        update={
            "motion": motion.model_copy(update=moved),
            "body": body,
            "biomech": biomech,
            "domain": domain,
            "material": material,
        }
    )


def _absolute_cells(material: MaterialSettings, folder: Path) -> MaterialSettings:
    """Skeleton files of the microstructures, relative to the configuration's folder."""
    cells = {"firm": material.firm, "soft": material.soft}
    own = {key: str((folder / name).resolve()) for key, name in cells.items() if name.endswith(".toml")}
    return material.model_copy(update=own)


def _absolute_paint(domain: DomainSettings, folder: Path) -> DomainSettings:
    """Files of painted skin, relative to the configuration's folder."""
    reliefs = tuple(
        relief
        if relief.painted is None
        else relief.model_copy(update={"painted": (folder / relief.painted).resolve()})
        for relief in domain.reliefs
    )
    painted = None if domain.painted is None else (folder / domain.painted).resolve()
    return domain.model_copy(update={"painted": painted, "reliefs": reliefs})
