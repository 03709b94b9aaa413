"""How many processors a run may use."""

from __future__ import annotations

import os


def processors() -> int:
    """Processors that this process may run on, or fewer where ``OMP_NUM_THREADS`` says so.

    Work that is spread over them has one thread a job, so that results do not depend on their number.
    """
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    return max(1, min(available, int(asked))) if asked.isdigit() else available
