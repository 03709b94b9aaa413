"""The file that says what a laboratory measures live: devices, leg, markers and brace conditions."""

from __future__ import annotations

import tomllib
from pathlib import Path

from pydantic import Field, ValidationError

from evaluation.conventions import Convention
from evaluation.protocol import Protocol
from evaluation.published import published_rows
from hilbrace.config import Section
from hilbrace.errors import ConfigError


class LiveCondition(Section):
    """One brace condition."""

    name: str = Field(min_length=1, max_length=60, description="name on the screen and in tables")
    published: str | None = Field(
        default=None, description="row of the paper's table to print beside this condition"
    )


class LabSettings(Section):
    """What is measured, and with which devices."""

    name: str = Field(default="study", max_length=120, description="title of the report")
    subject: str = Field(default="subject", max_length=120, description="who is measured")
    devices: tuple[str, ...] = Field(
        default=(), description="addresses of the devices, such as 'vicon://192.168.1.10'"
    )
    protocol: Protocol = Field(description="markers, hip, processing")
    conditions: tuple[LiveCondition, ...] = Field(
        min_length=1, max_length=24, description="brace conditions in the order of the table"
    )
    baseline: str = Field(description="name of the condition that sagittal angles are compared with")
    convention: Convention = Field(default="paper", description="signs of written angles")
    standing: Path | None = Field(
        default=None, description="standing trial recorded before; without it, one is recorded live"
    )
    stomps: str | None = Field(
        default=None,
        max_length=60,
        description="marker on the heel whose stomps tell the clock of a plate with a clock of its own; "
        "every take then needs two stomps at its start and two at its end",
    )
    synthetic: bool = Field(
        default=False, description="the devices are stand-ins; reports say so on every page"
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the conditions."""
        return tuple(condition.name for condition in self.conditions)


def read_lab(path: Path) -> LabSettings:
    """Read a laboratory's file; the paths inside are relative to it.

    Raises:
        ConfigError: The file is missing, is no TOML, or has a wrong key or value.
    """
    try:
        content = tomllib.loads(path.read_text("utf-8"))
    except (FileNotFoundError, IsADirectoryError):
        raise ConfigError(
            "no such file", where=str(path), hint="name a lab.toml; hilbrace evaluate live --help shows one"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise ConfigError(f"not valid TOML: {fault}", where=str(path), hint="mend the line named") from None
    try:
        settings = LabSettings.model_validate(content)
    except ValidationError as fault:
        raise _explain(fault, path) from None
    _check(settings, path)
    folder = path.resolve().parent
    standing = None if settings.standing is None else folder / settings.standing
    body = settings.protocol.hip.body
    hip = settings.protocol.hip.model_copy(update={"body": None if body is None else folder / body})
    protocol = settings.protocol.model_copy(update={"hip": hip})
    return settings.model_copy(update={"standing": standing, "protocol": protocol})


def _check(settings: LabSettings, path: Path) -> None:
    names = settings.names
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise ConfigError(
            f"condition '{repeated[0]}' is listed twice", where=str(path), hint="list every condition once"
        )
    if settings.baseline not in names:
        raise ConfigError(
            f"baseline = '{settings.baseline}' is no condition",
            where=str(path),
            hint=f"choose one of {', '.join(names)}",
        )
    rows = published_rows()
    strange = [
        c.published for c in settings.conditions if c.published is not None and c.published not in rows
    ]
    if strange:
        raise ConfigError(
            f"published = '{strange[0]}' is no row of the paper's table",
            where=str(path),
            hint=f"choose one of {', '.join(rows)}",
        )


def _explain(fault: ValidationError, path: Path) -> ConfigError:
    first = fault.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    hint = {
        "missing": "add it; hilbrace evaluate live --help shows a file",
        "extra_forbidden": "remove it, or correct its name; hilbrace evaluate live --help shows a file",
    }.get(first["type"], "correct the value")
    what = {"missing": f"'{key}' is missing", "extra_forbidden": f"unknown key '{key}'"}.get(
        first["type"], f"'{key}' = {first['input']!r}: {first['msg']}"
    )
    return ConfigError(what, where=str(path), hint=hint)
