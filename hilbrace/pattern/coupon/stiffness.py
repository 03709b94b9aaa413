"""What force pulls a test piece: predicted from the cell's homogenized stiffness, and with every strut.

Both are computed by the shell of the braces, for a rubber of unit modulus, between rigid grips. They differ
by what homogenization leaves out: a plate of a few cells ends in free edges and in grips, where the struts do
not bend as in an endless sheet. `edge_study` tells how that fades with more cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hilbrace.material.cell_figures import cell_samples
from hilbrace.material.curves import load_curves
from hilbrace.material.homogenize import directional_modulus, with_poisson
from hilbrace.pattern.coupon.piece import CouponPlan, Sheet, check_plan, lattice, plate, strut_steps
from hilbrace.shell import brace_stiffness, orthotropic

Array = np.ndarray

GRIP = 1e6
"""Modulus of the grips over that of the rubber [-]: clamps are rigid, and even a short grip must not bend."""
PLATE_STEPS = 6
"""Steps of the mesh in a cell of the uniform sheet."""
STRAIN_LIMIT = 0.10
"""Strain up to which the line is given [-]: beyond, struts straighten and rubber stiffens."""


@dataclass(frozen=True)
class CouponPrediction:
    """A test piece under a small pull, for a rubber of 1 MPa.

    Attributes:
        stiffness: Force per lengthening of the plate between its grips [N/mm per MPa].
        modulus: Effective Young's modulus along the pull over the rubber's, of an endless sheet [-].
        volume_fraction: Rubber in the sheet [-].
        strut_mm: Width of the struts [mm].
    """

    stiffness: float
    modulus: float
    volume_fraction: float
    strut_mm: float


@dataclass(frozen=True)
class DetailedStiffness:
    """The stiffness of a test piece with every strut meshed.

    Attributes:
        stiffness: Force per lengthening, extrapolated to a mesh of no size [N/mm per MPa].
        mesh_error: Stiffness by the finer of the two meshes over that, less 1 [-].
        steps: Steps of the finer mesh in a cell.
    """

    stiffness: float
    mesh_error: float
    steps: int


def predict(plan: CouponPlan, poisson: float = 0.45) -> CouponPrediction:
    """The test piece as a uniform sheet with the homogenized stiffness of its cell.

    Args:
        plan: The test piece.
        poisson: Poisson's ratio of the rubber [-].

    Raises:
        ConfigError: The plan makes no test piece, or no cell has this name.
    """
    sheet = plate(_briefly_held(plan, PLATE_STEPS), PLATE_STEPS)
    membrane, volume = sheet_stiffness(plan, poisson)
    return CouponPrediction(
        stiffness=_stretch(sheet, plan, membrane, poisson),
        modulus=float(directional_modulus(membrane, np.zeros(1))[0]),
        volume_fraction=volume,
        strut_mm=plan.strut_mm,
    )


def sheet_stiffness(plan: CouponPlan, poisson: float) -> tuple[Float[Array, "3 3"], float]:
    """Homogenized stiffness, axis 1 along the pull, for unit modulus, and volume fraction of the sheet."""
    samples = cell_samples(plan.cell)
    width = load_curves(plan.cell).width(plan.d)
    volume = float(np.interp(width, samples.width, samples.volume))
    stiffness = with_poisson(samples.stiffness_at(volume), samples.poisson, poisson)
    turn = [0, 1, 2] if plan.along == "u" else [1, 0, 2]
    return stiffness[np.ix_(turn, turn)], volume


def detailed_stiffness(
    plan: CouponPlan, poisson: float = 0.45, steps: int | None = None
) -> DetailedStiffness:
    """The test piece with every strut meshed.

    In its plane the element is one of constant strain, which is too stiff for struts that bend, by the square
    of its size. So the piece is computed twice and extrapolated to a mesh of no size (Richardson 1911).

    Args:
        plan: The test piece.
        poisson: Poisson's ratio of the rubber [-].
        steps: Steps of the coarser mesh in a cell; enough for the struts if left out.
    """
    check_plan(plan)
    coarse = strut_steps(plan) if steps is None else steps
    fine = coarse + coarse // 2
    found = [
        _stretch(lattice(_briefly_held(plan, each), each), plan, None, poisson) for each in (coarse, fine)
    ]
    limit = found[1] - (found[0] - found[1]) / ((fine / coarse) ** 2 - 1.0)
    return DetailedStiffness(limit, found[1] / limit - 1.0, fine)


def edge_study(
    plan: CouponPlan, across: Sequence[int], poisson: float = 0.45, steps: int | None = None
) -> list[tuple[int, float]]:
    """Stiffness with every strut over the predicted one, for plates of more and more cells.

    Args:
        plan: The test piece; each plate is twice as long as wide.
        across: Cells from one free edge to the other.
        poisson: Poisson's ratio of the rubber [-].
        steps: Steps of the mesh in a cell.

    Returns:
        Cells across, and the ratio.
    """
    ratios = []
    for cells in across:
        each = replace(plan, across=cells, length=2 * cells)
        detailed = detailed_stiffness(each, poisson, steps).stiffness
        ratios.append((cells, detailed / predict(each, poisson).stiffness))
    return ratios


def force_line(
    plan: CouponPlan, prediction: CouponPrediction, modulus_mpa: float, count: int = 11
) -> Float[Array, "point 3"]:
    """The predicted line: lengthening [mm], strain [-] and force [N], up to `STRAIN_LIMIT`.

    Args:
        plan: The test piece.
        prediction: Its prediction.
        modulus_mpa: Young's modulus of the rubber [MPa].
        count: Points.
    """
    strain = np.linspace(0.0, STRAIN_LIMIT, count)
    lengthening = strain * plan.gauge_mm
    return np.stack([lengthening, strain, modulus_mpa * prediction.stiffness * lengthening], axis=1)


def _briefly_held(plan: CouponPlan, steps: int) -> CouponPlan:
    """The test piece with the shortest grips that the mesh can show: rigid ones are alike at any length."""
    pin = max(2.0, 5.0 * plan.cell_mm / steps)
    return replace(plan, pin_mm=pin, grip_mm=2.0 * pin)


def _stretch(sheet: Sheet, plan: CouponPlan, membrane: Float[Array, "3 3"] | None, poisson: float) -> float:
    """Force per lengthening for unit modulus [N/mm]; isotropic rubber where no sheet's stiffness is given."""
    modulus = np.where(sheet.grip, GRIP, 1.0)
    wall = poisson
    if membrane is not None:
        rubber = np.array([[1.0, poisson, 0.0], [poisson, 1.0, 0.0], [0.0, 0.0, (1.0 - poisson) / 2.0]])
        each = np.where(sheet.grip[:, None, None], rubber / (1.0 - poisson**2), membrane)
        wall = orthotropic(each, np.array([[0.0, 1.0, 0.0]]))
    found = brace_stiffness(
        sheet.vertices,
        sheet.triangles,
        modulus,
        thickness_mm=plan.thickness_mm,
        wall=wall,
        centre=np.zeros(3),
        loops=(sheet.upper_pin, sheet.lower_pin),
    )
    return found.stretch_n_per_mm
