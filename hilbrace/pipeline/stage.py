"""What a stage is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hilbrace.config import Config
from hilbrace.run.progress import DetailedReport


@dataclass(frozen=True)
class Inputs:
    """What a stage works from.

    Attributes:
        config: The whole configuration.
        folder: The stage's own folder, which exists.
        records: Records of the stages before, by stage name.
        metrics: Metrics of the stages before, by group.
        key: The stage's key; a checkpoint made under another key is of no use.
        progress: Called with (done, total), and a line about it if there is one.
    """

    config: Config
    folder: Path
    records: dict[str, Any]
    metrics: dict[str, dict[str, Any]]
    key: str
    progress: DetailedReport


@dataclass(frozen=True)
class Outcome:
    """What a stage leaves.

    Attributes:
        record: Its record; ``None`` for the report.
        files: Files written beside the record.
        metrics: Figures for ``metrics.json`` by group, unit in each key.
    """

    record: Any
    files: tuple[Path, ...] = ()
    metrics: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline.

    Attributes:
        name: Its name and folder.
        needs: Stages whose records it reads.
        sections: Configuration sections it depends on.
        kind: Class of its record; ``None`` for the report.
        work: Computes the outcome.
    """

    name: str
    needs: tuple[str, ...]
    sections: tuple[str, ...]
    kind: type | None
    work: Callable[[Inputs], Outcome]

    @property
    def file(self) -> str:
        """Path of the record relative to the run folder."""
        return f"{self.name}/{self.name}.npz"
