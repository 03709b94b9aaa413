"""The files of a test piece: its body, its figures, its predicted line, and a picture of both.

``coupon.json`` holds what `hilbrace cells calibrate` needs to know of the piece that was pulled.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from hilbrace.errors import InputError
from hilbrace.pattern.coupon.piece import CouponPlan, Sheet, coupon_body, lattice, volume_fraction
from hilbrace.pattern.coupon.stiffness import (
    STRAIN_LIMIT,
    CouponPrediction,
    DetailedStiffness,
    detailed_stiffness,
    force_line,
    predict,
)
from hilbrace.pattern.export import write_surface
from hilbrace.run.records import write_atomic

Array = np.ndarray

INK, RUBBER, GRIP = "#22313f", "#5c8cb8", "#b8c4cf"


@dataclass(frozen=True)
class CouponFigures:
    """What ``coupon.json`` says of a test piece.

    Attributes:
        plan: The test piece.
        stiffness: Stiffness for a rubber of 1 MPa, homogenized [N/mm per MPa].
        stiffness_every_strut: The same with every strut meshed; ``None`` where that was left out.
    """

    plan: CouponPlan
    stiffness: float
    stiffness_every_strut: float | None

    @property
    def best(self) -> float:
        """The stiffness that knows most of the piece: that of every strut where there is one."""
        return self.stiffness if self.stiffness_every_strut is None else self.stiffness_every_strut


def write_coupon(
    plan: CouponPlan, folder: Path, modulus_mpa: float, poisson: float, every_strut: bool = True
) -> dict[str, Any]:
    """Write ``coupon.stl``, ``coupon.json``, ``coupon_line.csv`` and ``coupon.png``.

    Args:
        plan: The test piece.
        folder: Where to write; made if it is not there.
        modulus_mpa: Young's modulus of the rubber, for the line [MPa].
        poisson: Its Poisson's ratio [-].
        every_strut: Also compute the stiffness with every strut, which takes seconds to a minute.

    Returns:
        The figures as ``coupon.json`` holds them, and the names of the files.

    Raises:
        ConfigError: The plan makes no test piece, or no cell has this name.
        GeometryError: The struts do not hang together between the grips.
    """
    sheet = lattice(plan)
    vertices, triangles = coupon_body(plan, sheet)
    prediction = predict(plan, poisson)
    detailed = detailed_stiffness(plan, poisson) if every_strut else None
    line = force_line(plan, prediction, modulus_mpa)
    figures = _figures(plan, sheet, prediction, detailed, modulus_mpa, poisson)
    folder.mkdir(parents=True, exist_ok=True)
    write_surface(folder / "coupon.stl", vertices, triangles)
    write_atomic(folder / "coupon.json", (json.dumps(figures, indent=1) + "\n").encode())
    rows = ["lengthening_mm,strain,force_n", *(",".join(f"{value:.6g}" for value in row) for row in line)]
    write_atomic(folder / "coupon_line.csv", ("\n".join(rows) + "\n").encode())
    picture = coupon_picture(plan, sheet, prediction, detailed, modulus_mpa)
    picture.savefig(folder / "coupon.png", dpi=130, metadata={"Software": None})
    names = ("coupon.stl", "coupon.json", "coupon_line.csv", "coupon.png")
    return {**figures, "files": [str(folder / name) for name in names]}


def read_coupon(path: Path) -> CouponFigures:
    """Read ``coupon.json``.

    Raises:
        InputError: The file is not there or is no such file.
    """
    try:
        content = json.loads(path.read_text("utf-8"))
        plan = CouponPlan(**content["plan"])
        detailed = content["stiffness_every_strut_n_per_mm_per_mpa"]
        stiffness = float(content["stiffness_n_per_mm_per_mpa"])
        return CouponFigures(plan, stiffness, None if detailed is None else float(detailed))
    except OSError:
        raise InputError(
            "the figures of the coupon are not there",
            where=str(path),
            hint="name the coupon.json that 'hilbrace cells coupon' wrote: --coupon FOLDER/coupon.json",
        ) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(
            "no figures of a coupon",
            where=str(path),
            hint="write it again: hilbrace cells coupon CELL --out DIR",
        ) from None


def coupon_picture(
    plan: CouponPlan,
    sheet: Sheet,
    prediction: CouponPrediction,
    detailed: DetailedStiffness | None,
    modulus_mpa: float,
) -> Figure:
    """The test piece, and the force that pulls it."""
    figure = Figure(figsize=(8.6, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.4))
    _draw(left, sheet)
    left.set_title(
        f"{plan.cell}, d = {plan.d:g}\nstruts {prediction.strut_mm:.1f} mm, {plan.thickness_mm:g} mm thick",
        fontsize=9,
        color=INK,
    )
    line = force_line(plan, prediction, modulus_mpa)
    right.plot(100 * line[:, 1], line[:, 2], color="#2a6f97", linewidth=2, label="homogenized")
    if detailed is not None:
        ratio = detailed.stiffness / prediction.stiffness
        right.plot(
            100 * line[:, 1],
            ratio * line[:, 2],
            "--",
            color="#c8553d",
            label=f"every strut meshed ({100 * (ratio - 1):+.1f} %)",
        )
    right.set(
        xlabel=f"strain between the grips [%], to {100 * STRAIN_LIMIT:g} %",
        ylabel=f"force [N], rubber of {modulus_mpa:g} MPa",
        xlim=(0, 100 * STRAIN_LIMIT),
    )
    right.set_ylim(bottom=0)
    right.legend(frameon=False)
    right.spines[["top", "right"]].set_visible(False)
    right.grid(color="#e3e8eb", linewidth=0.6)
    return figure


def _draw(axes: Axes, sheet: Sheet) -> None:
    for part, colour in ((~sheet.grip, RUBBER), (sheet.grip, GRIP)):
        mesh = Triangulation(sheet.vertices[:, 0], sheet.vertices[:, 1], sheet.triangles[part])
        axes.tripcolor(mesh, np.zeros(int(part.sum())), cmap=ListedColormap([colour]), rasterized=True)
    axes.set_aspect("equal")
    axes.set(xlabel="mm")
    axes.spines[["top", "right"]].set_visible(False)


def _figures(
    plan: CouponPlan,
    sheet: Sheet,
    prediction: CouponPrediction,
    detailed: DetailedStiffness | None,
    modulus_mpa: float,
    poisson: float,
) -> dict[str, Any]:
    def rounded(value: float) -> float:
        return float(f"{value:.6g}")

    return {
        "plan": asdict(plan),
        "gauge_mm": plan.gauge_mm,
        "width_mm": plan.width_mm,
        "strut_mm": rounded(prediction.strut_mm),
        "volume_fraction": rounded(prediction.volume_fraction),
        "volume_fraction_plate": rounded(volume_fraction(sheet, plan)),
        "poisson": poisson,
        "youngs_modulus_mpa": modulus_mpa,
        "effective_modulus_mpa": rounded(modulus_mpa * prediction.modulus),
        "stiffness_n_per_mm_per_mpa": rounded(prediction.stiffness),
        "stiffness_every_strut_n_per_mm_per_mpa": rounded(detailed.stiffness) if detailed else None,
        "every_strut_over_homogenized": round(detailed.stiffness / prediction.stiffness, 4)
        if detailed
        else None,
        "mesh_error": round(detailed.mesh_error, 4) if detailed else None,
        "strain_limit": STRAIN_LIMIT,
    }
