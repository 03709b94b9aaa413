"""Table and plot of the shell benchmark, from its JSON: ``python -m tests.bench.show_shell``.

The table is written into the README between two marks, and a test holds the README to the JSON.
"""

from __future__ import annotations

import json
import sys
import textwrap
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from tests.bench.bench_shell import RESULTS, ROOT, TASKS
from tests.bench.contestants import OWN_TASKS, TORCH_FEM
from tests.bench.knee_brace import FRAMES

JSON = RESULTS / "shell.json"
PLOT = RESULTS / "shell_growth.svg"
README = ROOT / "README.md"
BEGIN = "<!-- shell benchmark: made by tests/bench/show_shell.py -->"
END = "<!-- end of shell benchmark -->"
SOLVERS = {"pardiso": "MKL PARDISO", "cholespy": "cholespy", "scipy": "scipy"}
GOALS_S = {"pattern": 0.15, "loads": 0.25, "clusters:9": 0.8, "frame": 3.3}
GOALS_RATIO = {"spsolve": 300, "splu": 3, **dict.fromkeys(TORCH_FEM, 1000)}
BUSY = 0.85
"""A program that had less of one core than this share had to wait for others [-]."""
COLOURS = {"pardiso": "#0072b2", "cholespy": "#d55e00", "scipy": "#555555"}


def main() -> None:
    """Write the plot and the README's section."""
    run = json.loads(JSON.read_text())
    draw(run, PLOT)
    README.write_text(replaced(README.read_text(), section(run)))
    sys.stdout.write(verdict(run))


def replaced(readme: str, made: str) -> str:
    """The README with the section between the marks exchanged."""
    head, rest = readme.split(BEGIN)
    _, tail = rest.split(END)
    return f"{head}{BEGIN}\n{made}{END}{tail}"


def section(run: dict[str, Any]) -> str:
    """The README's section: both tables, what they say, and where they were measured."""
    own = {row["name"]: row for row in run["own"] if "missing" not in row}
    backends = list(dict.fromkeys(name.split("@")[1] for name in own))
    return "\n".join(
        [
            _heading(own),
            "",
            *_own_table(own, backends),
            "",
            *_peer_table(run, own, backends[0]),
            "",
            f"![Time and memory against the number of triangles]({PLOT.relative_to(ROOT)})",
            "",
            _where(run),
            "",
        ]
    )


def _heading(own: dict[str, Any]) -> str:
    triangles = next(iter(own.values()))["triangles"]
    return _wrapped(
        f"One optimizer iteration on one knee brace of {triangles} triangles and a motion of 45 frames: the"
        " compliances and their exact gradient; ours gives reactions and loop stiffness as well. Medians [s]."
    )


def _own_table(own: dict[str, Any], backends: list[str]) -> list[str]:
    lines = [
        f"| hilbrace | {' | '.join(SOLVERS[name] for name in backends)} |",
        f"|---|{'---|' * len(backends)}",
    ]
    for task in TASKS:
        cells = [_seconds(own.get(f"{task}@{name}")) for name in backends]
        lines.append(f"| {OWN_TASKS[task]} | {' | '.join(cells)} |")
    return lines


def _peer_table(run: dict[str, Any], own: dict[str, Any], best: str) -> list[str]:
    pattern, loads = own[f"pattern@{best}"], own[f"loads@{best}"]
    lines = [
        "| others, same brace and run | s | times our 45 free loads | times our one load pattern"
        " | compliance differs by |",
        "|---|---|---|---|---|",
    ]
    for row in run["peers"]:
        if "missing" in row:
            continue
        seconds = row["iteration_s"]
        few = "" if row["frames_measured"] == len(loads["compliance"]) else " \\*"
        lines.append(
            f"| {row['label']} | {_digits(seconds)}{few} | {_ratio(seconds / loads['iteration_s'])}"
            f" | {_ratio(seconds / pattern['iteration_s'])} | {_percent(difference(row, loads))} |"
        )
    few = {row["frames_measured"] for row in run["peers"] if "missing" not in row} - {FRAMES}
    notes = [
        f"\\* {some} frames measured, times {FRAMES / some:g}: each frame starts anew."
        for some in sorted(few)
    ]
    return [*lines, "", *notes, f"Against our times with {SOLVERS[best]}."]


def _where(run: dict[str, Any]) -> str:
    machine = run["machine"]
    busy = " Other programs ran at the same time, so that all times are too long." if waited(run) else ""
    versions = ", ".join(f"{name} {is_}" for name, is_ in machine["versions"].items() if is_)
    return _wrapped(
        f"Measured on {machine['date']} on {machine['cores']} cores of an {machine['processor']} with"
        f" {machine['memory_gib']} GiB; Python {machine['python']}, {versions}.{busy} `make bench`"
        " measures anew and rewrites this section."
    )


