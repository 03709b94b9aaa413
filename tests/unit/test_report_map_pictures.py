"""The picture of a flat map's distortion says what its figures say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.collections import PolyCollection

from hilbrace.domain.distortion import map_distortion
from hilbrace.domain.flatten import quasi_conformal
from hilbrace.report.map_pictures import map_distortion_picture
from tests.unit.flat_sleeve import flattened, opened_sleeve


def test_the_picture_shows_map_and_limb_in_both_rows():
    domain = opened_sleeve(26.0, around=30, along=16)
    figure = map_distortion_picture(domain)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles.count("front") == titles.count("back") == 2
    found = map_distortion(domain)
    assert f"area ratio {found.map_area_ratio_min:.2f} to {found.map_area_ratio_max:.2f}" in titles
    assert any("none flipped" in title for title in titles)
    painted = [c for axes in figure.axes for c in axes.collections if isinstance(c, PolyCollection)]
    assert sum(len(c.get_facecolor()) == len(domain.triangles) for c in painted) >= 4
    figure.draw_without_rendering()


def test_a_sheared_map_says_so():
    made, _ = flattened(opened_sleeve(around=30, along=16), "periodic")
    uv = made.uv * [1.0, 3.0]
    surface = made.vertices[made.weld]
    sheared = replace(made, uv=uv, quasi_conformal=quasi_conformal(surface, uv, made.cut_triangles))
    titles = [axes.get_title() for axes in map_distortion_picture(sheared).axes]
    assert any(title.startswith("mean 3.0") or title.startswith("mean 2.9") for title in titles)
    assert np.ptp(sheared.quasi_conformal) < 0.5
