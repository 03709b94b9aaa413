"""Mock devices in processes of their own, as tests of the live laboratory need them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

LAB = """\
name = "Live"
subject = "nobody"
synthetic = true
baseline = "Unbraced"
{standing}

[[conditions]]
name = "Unbraced"

[[conditions]]
name = "Optimized"

[protocol]
side = "left"
hip = {{ model = "marker" }}
"""


class Mock:
    """A mock's process and where it listens."""

    def __init__(self, process: subprocess.Popen, port: int) -> None:
        self.process, self.port = process, port

    @property
    def address(self) -> str:
        return f"vicon://127.0.0.1:{self.port}"

    def advance(self, frames: int) -> None:
        """Let a patient mock send so many more frames."""
        self.process.stdin.write("\n" * frames)
        self.process.stdin.flush()


@contextmanager
def vicon(*words: str) -> Iterator[Mock]:
    """A Vicon system that plays what the words say."""
    process = subprocess.Popen(
        [sys.executable, "-m", "mocks.vicon_server", *words],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    try:
        yield Mock(process, json.loads(process.stdout.readline())["port"])
    finally:
        process.kill()
        process.communicate()


def wait_for(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait until something holds; a busy machine gets plenty of time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)
