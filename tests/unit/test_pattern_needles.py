"""A lone vertex that is barely solid makes a needle on the border; it goes, and nothing else does."""

from __future__ import annotations

import numpy as np

from hilbrace.pattern.border import border, hole_numbers, strut_widths
from hilbrace.pattern.clip import zero_line
from hilbrace.pattern.mend import trim_needles
from hilbrace.pattern.refine import refine
from tests.unit.sleeve import sleeve_domain


def _widths(skin, line):
    edge = border(skin, line, hole_numbers(skin, line))
    return edge, strut_widths(edge, 6.0)


def test_a_needle_is_cut_off_and_the_strut_stays():
    domain = sleeve_domain()
    skin = refine(domain, 1.0)
    middle = 0.5 * (skin.vertices[:, 1].min() + skin.vertices[:, 1].max())
    depth = 2.0 - np.abs(skin.vertices[:, 1] - middle)
    solid = depth > 0
    beside = np.zeros(len(depth), dtype=bool)
    mixed = skin.edges[solid[skin.edges[:, 0]] != solid[skin.edges[:, 1]]]
    beside[mixed.ravel()] = True
    tip = np.flatnonzero(beside & ~solid)[0]
    planted = depth.copy()
    planted[tip] = 0.02
    line = zero_line(skin, planted)
    edge, widths = _widths(skin, line)
    assert widths.min() < 1.0
    mended = trim_needles(skin, line, edge.middle[widths < 1.0], 2.0)
    changed = np.flatnonzero((mended > 0) != (line.depth > 0))
    assert tip in changed
    assert np.linalg.norm(skin.vertices[changed] - skin.vertices[tip], axis=1).max() < 3.0
    assert _widths(skin, zero_line(skin, mended))[1].min() > 1.0
