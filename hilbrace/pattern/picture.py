"""How wide the struts are: a histogram, and colours for a map of them on the solid."""

from __future__ import annotations

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from hilbrace.pattern.clip import triangle_areas
from hilbrace.pattern.pattern import Pattern, Solid

Array = np.ndarray

_BINS = 40
_FIRM, _SOFT = "#1f6f8b", "#e08e45"
_TOP = 0.99


def strut_width_histogram(pattern: Pattern, min_strut_mm: float) -> Figure:
    """Share of the struts' area by their width, firm and soft apart, with the least width asked for.

    Args:
        pattern: The struts on the skin.
        min_strut_mm: Least width of a strut [mm].
    """
    width, area = _widths_and_areas(pattern)
    firm = pattern.firm[pattern.triangles].mean(axis=1) > 0.5
    top = max(float(np.quantile(width, _TOP)), 2.0 * min_strut_mm)
    figure = Figure(figsize=(5.2, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.hist(
        [np.minimum(width[firm], top), np.minimum(width[~firm], top)],
        bins=[0.8 * min_strut_mm, *np.linspace(min_strut_mm, top, _BINS)],
        weights=[100 * area[firm] / area.sum(), 100 * area[~firm] / area.sum()],
        stacked=True,
        color=[_FIRM, _SOFT],
        label=["firm", "soft"],
    )
    axes.axvline(min_strut_mm, color="black", linewidth=1.0, linestyle="--", label="least asked for")
    axes.set(xlabel="width of struts, bands and nodes [mm]", ylabel="share of their area [%]")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    return figure


def strut_width_colours(solid: Solid, min_strut_mm: float) -> Float[Array, "triangle 3"]:
    """A colour for each triangle of the solid: dark at the least width, bright at three times of it.

    Args:
        solid: The solid, with the width of its struts.
        min_strut_mm: Least width of a strut [mm].
    """
    width = solid.strut_width_mm[solid.triangles].mean(axis=1)
    share = np.clip((width / min_strut_mm - 1.0) / 2.0, 0.0, 1.0)
    return np.asarray(matplotlib.colormaps["viridis"](share))[:, :3]


def _widths_and_areas(pattern: Pattern) -> tuple[Float[Array, " triangle"], Float[Array, " triangle"]]:
    width = pattern.strut_width_mm[pattern.triangles].mean(axis=1)
    return width, triangle_areas(pattern.vertices, pattern.triangles)
