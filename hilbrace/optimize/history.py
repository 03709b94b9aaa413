"""The course of a design loop: what each iteration leaves, as it runs, as a table and as a picture."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from hilbrace.optimize.design import LOSSES, Design
from hilbrace.run.records import write_atomic

Array = np.ndarray

TRACE = (
    "volume_fraction",
    "frontal_nm_per_deg",
    "sagittal_nm_per_deg",
    "ratio_vs_uniform",
    "firm_share",
    "level",
    "gradient_norm",
    "learning_rate",
    "p_norm",
    "sharpness",
)
"""What is kept of every iteration beside the losses. Stiffnesses are those of the rest posture, the ratio is
that of frontal over sagittal stiffness against the uniform brace of the target volume. The last row, of the
finished field, has no gradient and no step."""


@dataclass(frozen=True)
class Snapshot:
    """The loop after one iteration, for whoever watches it.

    Attributes:
        iteration: Iterations done.
        iterations: Iterations in all.
        terms: Normalised L1..L5 before the iteration's step, in the order of `LOSSES`.
        total: Their weighted sum.
        trace: Columns as `TRACE`.
        d: Design variable at triangle centres [-].
        seconds_left: Estimate of the time that the other iterations take [s].
    """

    iteration: int
    iterations: int
    terms: Float[Array, " loss"]
    total: float
    trace: Float[Array, " column"]
    d: Float[Array, " triangle"]
    seconds_left: float

    def __getitem__(self, column: str) -> float:
        """One column of the trace by its name."""
        return float(self.trace[TRACE.index(column)])


Watch = Callable[[Snapshot], None]
"""Called after every iteration. What it raises ends the loop; the last checkpoint stays."""


def told(snapshot: Snapshot) -> str:
    """A snapshot in one line: losses, stiffness ratio, volume, time left."""
    losses = "  ".join(f"L{place + 1} {value:.3g}" for place, value in enumerate(snapshot.terms))
    return (
        f"total {snapshot.total:.4g}  {losses}  ratio {snapshot['ratio_vs_uniform']:.2f}  "
        f"V {snapshot['volume_fraction']:.3f}  {snapshot.seconds_left:.0f} s left"
    )


def write_history_csv(design: Design, path: Path) -> None:
    """Write normalised losses and trace, one row per iteration; what does not exist is left empty."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    losses = (f"L{index + 1}_{name}" for index, name in enumerate(LOSSES))
    table.writerow(["iteration", *losses, "total", *TRACE])
    for iteration, row in enumerate(np.concatenate([design.history, design.trace], axis=1)):
        table.writerow([iteration, *("" if np.isnan(value) else f"{value:.10g}" for value in row)])
    write_atomic(path, text.getvalue().encode())


def write_history_picture(design: Design, path: Path) -> None:
    """Draw the course of the loop into a PNG file."""
    buffer = io.BytesIO()
    history_picture(design).savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    write_atomic(path, buffer.getvalue())


def history_picture(design: Design) -> Figure:
    """Losses, stiffness ratio, volume fraction and gradient over the iterations."""
    figure = Figure(figsize=(9.6, 6.4), layout="constrained")
    (losses, ratio), (volume, gradient) = figure.subplots(2, 2)
    names = (*(f"L{index + 1} {name.replace('_', ' ')}" for index, name in enumerate(LOSSES)), "total")
    for column, name in enumerate(names):
        losses.plot(design.history[:, column], label=name, linewidth=2.0 if name == "total" else 1.1)
    losses.legend(frameon=False, fontsize=8, ncols=2)
    losses.set_title("losses, normalised", fontsize=10)
    course = dict(zip(TRACE, design.trace.T, strict=True))
    ratio.plot(course["ratio_vs_uniform"], color="tab:green")
    ratio.set_title("frontal / sagittal stiffness against the uniform brace", fontsize=10)
    volume.plot(course["volume_fraction"], color="tab:brown")
    volume.set_title("volume fraction [-]", fontsize=10)
    gradient.semilogy(course["gradient_norm"], color="tab:gray")
    gradient.set_title("norm of the gradient", fontsize=10)
    for axes in (losses, ratio, volume, gradient):
        axes.set_xlabel("iteration")
        axes.spines[["top", "right"]].set_visible(False)
        for changed in np.flatnonzero(np.diff(course["firm_share"])):
            axes.axvline(changed + 1, color="0.8", linewidth=0.8, zorder=0)
    return figure