def _wrapped(words: str) -> str:
    return textwrap.fill(words, 115, break_long_words=False, break_on_hyphens=False)


def difference(row: dict[str, Any], own: dict[str, Any]) -> float:
    """Largest relative difference of the compliances that both have."""
    theirs = np.array(row["compliance"])
    ours = np.array(own["compliance"])[: len(theirs)]
    return float(np.abs(theirs / ours - 1).max())


def verdict(run: dict[str, Any]) -> str:
    """Seconds and ratios of a run beside the goals, in lines."""
    own = {row["name"].split("@")[0]: row["iteration_s"] for row in reversed(run["own"]) if "seconds" in row}
    lines = [f"{task}: {own[task]:.3f} s, goal {goal} s" for task, goal in GOALS_S.items()]
    for row in run["peers"]:
        if "missing" in row:
            lines.append(f"{row['name']}: left out, {row['missing']}")
            continue
        goal, against = GOALS_RATIO.get(row["name"], "none"), row["iteration_s"]
        lines.append(
            f"{row['name']}: {against / own['loads']:.1f} times 45 free loads,"
            f" {against / own['pattern']:.1f} times one pattern, goal {goal}"
        )
    if waiting := waited(run):
        lines.append(
            f"other programs kept the cores: measure again on an idle machine ({', '.join(waiting)})"
        )
    return "\n".join(lines) + "\n"


def waited(run: dict[str, Any]) -> list[str]:
    """What was measured while other programs kept the cores."""
    return [row["name"] for row in run["own"] + run["peers"] if row.get("cpu_per_wall", 1.0) < BUSY]


def _seconds(row: dict[str, Any] | None) -> str:
    return "-" if row is None else _digits(row["iteration_s"])


def _digits(number: float) -> str:
    """Two digits, or all before the point."""
    return f"{number:.0f}" if number >= 10 else f"{number:.2g}" if number < 1 else f"{number:.1f}"


def _ratio(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.1f}"


def _percent(share: float) -> str:
    return "below 0.01 %" if share < 1e-4 else f"{100 * share:.2f} %"


PANELS = {
    "iteration_s": "one iteration, 45 free loads [s]",
    "factor_s": "factorisation [s]",
    "solve_s": "57 solves [s]",
    "peak_memory_mib": "peak memory, all of Python [GiB]",
}


def draw(run: dict[str, Any], path: Path) -> None:
    """Four small plots over the number of triangles, one line for each solver."""
    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    rows = [row for row in run["growth"] if "missing" not in row]
    for axis, (key, title) in zip(axes.flat, PANELS.items(), strict=True):
        for name in dict.fromkeys(row["name"] for row in rows):
            mine = [row for row in rows if row["name"] == name]
            scale = 1024 if key.endswith("_mib") else 1
            axis.loglog(
                [row["triangles"] for row in mine],
                [row[key] / scale for row in mine],
                "o-",
                color=COLOURS[name],
                label=SOLVERS[name],
                markersize=4,
            )
        axis.set_title(title, loc="left", fontsize=9)
        axis.grid(True, which="major", color="#dddddd")
        axis.spines[["top", "right"]].set_visible(False)
    _ticks(axes, sorted({row["triangles"] for row in rows}))
    axes[0, 0].legend(frameon=False, loc="upper left")
    figure.suptitle(_message(rows), x=0.01, ha="left", fontsize=11)
    with matplotlib.rc_context({"svg.hashsalt": "hilbrace"}):
        figure.savefig(path, metadata={"Date": None})


def _ticks(axes: Any, sizes: list[int]) -> None:
    """Every mesh has its tick, and values read as numbers instead of powers."""
    for axis in axes.flat:
        axis.set_xticks(sizes, [f"{size / 1000:.0f}k" for size in sizes])
        axis.set_xticks([], minor=True)
        low, high = axis.get_ylim()
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 30 * low else (1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.yaxis.set_minor_formatter(lambda *_: "")
    for axis in axes[-1]:
        axis.set_xlabel("triangles")


def _message(rows: list[dict[str, Any]]) -> str:
    """What the plot says: how the time of the preferred solver grows."""
    name = rows[0]["name"]
    mine = [row for row in rows if row["name"] == name]
    size, seconds = (np.log([row[key] for row in mine]) for key in ("triangles", "iteration_s"))
    power = np.polyfit(size, seconds, 1)[0]
    return f"An iteration by {SOLVERS[name]} grows with the power {power:.2f} of the number of triangles"


if __name__ == "__main__":
    main()
