"""A run folder: what was asked, what was done, and what came out.

``manifest.json`` lists each finished stage with the key it was computed under and the digests of its files.
A stage whose key and files still agree is not computed again; a stage that was interrupted left nothing
that counts. One process at a time works in a folder.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hilbrace.errors import BusyError, InputError
from hilbrace.run.records import write_atomic

MANIFEST = "manifest.json"
METRICS = "metrics.json"
LOG = "log.jsonl"


@dataclass(frozen=True)
class StageEntry:
    """One finished stage in the manifest.

    Attributes:
        key: Digest of the stage's settings, inputs and version.
        files: SHA-256 of each file the stage wrote, by path relative to the run folder.
        seconds: Wall time [s].
        metrics: Figures of the stage by group, unit in each key.
    """

    key: str
    files: dict[str, str]
    seconds: float
    metrics: dict[str, dict[str, Any]]


def digest(*parts: str | bytes) -> str:
    """SHA-256 of several texts, each closed by a zero byte."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else part)
        total.update(b"\0")
    return total.hexdigest()


def file_digest(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        InputError: The file cannot be read.
    """
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as fault:
        raise InputError(
            fault.strerror or "cannot be read", where=str(path), hint="check the path in the run.toml"
        ) from fault


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the run folder for this process; the operating system lets go when the process ends.

    Raises:
        BusyError: Another process holds it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("a") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BusyError(
                "another process is working here",
                where=str(folder),
                hint="wait for it to end, or give another folder with --out",
            ) from None
        yield


def read_manifest(folder: Path) -> dict[str, StageEntry]:
    """The finished stages of a folder, in order; empty where there is no manifest.

    Raises:
        InputError: The manifest is damaged.
    """
    path = folder / MANIFEST
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text("utf-8"))
        return {name: StageEntry(**entry) for name, entry in content["stages"].items()}
    except (ValueError, KeyError, TypeError) as fault:
        raise InputError(
            f"damaged manifest: {fault}", where=str(path), hint="delete the file; the stages run again"
        ) from fault


def write_manifest(folder: Path, stages: dict[str, StageEntry], about: dict[str, Any]) -> None:
    """Write the manifest atomically.

    Args:
        folder: The run folder.
        stages: Finished stages.
        about: What else belongs to the run's identity: version, packages, origin of the data.
    """
    content = about | {"stages": {name: vars(entry) for name, entry in stages.items()}}
    write_json(folder / MANIFEST, content)


def is_current(folder: Path, entry: StageEntry | None, key: str) -> bool:
    """Whether a stage was finished under this key and its files are still as it wrote them."""
    if entry is None or entry.key != key:
        return False
    return all(
        (folder / name).is_file() and file_digest(folder / name) == value
        for name, value in entry.files.items()
    )


def write_json(path: Path, content: Any) -> None:
    """Write JSON atomically, indented, keys in the order given."""
    write_atomic(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())


def log_event(folder: Path, event: str, **facts: Any) -> None:
    """Append one line to the run's log."""
    line = {"time": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "event": event} | facts
    with (folder / LOG).open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(line) + "\n")
