"""Picture of a flat map's distortion: in the map, and on the limb where the pattern will lie."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from hilbrace.domain.distortion import AREA_LIMITS, MapDistortion, area_ratio, map_distortion
from hilbrace.domain.domain import Domain
from hilbrace.report.figures import INK
from hilbrace.report.paint import BACK, FRONT, paint

Array = np.ndarray

LEAST_ANGLE_RANGE = 1.05
"""Upper end of the colours of angles, where no triangle goes beyond [-]: small errors stay pale."""


def map_distortion_picture(domain: Domain) -> Figure:
    """Cell size (upper row) and shear (lower row) in the flat map, and on the limb from front and back."""
    found = map_distortion(domain)
    figure = Figure(figsize=(9.6, 7.2), layout="constrained")
    size = 1.0 / np.sqrt(area_ratio(domain))
    widest = max(1.0 / np.sqrt(AREA_LIMITS[0]), size.max(), 1.0 / size.min())
    rows = (
        ("cell length on the limb / mean", size, LogNorm(1.0 / widest, widest), "PuOr_r", _sizes(found)),
        (
            "singular values of the map, ratio",
            domain.quasi_conformal,
            Normalize(1.0, max(LEAST_ANGLE_RANGE, found.quasi_conformal_p99)),
            "Purples",
            _angles(found),
        ),
    )
    for row, (label, values, norm, palette, text) in enumerate(rows):
        flat = figure.add_subplot(2, 3, 3 * row + 1)
        _in_map(flat, domain, values, norm, palette)
        flat.set_title(text, fontsize=9, color=INK)
        colours = colormaps[palette](norm(values))[:, :3]
        views = (("front", FRONT), ("back", BACK))
        for place, (name, towards) in enumerate(views, start=2):
            limb = figure.add_subplot(2, 3, 3 * row + place)
            paint(limb, domain.vertices, domain.triangles, colours, towards)
            limb.set_title(name, fontsize=9, color=INK)
        axes = figure.axes[-3:]
        bar = figure.colorbar(ScalarMappable(norm, palette), ax=axes, shrink=0.85, pad=0.01)
        bar.set_label(label)
        if row == 0:
            bar.set_ticks([1.0 / widest, 1.0, widest], labels=[f"{1 / widest:.2f}", "1", f"{widest:.2f}"])
            bar.minorticks_off()
    return figure


def _sizes(found: MapDistortion) -> str:
    return f"area ratio {found.map_area_ratio_min:.2f} to {found.map_area_ratio_max:.2f}"


def _angles(found: MapDistortion) -> str:
    flips = f", {found.flipped_triangles} flipped" if found.flipped_triangles else ", none flipped"
    return f"mean {found.quasi_conformal_mean:.3f}, largest {found.quasi_conformal_max:.2f}{flips}"


def _in_map(
    axes: Axes, domain: Domain, values: Float[Array, " triangle"], norm: Normalize, palette: str
) -> None:
    mesh = Triangulation(domain.uv[:, 0], domain.uv[:, 1], domain.cut_triangles)
    axes.tripcolor(mesh, values, cmap=palette, norm=norm, rasterized=True)
    for side, style in ((0, "-"), (1, "--")):
        axes.plot(*domain.uv[domain.seam_pairs[:, side]].T, style, color=INK, linewidth=0.9)
    axes.set(xlabel="u [-]", ylabel="v [-]", aspect="equal")
    axes.spines[["top", "right"]].set_visible(False)
