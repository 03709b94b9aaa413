"""Mock devices in processes of their own, and what a source says of them."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from evaluation.sources.stream import Item, MarkerFrame, PlateSamples, Source, SourceEvent, SourceInfo

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def mock(module: str, *options: str | Path, stdin: int | None = None) -> Iterator[int]:
    """A mock server on the loopback address; gives its port."""
    command = [sys.executable, "-m", f"mocks.{module}", *map(str, options)]
    process = subprocess.Popen(
        command, cwd=ROOT, stdin=stdin or subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
    )
    try:
        yield json.loads(process.stdout.readline())["port"]
    finally:
        process.kill()
        process.communicate()


@dataclass
class Heard:
    """Items of a source, sorted by what they are."""

    items: list[Item] = field(default_factory=list)

    @property
    def frames(self) -> list[MarkerFrame]:
        return [item for item in self.items if isinstance(item, MarkerFrame)]

    @property
    def samples(self) -> list[PlateSamples]:
        return [item for item in self.items if isinstance(item, PlateSamples)]

    @property
    def infos(self) -> list[SourceInfo]:
        return [item for item in self.items if isinstance(item, SourceInfo)]

    def events(self, *kinds: str) -> list[SourceEvent]:
        return [item for item in self.items if isinstance(item, SourceEvent) and item.kind in kinds]


def listen(source: Source, enough: Callable[[Heard], bool], seconds: float = 30.0) -> Heard:
    """Read until there is enough."""
    heard = Heard()
    end = time.monotonic() + seconds
    while not enough(heard):
        assert time.monotonic() < end, (
            f"only {len(heard.frames)} frames, {heard.events('disconnected', 'fault')}"
        )
        heard.items += source.read(0.1)
    return heard
