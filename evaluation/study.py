"""The study file: which trials belong to which condition, and how they are measured."""

from __future__ import annotations

import difflib
import glob
import os
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePath

from pydantic import Field, ValidationError

from evaluation.conventions import Convention
from evaluation.protocol import Protocol
from evaluation.published import published_rows
from hilbrace.config import Section
from hilbrace.errors import ConfigError


class ConditionSettings(Section):
    """One brace condition and its repeats."""

    name: str = Field(min_length=1, description="name in tables and figures")
    trials: tuple[str, ...] | str = Field(
        description="C3D or TRC files of the repeats, or one pattern such as 'unbraced_*.c3d'"
    )
    standing: Path | None = Field(
        default=None, description="standing trial in this condition; checks that nothing was moved"
    )
    published: str | None = Field(
        default=None, description="row of the paper's table to print beside this condition"
    )


class EventSettings(Section):
    """Events of one trial set by hand; those left out are found."""

    bending_s: float | None = Field(default=None, description="bending peak [s]")
    touchdown_s: float | None = Field(default=None, description="first contact after the jump [s]")
    landing_s: float | None = Field(default=None, description="landing peak [s]")


class StudySettings(Section):
    """A study: one leg of one person in several conditions."""

    name: str = Field(default="study", description="title of the report")
    subject: str = Field(default="subject", description="who was measured")
    standing: Path = Field(description="standing trial without a brace; calibrates all conditions")
    movement: Path | None = Field(
        default=None, description="calibration movement (squats) that shows cross-talk"
    )
    baseline: str = Field(description="name of the condition that sagittal angles are compared with")
    convention: Convention = Field(default="paper", description="signs of written angles and curves")
    protocol: Protocol = Field(description="markers, hip, processing")
    conditions: tuple[ConditionSettings, ...] = Field(min_length=1, description="conditions in table order")
    events: dict[str, EventSettings] = Field(
        default={},
        description="events set by hand, by file name, or by path where folders hold files of one name",
    )
    synthetic: bool = Field(
        default=False, description="trials were generated, not recorded; reports say so on every page"
    )


@dataclass(frozen=True)
class TrialFile:
    """One repeat of a condition.

    Attributes:
        condition: Index of its condition.
        path: The file.
        events: What was set by hand.
        key: What [events] of the study file calls it: the file's name, or its path where another trial has
            the same name. Empty stands for the file's name.
    """

    condition: int
    path: Path
    events: EventSettings
    key: str = ""

    @property
    def name(self) -> str:
        """The trial's name in tables and file names."""
        path = PurePath(self.key or self.path.name).with_suffix("")
        return "_".join(part for part in path.parts if part not in ("..", path.anchor))


@dataclass(frozen=True)
class Study:
    """A study with its files found.

    Attributes:
        settings: The file's content; paths absolute.
        trials: Every repeat, condition by condition.
        folder: Where the study file is.
    """

    settings: StudySettings
    trials: tuple[TrialFile, ...]
    folder: Path

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the conditions."""
        return tuple(condition.name for condition in self.settings.conditions)

    @property
    def baseline(self) -> int:
        """Index of the baseline condition."""
        return self.names.index(self.settings.baseline)


def read_study(path: Path) -> Study:
    """Read a study file; paths inside are relative to it.

    Raises:
        ConfigError: The file is missing, is no TOML, has a wrong key or value, or names files that are not
            there.
    """
    try:
        content = tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise ConfigError(
            "no such study file", where=str(path), hint="name a study.toml; README.md shows one"
        ) from None
    except IsADirectoryError:
        raise ConfigError("this is a folder", where=str(path), hint="name the study.toml in it") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise ConfigError(f"not valid TOML: {fault}", where=str(path), hint="mend the line named") from None
    try:
        settings = StudySettings.model_validate(content)
    except ValidationError as fault:
        raise _explain(fault, path) from None
    folder = path.resolve().parent
    trials = tuple(_trials(settings, folder, path))
    _check(settings, trials, path)
    return Study(_absolute(settings, folder), trials, folder)


def _trials(settings: StudySettings, folder: Path, path: Path) -> list[TrialFile]:
    found: list[tuple[int, Path]] = []
    for index, condition in enumerate(settings.conditions):
        if isinstance(condition.trials, str):
            names = sorted(glob.glob(condition.trials, root_dir=folder, recursive=True))
        else:
            names = list(condition.trials)
        files = [folder / name for name in names]
        missing = [file for file in files if not file.is_file()]
        if missing or not files:
            lacking = f"no file {missing[0].name}" if missing else f"no files '{condition.trials}'"
            raise ConfigError(
                f"condition '{condition.name}' has " + (lacking if condition.trials else "no trials"),
                where=str(path),
                hint=f"put it into {folder}, or correct 'trials'",
            )
        found += [(index, file) for file in files]
    shared = Counter(file.stem for _, file in found)
    keys = [file.name if shared[file.stem] == 1 else _beside(file, folder) for _, file in found]
    return [
        TrialFile(index, file, settings.events.get(key, EventSettings()), key)
        for (index, file), key in zip(found, keys, strict=True)
    ]


def _beside(file: Path, folder: Path) -> str:
    """The path of a file as seen from the study's folder."""
    return Path(os.path.relpath(file, folder)).as_posix()


