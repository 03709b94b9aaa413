"""A run of the whole chain that is small enough to be repeated."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import tomli_w

SMALL = {
    "subject": {"name": "synthetic subject"},
    "motion": {"synthetic": "squat", "window": [0.6, 1.3], "cutoff_hz": 15.0},
    "domain": {"triangles": 700, "frames_per_second": 8.0},
    "optimize": {"iterations": 24, "checkpoint_every": 2, "snapshots": 8},
}

RESULTS = (
    "optimize/optimize.npz",
    "optimize/history.csv",
    "optimize/history.png",
    "optimize/film.gif",
    "optimize/film.glb",
    "solid/solid.npz",
    "solid/brace.stl",
    "solid/brace.ply",
    "solid/brace.glb",
)


def write_small_run(folder: Path, **changes: dict[str, object]) -> Path:
    """Write the small run's ``run.toml`` into a folder."""
    content = {name: SMALL.get(name, {}) | changes.get(name, {}) for name in {**SMALL, **changes}}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.toml").write_text(tomli_w.dumps(content))
    return folder


def start(folder: Path, *words: str) -> subprocess.Popen[str]:
    """Start ``hilbrace run`` on a folder in a process of its own."""
    command = [sys.executable, "-m", "hilbrace", "run", str(folder), *words]
    return subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def finish(folder: Path, *words: str) -> str:
    """Run to the end and return standard error.

    Raises:
        AssertionError: The run failed.
    """
    process = start(folder, *words)
    try:
        _, messages = process.communicate(timeout=600)
    finally:
        process.kill()
    assert process.returncode == 0, messages
    return messages


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of the results."""
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in RESULTS}
