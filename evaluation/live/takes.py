"""The takes of a session on the disk: their names, their C3D files, and the study file that measures them."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from evaluation.live.settings import LabSettings
from evaluation.record.conversion import convert
from evaluation.record.reading import read_log
from hilbrace.errors import ConfigError
from hilbrace.run.records import write_atomic

STUDY = "study.toml"

STANDING = "standing"


@dataclass(frozen=True)
class Take:
    """One finished recording.

    Attributes:
        condition: Brace condition; ``standing`` for a standing trial.
        log: The recording.
        c3d: The same as a C3D file.
        notes: What the conversion left out or found missing, one sentence each.
    """

    condition: str
    log: Path
    c3d: Path
    notes: tuple[str, ...]


def log_name(folder: Path, condition: str) -> Path:
    """Name of the next recording of a condition; the recorder chooses another if it is taken by then.

    Args:
        folder: Folder of the session.
        condition: Brace condition.
    """
    stem = re.sub(r"[^a-z0-9]+", "_", condition.lower()).strip("_") or "take"
    if condition == STANDING:
        return folder / f"{STANDING}.mcap"
    number = 1
    while any((folder / f"{stem}_{number}{ending}").exists() for ending in (".mcap", ".c3d")):
        number += 1
    return folder / f"{stem}_{number}.mcap"


def finish_take(log: Path, condition: str) -> Take:
    """Convert a finished recording; a condition marked during the take counts.

    Args:
        log: The recording.
        condition: Condition at its beginning.

    Raises:
        InputError: It has no markers.
    """
    recorded = read_log(log)
    c3d, notes = convert(recorded, log.with_suffix(".c3d"))
    return Take(condition if condition == STANDING else recorded.condition or condition, log, c3d, notes)


class StudyFile:
    """The study file that grows with the takes; `hilbrace evaluate table` runs on it.

    Args:
        folder: Folder of the session; a study file in it is continued.
        settings: What is measured.

    Raises:
        ConfigError: The folder holds a study file that cannot be continued.
    """

    def __init__(self, folder: Path, settings: LabSettings) -> None:
        self.path = folder / STUDY
        self._settings = settings
        self._trials: dict[str, list[str]] = {name: [] for name in settings.names}
        self._standing = "" if settings.standing is None else str(settings.standing)
        self._kept: dict[str, Any] = {}
        if self.path.exists():
            self._continue()

    @property
    def counts(self) -> dict[str, int]:
        """Takes of each condition."""
        return {name: len(files) for name, files in self._trials.items()}

    @property
    def standing(self) -> Path | None:
        """The standing trial, once there is one."""
        return self.path.parent / self._standing if self._standing else None

    def add(self, take: Take) -> None:
        """Note a take, and write the file as soon as it can be measured."""
        if take.condition == STANDING:
            self._standing = take.c3d.name
        else:
            self._trials.setdefault(take.condition, []).append(take.c3d.name)
        if self._standing:
            write_atomic(self.path, tomli_w.dumps(self._document()).encode())

    def _document(self) -> dict[str, Any]:
        settings = self._settings
        measured = [condition for condition in settings.conditions if self._trials[condition.name]]
        document: dict[str, Any] = {
            "name": settings.name,
            "subject": settings.subject,
            "synthetic": settings.synthetic,
            "standing": self._standing,
            "baseline": settings.baseline,
            "convention": settings.convention,
            "protocol": settings.protocol.model_dump(mode="json", exclude_none=True),
            "conditions": [
                {"name": condition.name, "trials": self._trials[condition.name]}
                | ({"published": condition.published} if condition.published else {})
                for condition in measured
            ],
        }
        return document | self._kept

    def _continue(self) -> None:
        hint = "name another folder by --out, or move the file away"
        try:
            content = tomllib.loads(self.path.read_text("utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
            raise ConfigError(f"not valid TOML: {fault}", where=str(self.path), hint=hint) from None
        conditions = content.get("conditions", [])
        for condition in conditions if isinstance(conditions, list) else []:
            name, trials = condition.get("name"), condition.get("trials")
            if name not in self._trials or not isinstance(trials, list):
                raise ConfigError(
                    f"condition '{name}' of the study there is not one of this session",
                    where=str(self.path),
                    hint=hint,
                )
            self._trials[name] = [str(trial) for trial in trials]
        self._standing = self._standing or str(content.get("standing", ""))
        self._kept = {key: content[key] for key in ("events", "movement") if key in content}
