"""Progress of long work: one callback for the stages, one display for people."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

Report = Callable[[int, int], None]
"""Called with (done, total) as a stage goes on."""


def silent(done: int, total: int) -> None:
    """A progress callback that shows nothing."""


@contextlib.contextmanager
def display(console: Console, title: str) -> Iterator[Report]:
    """Show a bar while a stage works; plain lines where the output is no terminal.

    Args:
        console: Where to write, standard error as a rule.
        title: Name of the stage.
    """
    if not console.is_terminal:
        yield silent
        return
    columns = (
        TextColumn("[bold]{task.description:<9}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
    )
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bars:
        task = bars.add_task(title, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)
