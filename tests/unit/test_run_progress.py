"""What people see of long work: a bar and a line on a terminal, a few plain lines elsewhere."""

from __future__ import annotations

import io

from rich.console import Console

from hilbrace.run import progress
from hilbrace.run.progress import DetailedReport, display, silent


def _written(**options: object) -> tuple[io.StringIO, Console]:
    stream = io.StringIO()
    return stream, Console(file=stream, width=200, **options)


def test_a_terminal_shows_the_bar_and_what_is_going_on():
    stream, console = _written(force_terminal=True)
    with display(console, "optimize") as report:
        report(30, 120, "total 0.5  L1 0.9  ratio 6.10  12 s left")
    text = stream.getvalue()
    for word in ("optimize", "25 %", "ratio 6.10", "12 s left"):
        assert word in text


def test_elsewhere_lines_are_plain_and_sparse():
    stream, console = _written(force_terminal=False)
    now = [0.0]
    report = progress._plain_lines(console, "optimize", lambda: now[0])
    for done in range(1, 241):
        now[0] += 0.25
        report(done, 240, "total 0.5")
    lines = stream.getvalue().splitlines()
    assert len(lines) == 60 // progress.PLAIN_EVERY_S
    assert lines[0] == "optimize  60/240  total 0.5"
    assert "\x1b" not in stream.getvalue()


def test_short_work_leaves_no_line_and_a_quiet_console_none_at_all():
    for quiet in (False, True):
        stream, console = _written(force_terminal=False, quiet=quiet)
        with display(console, "body") as report:
            report(1, 2)
        assert stream.getvalue() == ""


def test_reports_with_and_without_a_detail_are_one_kind():
    assert isinstance(silent, DetailedReport)
    silent(1, 2)
    silent(1, 2, "detail")
