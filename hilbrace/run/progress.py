"""Progress of long work: one callback for the stages, one display for people."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Protocol, runtime_checkable

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

Report = Callable[[int, int], None]
"""Called with (done, total) as a stage goes on."""

PLAIN_EVERY_S = 15.0
"""Time between two lines where the output is no terminal [s]."""


@runtime_checkable
class DetailedReport(Protocol):
    """A `Report` that also takes a line about what is going on."""

    def __call__(self, done: int, total: int, detail: str = "") -> None:
        """Tell that ``done`` of ``total`` is done.

        Args:
            done: Steps done.
            total: Steps in all.
            detail: One line for people.
        """
        ...


def silent(done: int, total: int, detail: str = "") -> None:
    """A progress callback that shows nothing."""


@contextlib.contextmanager
def display(console: Console, title: str) -> Iterator[DetailedReport]:
    """Show a bar and a line while a stage works; now and then a plain line where the output is no terminal.

    Args:
        console: Where to write, standard error as a rule.
        title: Name of the stage.
    """
    if not console.is_terminal:
        yield _plain_lines(console, title)
        return
    columns = (
        TextColumn("[bold]{task.description:<9}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
    )
    bars = Progress(*columns, TimeElapsedColumn(), console=console)
    task = bars.add_task(title, total=None)
    with Live(bars, console=console, transient=True, refresh_per_second=8) as live:

        def show(done: int, total: int, detail: str = "") -> None:
            bars.update(task, completed=done, total=total)
            live.update(Group(bars, Text(detail, style="dim", overflow="fold")) if detail else bars)

        yield show


def _plain_lines(console: Console, title: str, clock: Callable[[], float] = time.monotonic) -> DetailedReport:
    """Lines at most every `PLAIN_EVERY_S`, so that short stages have none and logs stay short."""
    last = clock()

    def write(done: int, total: int, detail: str = "") -> None:
        nonlocal last
        now = clock()
        if now - last >= PLAIN_EVERY_S:
            last = now
            console.print(f"{title:<9} {done}/{total}  {detail}".rstrip(), soft_wrap=True, highlight=False)

    return write
