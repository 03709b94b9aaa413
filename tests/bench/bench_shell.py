"""The whole shell benchmark: ``python -m tests.bench.bench_shell [--quick] [--out FILE]``.

Measures every contestant on one mesh in one run, and the growth of each solver with the mesh, each in a
process of its own, one after the other. Writes one JSON file; `show_shell` makes table and plot of it. Under
ten minutes on two idle cores; ``--quick`` takes small meshes and is only there to see that all works.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
ROOT = Path(__file__).parents[2]
TASKS = ("pattern", "loads", "clusters:9", "frame")
PEERS = ("spsolve", "splu", "torch_fem", "torch_fem_scipy", "torch_fem_pardiso")
GROWTH = (5000, 10_000, 20_000, 40_000, 80_000)
VERSIONS = ("hilbrace", "numpy", "scipy", "torch", "mkl", "cholespy", "torch-fem", "pypardiso")


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small meshes, to see that all works")
    parser.add_argument("--out", type=Path, default=RESULTS / "shell.json", help="the JSON file")
    wanted = parser.parse_args()
    main_size, sizes = (
        (1000, (500, 1000)) if wanted.quick else (10_000, (5000, 10_000, 20_000, 40_000, 80_000))
    )
    run = measure_all(main_size, sizes)
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    wanted.out.write_text(json.dumps(run, indent=1) + "\n")


def measure_all(main_size: int, sizes: tuple[int, ...]) -> dict[str, Any]:
    """All measurements of a run."""
    from hilbrace.shell.solver import available_backends

    backends = available_backends()
    return {
        "machine": machine(),
        "own": [_row("own", f"{task}@{name}", main_size) for task in TASKS for name in backends],
        "peers": [_row("peer", name, main_size) for name in PEERS],
        "growth": [_row("growth", name, size) for name in backends for size in sizes],
    }


def machine() -> dict[str, Any]:
    """What was measured on, in words and versions."""
    return {
        "date": datetime.date.today().isoformat(),
        "cores": len(os.sched_getaffinity(0)),
        "processor": _processor(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in VERSIONS},
        "load_average": round(os.getloadavg()[0], 2),
    }


def _row(kind: str, name: str, triangles: int) -> dict[str, Any]:
    """One measurement; where a program is not installed or fails, its last line of complaint."""
    sys.stderr.write(f"{kind} {name} at {triangles} triangles\n")
    command = [sys.executable, "-m", "tests.bench.measure", kind, name, str(triangles)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        complaint = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        sys.stderr.write(f"  left out: {complaint}\n")
        return {"name": name, "missing": complaint}
    return {"name": name, **json.loads(done.stdout.splitlines()[-1])}


def _processor() -> str:
    """Name of the processor, as the kernel tells it."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":")[1].strip()
    return platform.machine()


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


if __name__ == "__main__":
    main()
