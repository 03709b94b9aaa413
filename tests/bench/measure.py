"""One measurement in a process of its own: ``python -m tests.bench.measure KIND NAME TRIANGLES``.

Kinds are ``peer`` (name: one of `contestants.peers`), ``own`` (name: task@backend) and ``growth`` (name: a
backend). The result is one JSON object on standard output. A process for each keeps their memory apart, and
the threads and libraries of one from slowing another.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

LONG_S = 6.0
"""A first call that takes longer counts: warming up is nothing beside it [s]."""


def main() -> None:
    """Measure what the command line names."""
    kind, name, triangles = sys.argv[1:]
    measured = {"peer": peer, "own": own_task, "growth": growth}[kind](name, int(triangles))
    sys.stdout.write(json.dumps(measured) + "\n")


def peer(name: str, triangles: int) -> dict[str, Any]:
    """Time another program."""
    from tests.bench.contestants import peers

    return _iterate(peers()[name], triangles)


def own_task(name: str, triangles: int) -> dict[str, Any]:
    """Time this package."""
    from tests.bench.contestants import own

    return _iterate(own(*name.split("@")), triangles)


def growth(backend: str, triangles: int) -> dict[str, Any]:
    """Time a solver's parts and a whole iteration with 45 free loads."""
    import numpy as np

    from hilbrace.shell import build_shell
    from hilbrace.shell.solver import open_solver
    from tests.bench.contestants import own
    from tests.bench.knee_brace import FRAMES, POISSON, THICKNESS_MM, knee_brace

    brace = knee_brace(triangles)
    loops = brace.upper_loop, brace.lower_loop
    start = time.perf_counter()
    shell = build_shell(brace.vertices, brace.triangles, *loops, THICKNESS_MM, POISSON)
    build = time.perf_counter() - start
    values = shell.refill @ brace.modulus
    rhs = np.asfortranarray(
        np.random.default_rng(2).standard_normal((len(shell.numbering.free), FRAMES + 12))
    )
    with open_solver(shell.numbering.sparsity, backend) as solver:
        factors: list[Any] = []
        factor = times(lambda: factors.append(solver.factor(values)), rounds=3)
        solve = times(lambda: factors[-1].solve(rhs), rounds=3)
    iteration = times(own("loads", backend).start(brace), rounds=3)
    return {
        "triangles": len(brace.triangles),
        "unknowns": len(shell.numbering.free),
        "build_s": build,
        "factor_s": statistics.median(factor),
        "solve_s": statistics.median(solve),
        "iteration_s": statistics.median(iteration),
        "peak_memory_mib": peak_memory_mib(),
    }


def times(iteration: Callable[[], Any], rounds: int = 5) -> list[float]:
    """Seconds of so many calls after the first, which warms up; of fewer if they are long."""
    first = _seconds(iteration)
    seconds = [first] if first > LONG_S else [_seconds(iteration)]
    while len(seconds) < rounds and not _enough(seconds):
        seconds.append(_seconds(iteration))
    return seconds


def _enough(seconds: list[float]) -> bool:
    return sum(seconds) > LONG_S or (len(seconds) >= 3 and sum(seconds) > LONG_S / 2)


def _seconds(iteration: Callable[[], Any]) -> float:
    start = time.perf_counter()
    iteration()
    return time.perf_counter() - start


def peak_memory_mib() -> float:
    """Largest resident set of this process so far (Linux)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024
    return float("nan")


def _iterate(contestant: Any, triangles: int) -> dict[str, Any]:
    from tests.bench.knee_brace import FRAMES, knee_brace

    brace = knee_brace(triangles)
    imported = peak_memory_mib()
    start = time.perf_counter()
    iteration = contestant.start(brace)
    prepare = time.perf_counter() - start
    answers: list[Any] = []
    wall, cpu = time.perf_counter(), time.process_time()
    seconds = times(lambda: answers.append(iteration()))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {
        "label": contestant.label,
        "triangles": len(brace.triangles),
        "frames_measured": contestant.frames,
        "rounds": len(seconds),
        "prepare_s": prepare,
        "seconds": seconds,
        "cpu_per_wall": cpu / wall,
        "iteration_s": statistics.median(seconds) * FRAMES / contestant.frames,
        "compliance": answers[-1].compliance.tolist(),
        "imported_memory_mib": imported,
        "peak_memory_mib": peak_memory_mib(),
    }


if __name__ == "__main__":
    main()
