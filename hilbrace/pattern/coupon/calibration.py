"""Young's modulus of the rubber, read out of a laboratory's tensile test of a coupon.

The coupon's stiffness is the rubber's modulus times a figure of its shape, which
`hilbrace.pattern.coupon.files` wrote beside it. So the slope of the measured force over the lengthening,
divided by that figure, is the modulus. Only the first pull counts, between two strains: below, the piece
still straightens between its grips; above, struts turn into the pull and the rubber is no longer linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from hilbrace.errors import ConfigError, InputError
from hilbrace.pattern.coupon.curve import LEAST_ROWS, TensileCurve

Array = np.ndarray

WINDOW = (0.02, 0.10)
"""Strains between which the slope is taken [-]."""
RETURN = 0.02
"""Share of the largest lengthening by which the piece may slip back before the first pull counts as over."""
LARGEST_STRAIN = 8.0
"""Rubber tears before this strain [-]: a larger one is a wrong unit."""


@dataclass(frozen=True)
class Calibration:
    """The rubber's modulus.

    Attributes:
        youngs_modulus_mpa: Young's modulus [MPa].
        half_width_mpa: Half of its 95 % confidence interval, by the fit alone [MPa].
        slope_n_per_mm: Measured stiffness of the coupon [N/mm].
        offset_n: Force where the fitted line meets no lengthening [N].
        residual_n: Root mean square of the distances from the line [N].
        bend: How much steeper the upper half of the window is than the lower one, over the slope [-].
        strain: First and last strain used [-].
        rows: First and last row used.
        samples: Rows used.
    """

    youngs_modulus_mpa: float
    half_width_mpa: float
    slope_n_per_mm: float
    offset_n: float
    residual_n: float
    bend: float
    strain: tuple[float, float]
    rows: tuple[int, int]
    samples: int


def calibrate(
    curve: TensileCurve, stiffness: float, gauge_mm: float, window: tuple[float, float] = WINDOW
) -> Calibration:
    """Fit a line to the first pull and read the modulus from its slope.

    The confidence interval is Student's for the slope, with fewer independent samples than rows where
    neighbouring residuals are alike (by their lag-one correlation).

    Args:
        curve: The measurement.
        stiffness: Stiffness of the coupon for a rubber of 1 MPa [N/mm per MPa].
        gauge_mm: Distance of the grips [mm].
        window: Strains between which to fit [-].

    Raises:
        ConfigError: The window is none.
        InputError: The curve does not reach the window, does not rise, or its units cannot be right.
    """
    if not 0.0 <= window[0] < window[1]:
        raise ConfigError(
            f"strains from {window[0]:g} to {window[1]:g} are no window",
            where="calibrate: --from, --to",
            hint="give two rising strains, such as 0.02 and 0.10",
        )
    used = _first_pull(curve, gauge_mm, window)
    x, y = curve.lengthening_mm[used], curve.force_n[used]
    slope, offset = np.polyfit(x, y, 1)
    if not slope > 0.0:
        raise InputError(
            "the force falls while the coupon lengthens",
            where=f"{curve.name}, rows {curve.row[used[0]]} to {curve.row[used[-1]]}",
            hint="give tension and lengthening positive signs",
        )
    residual = y - slope * x - offset
    half = float(_half_width(x, residual))
    middle = len(x) // 2
    halves = [np.polyfit(x[part], y[part], 1)[0] for part in (slice(None, middle), slice(middle, None))]
    return Calibration(
        youngs_modulus_mpa=float(slope / stiffness),
        half_width_mpa=half / stiffness,
        slope_n_per_mm=float(slope),
        offset_n=float(offset),
        residual_n=float(np.sqrt((residual**2).mean())),
        bend=float((halves[1] - halves[0]) / slope),
        strain=(float(x[0] / gauge_mm), float(x[-1] / gauge_mm)),
        rows=(curve.row[used[0]], curve.row[used[-1]]),
        samples=len(used),
    )


def run_file_lines(found: Calibration) -> str:
    """The lines that bring the modulus into a ``run.toml``."""
    return f"[material]\nyoungs_modulus_mpa = {found.youngs_modulus_mpa:.4g}\n"


def _first_pull(curve: TensileCurve, gauge_mm: float, window: tuple[float, float]) -> Array:
    """Places of the samples between two strains before the piece first goes back."""
    length = curve.lengthening_mm - curve.lengthening_mm[0]
    largest = np.maximum.accumulate(length)
    strain = length / gauge_mm
    if strain.max() > LARGEST_STRAIN:
        place = int(np.argmax(strain > LARGEST_STRAIN))
        raise InputError(
            f"a strain of {100 * strain[place]:.0f} % tears any rubber",
            where=f"{curve.name}, row {curve.row[place]}",
            hint="check the unit of the lengthening, and that coupon.json is this coupon's",
        )
    back = np.flatnonzero(largest - length > RETURN * length.max())
    end = int(back[0]) if back.size else len(length)
    used = np.flatnonzero((strain[:end] >= window[0]) & (strain[:end] <= window[1]))
    if len(used) < LEAST_ROWS or np.ptp(strain[used]) < 0.5 * (window[1] - window[0]):
        raise InputError(
            f"the first pull has {len(used)} samples between strains of {100 * window[0]:g} and"
            f" {100 * window[1]:g} %; it reaches {100 * strain[:end].max():.2g} %",
            where=f"{curve.name}, rows {curve.row[0]} to {curve.row[end - 1]}",
            hint=f"pull further or sample faster ({LEAST_ROWS} or more), or check the unit of length",
        )
    return used


def _half_width(x: Float[Array, " sample"], residual: Float[Array, " sample"]) -> float:
    """Half of the 95 % confidence interval of a fitted slope."""
    count = len(x)
    squares = (residual**2).sum()
    if squares <= 0.0:
        return 0.0
    alike = float(np.clip((residual[1:] * residual[:-1]).sum() / squares, 0.0, 0.99))
    effective = max(3.0, count * (1.0 - alike) / (1.0 + alike))
    spread = squares / (count - 2) * (count / effective) / ((x - x.mean()) ** 2).sum()
    return float(student.ppf(0.975, effective - 2.0) * np.sqrt(spread))