def _check(settings: StudySettings, trials: tuple[TrialFile, ...], path: Path) -> None:
    names = [condition.name for condition in settings.conditions]
    files = [trial.path.resolve() for trial in trials]
    called = [trial.name for trial in trials]
    for what, values in (("condition", names), ("trial", files), ("trial", called)):
        twice = [value for value, count in Counter(map(str, values)).items() if count > 1]
        if twice:
            raise ConfigError(
                f"{what} '{twice[0]}' is listed twice", where=str(path), hint=f"list every {what} once"
            )
    if settings.baseline not in names:
        raise _unknown("baseline", settings.baseline, names, path)
    for condition in settings.conditions:
        if condition.published is not None and condition.published not in published_rows():
            raise _unknown("published", condition.published, list(published_rows()), path)
    keys = [trial.key for trial in trials]
    stray = sorted(set(settings.events) - set(keys))
    if stray:
        raise _unknown("events", stray[0], keys, path)


def _unknown(key: str, value: str, known: list[str], path: Path) -> ConfigError:
    near = difflib.get_close_matches(value, known, n=1, cutoff=0.4)
    hint = f"did you mean '{near[0]}'?" if near else f"choose one of {', '.join(known[:12])}"
    return ConfigError(f"{key} = '{value}' is not there", where=str(path), hint=hint)


def _explain(fault: ValidationError, path: Path) -> ConfigError:
    faults = fault.errors()
    first = next((entry for entry in faults if entry["type"] == "extra_forbidden"), faults[0])
    key = ".".join(str(part) for part in first["loc"] if "[" not in str(part))
    if first["type"] == "extra_forbidden":
        known = sorted(_keys(StudySettings))
        near = difflib.get_close_matches(key.split(".")[-1], known, n=1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'?" if near else "README.md lists the keys"
        return ConfigError(f"unknown key '{key}'", where=str(path), hint=hint)
    if first["type"] == "missing":
        return ConfigError(f"'{key}' is missing", where=str(path), hint=_meaning(first["loc"]))
    return ConfigError(
        f"'{key}' = {first['input']!r}: {first['msg']}", where=str(path), hint="correct the value"
    )


def _keys(section: type[Section]) -> set[str]:
    keys = set(section.model_fields)
    for kind in (Protocol, ConditionSettings, EventSettings, *_sections(Protocol)):
        keys |= set(kind.model_fields)
    return keys


def _sections(section: type[Section]) -> list[type[Section]]:
    kinds = [entry.annotation for entry in section.model_fields.values()]
    return [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Section)]


def _meaning(location: tuple[int | str, ...]) -> str:
    """What a missing key is for, from its description."""
    for kind in (StudySettings, Protocol, ConditionSettings, *_sections(Protocol)):
        entry = kind.model_fields.get(str(location[-1]))
        if entry is not None and entry.description:
            return f"add it: {entry.description}"
    return "add it"


def _absolute(settings: StudySettings, folder: Path) -> StudySettings:
    def place(value: Path | None) -> Path | None:
        return None if value is None else (folder / value).resolve()

    hip = settings.protocol.hip
    protocol = settings.protocol.model_copy(update={"hip": hip.model_copy(update={"body": place(hip.body)})})
    conditions = tuple(
        condition.model_copy(update={"standing": place(condition.standing)})
        for condition in settings.conditions
    )
    return settings.model_copy(
        update={
            "standing": place(settings.standing),
            "movement": place(settings.movement),
            "protocol": protocol,
            "conditions": conditions,
        }
    )
