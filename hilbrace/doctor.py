"""What this installation can do: versions, backends, threads, memory."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
import tempfile
from typing import Any

import psutil
from rich.console import Console
from rich.table import Table

from hilbrace.shell.solver import BACKENDS, available_backends

PACKAGES = (
    "numpy", "scipy", "torch", "trimesh", "manifold3d", "libigl", "mmgpy", "opensim", "ezc3d", "casadi",
    "pydantic", "matplotlib", "jinja2",
)  # fmt: skip

MEMORY_NEEDED_GB = 4.0
"""A default run stays below this (peak resident memory of all its processes) [GB]."""


def examine() -> dict[str, Any]:
    """Look at this machine.

    Returns:
        Versions of the packages, what answered, cores, memory [GB], and ``healthy``.
    """
    versions = {name: _version(name) for name in PACKAGES}
    memory = psutil.virtual_memory()
    opensim = _opensim_answers()
    missing = [name for name, version in versions.items() if version is None]
    return {
        "hilbrace": importlib.metadata.version("hilbrace"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": versions,
        "missing": missing,
        "opensim_worker": opensim,
        "torch_build": "CPU" if "+cpu" in (versions["torch"] or "") else "as installed",
        "shell_solver": available_backends()[0],
        "shell_solvers": list(available_backends()),
        "cores": os.cpu_count(),
        "threads": int(os.environ.get("OMP_NUM_THREADS", os.cpu_count() or 1)),
        "memory_total_gb": round(memory.total / 1e9, 1),
        "memory_free_gb": round(memory.available / 1e9, 1),
        "enough_memory": memory.available / 1e9 >= MEMORY_NEEDED_GB,
        "healthy": not missing and opensim["answers"],
    }


def print_findings(findings: dict[str, Any]) -> None:
    """Print the findings as a table."""
    console = Console()
    table = Table(title="hilbrace doctor", show_header=False, title_justify="left")
    table.add_row("hilbrace", findings["hilbrace"])
    table.add_row("python", f"{findings['python']}, {findings['platform']}")
    for name, version in findings["packages"].items():
        table.add_row(name, version or "[red]missing: pip install hilbrace[/red]")
    worker = findings["opensim_worker"]
    table.add_row(
        "OpenSim worker",
        f"answers, {worker['version']}" if worker["answers"] else f"[red]{worker['fault']}[/red]",
    )
    table.add_row("shell solver", _solvers(findings["shell_solvers"]))
    table.add_row("cores, threads", f"{findings['cores']}, {findings['threads']}")
    table.add_row("memory", f"{findings['memory_free_gb']} of {findings['memory_total_gb']} GB free")
    console.print(table)
    console.print(
        "[green]ready[/green]" if findings["healthy"] else "[red]not ready: mend the rows in red[/red]"
    )


def _solvers(names: list[str]) -> str:
    """The shell solver in use, what else is there, and what would be faster."""
    others = f" (also {', '.join(names[1:])})" if names[1:] else ""
    advice = "" if BACKENDS[0] in names else "; four times faster with pip install 'hilbrace\\[mkl]'"
    return names[0] + others + advice


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _opensim_answers() -> dict[str, Any]:
    """Start OpenSim in a process of its own, as the biomechanics stage does."""
    words = [sys.executable, "-c", "import opensim; print(opensim.GetVersion())"]
    try:
        with tempfile.TemporaryDirectory() as elsewhere:  # OpenSim leaves a log file where it starts
            done = subprocess.run(
                words, capture_output=True, text=True, timeout=120, check=False, cwd=elsewhere
            )
    except subprocess.TimeoutExpired:
        return {"answers": False, "version": None, "fault": "no answer in 120 s"}
    lines = done.stdout.strip().splitlines()
    if done.returncode == 0 and lines:
        return {"answers": True, "version": lines[-1], "fault": None}
    fault = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
    return {"answers": False, "version": None, "fault": fault[0]}
