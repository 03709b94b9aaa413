"""What the motion does to the mesh of the brace, frame by frame: stretch, folds and self-intersections."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from hilbrace.body.crossings import crossing_triangles
from hilbrace.domain.deformation import folded
from hilbrace.run.records import write_atomic

Array = np.ndarray

LEAST_AREA, MOST_AREA = 0.25, 2.2
"""Area ratios between which the skin's motion is trusted [-]."""


@dataclass(frozen=True)
class FrameReport:
    """Figures of each frame.

    Attributes:
        time: Instants [s].
        area_ratio_min: Least area of a triangle against rest [-].
        area_ratio_max: Largest area of a triangle against rest [-].
        stretch_min: Least principal stretch [-].
        stretch_max: Largest principal stretch [-].
        folded: Triangles that the motion folds over a neighbour.
        crossing: Triangles that pass through, or touch, others.
    """

    time: Float[Array, " frame"]
    area_ratio_min: Float[Array, " frame"]
    area_ratio_max: Float[Array, " frame"]
    stretch_min: Float[Array, " frame"]
    stretch_max: Float[Array, " frame"]
    folded: Int[Array, " frame"]
    crossing: Int[Array, " frame"]

    def figures(self) -> dict[str, float | int]:
        """The worst of each over all frames, for ``metrics.json``."""
        trusted = (self.area_ratio_min >= LEAST_AREA) & (self.area_ratio_max <= MOST_AREA)
        return {
            "stretch_max": round(float(self.stretch_max.max()), 4),
            "folded_triangles_max": int(self.folded.max()),
            "crossing_triangles_max": int(self.crossing.max()),
            "frames_with_crossings": int((self.crossing > 0).sum()),
            "frames_outside_area_limits": int((~trusted).sum()),
        }


def report_frames(
    rest: Float[Array, "vertex 3"],
    posed: Float[Array, "frame vertex 3"],
    triangles: Int[Array, "triangle 3"],
    deformation: Float[Array, "frame triangle 2 2"],
    time: Float[Array, " frame"],
) -> FrameReport:
    """Inspect the posed mesh of every frame.

    Args:
        rest: Vertices at rest.
        posed: Vertices in each frame.
        triangles: Vertex indices.
        deformation: Deformation gradients of the triangles, see `hilbrace.domain.deformation`.
        time: Instants [s].
    """
    area = np.linalg.det(deformation)
    stretch = np.linalg.svd(deformation, compute_uv=False)
    return FrameReport(
        time=time,
        area_ratio_min=area.min(axis=1),
        area_ratio_max=area.max(axis=1),
        stretch_min=stretch.min(axis=(1, 2)),
        stretch_max=stretch.max(axis=(1, 2)),
        folded=folded(rest, posed, triangles).sum(axis=1),
        crossing=np.array([int(crossing_triangles(points, triangles).sum()) for points in posed]),
    )


def write_frame_report(report: FrameReport, path: Path) -> None:
    """Write the figures of each frame as a table (CSV), ratios and stretches without unit."""
    names = ("area_ratio_min", "area_ratio_max", "stretch_min", "stretch_max")
    counts = ("folded", "crossing")
    lines = [",".join(["time_s", *names, *(f"{name}_triangles" for name in counts)])]
    for k, instant in enumerate(report.time):
        ratios = [f"{getattr(report, name)[k]:.4f}" for name in names]
        lines.append(",".join([f"{instant:.4f}", *ratios, *(str(getattr(report, n)[k]) for n in counts)]))
    write_atomic(path, ("\n".join(lines) + "\n").encode("ascii"))
