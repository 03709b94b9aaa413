from __future__ import annotations

import numpy as np
import pytest

from hilbrace.domain.edges import edges_at
from hilbrace.domain.limb import Surface, find_limb, limb_skin
from hilbrace.domain.loops import enclosed_area, loops_of
from hilbrace.domain.region import cut_region
from hilbrace.domain.rest import rest_domain
from hilbrace.domain.seam import find_seam
from hilbrace.domain.windows import PATELLA_MM, find_windows, open_windows
from hilbrace.errors import ConfigError, GeometryError, HilbraceError
from hilbrace.shell.boundary import end_loops
from tests.unit.domain_body import domain_settings, synthetic_body


def opened(joint="knee", side="right", above=None, edge_mm=8.0, windows=None):
    body = synthetic_body()
    wanted = domain_settings(joint=joint, side=side, above=above, windows=windows).windows
    limb = find_limb(body, joint, side)
    skin = limb_skin(body, limb)
    region = cut_region(skin, limb, edges_at(limb, above, None), edge_mm)
    return limb, open_windows(region, limb, find_windows(skin, limb, region, wanted))


def refuse(kind: type[HilbraceError], *words: str, **keys):
    with pytest.raises(kind) as caught:
        opened(**keys)
    for word in words:
        assert word in caught.value.two_lines()


def test_the_patella_window_is_the_ellipse_of_its_size():
    limb, sleeve = opened(windows=[{"at": "patella"}])
    loops = loops_of(sleeve, limb)
    assert len(loops.windows) == 1
    points = sleeve.vertices[loops.windows[0]]
    width, height = PATELLA_MM
    assert np.isclose(np.ptp(points[:, 1]), height, rtol=0.05)
    assert np.isclose(np.ptp(points[:, 2]), width, rtol=0.08)
    assert (points[:, 0] > 20.0).all()
    # Smooth: no corner of its edge turns by more than 35 degrees.
    step = np.roll(points, -1, axis=0) - points
    step = step[np.linalg.norm(step, axis=1) > 1.0]
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    assert np.degrees(np.arccos((step * np.roll(step, 1, axis=0)).sum(axis=1))).max() < 35.0


@pytest.mark.parametrize("side", ["left", "right"])
def test_windows_are_never_taken_for_ends_here_or_by_the_shell(side):
    for joint, windows in (("knee", [{"at": "patella"}]), ("ankle", None)):
        wanted = domain_settings(joint=joint, side=side, triangles=1500, windows=windows)
        rest = rest_domain(synthetic_body(), wanted)
        ends = end_loops(rest.surface.vertices, rest.surface.triangles, np.array([0.0, 1.0, 0.0]))
        assert set(ends[0]) == set(rest.loops.upper)
        assert set(ends[1]) == set(rest.loops.lower)
        assert len(rest.loops.windows) == 1


def test_the_open_heel_lies_behind_and_below_and_is_smaller_than_the_end():
    limb, sleeve = opened("ankle")
    loops = loops_of(sleeve, limb)
    heel = sleeve.vertices[loops.windows[0]]
    assert (heel[:, 0] < 20.0).all()
    assert (heel[:, 1] < 0.0).all()
    area = enclosed_area(sleeve, loops.windows[0])
    assert 0.2 < area / enclosed_area(sleeve, loops.lower) < 0.75
    _, closed = opened("ankle", windows=[])
    assert not loops_of(closed, limb).windows


def test_the_seam_stays_clear_of_windows_or_is_refused():
    body = synthetic_body()
    two = [{"at": "patella"}, {"at": "popliteal_fossa", "width_mm": 35, "height_mm": 35}]
    keys = {"side": "right", "triangles": 1500, "windows": two}
    rest = rest_domain(body, domain_settings(seam_azimuth_deg=90.0, **keys))
    on_windows = np.concatenate(rest.loops.windows)
    assert not np.isin(rest.cut.weld[rest.cut.pairs], on_windows).any()
    for azimuth in (0.0, 180.0, -180.0, 355.0):
        with pytest.raises(GeometryError, match="through a window") as caught:
            rest_domain(body, domain_settings(seam_azimuth_deg=azimuth, **keys))
        assert "domain.seam_azimuth_deg" in caught.value.where
    with pytest.raises(GeometryError, match="through a window"):
        rest_domain(body, domain_settings(joint="ankle", seam_azimuth_deg=180.0, triangles=1500))
    limb, sleeve = opened(windows=[{"at": "patella"}])
    path = find_seam(sleeve, limb, loops_of(sleeve, limb), 60.0)
    assert not np.isin(path, loops_of(sleeve, limb).windows[0]).any()


def test_windows_that_do_not_fit_are_refused_by_key():
    big = [{"at": "patella", "width_mm": 50.0, "height_mm": 200.0}]
    refuse(GeometryError, "crosses the upper edge", "domain.windows[0]", above=0.2, windows=big)
    twice = [{"at": "patella"}, {"at": "patella"}]
    refuse(GeometryError, "runs into another window", "domain.windows[1]", windows=twice)
    wide = [{"at": "patella", "width_mm": 180.0, "height_mm": 90.0}]
    refuse(GeometryError, "window", "domain.windows[0]", windows=wide)
    refuse(ConfigError, "no usual size", "width_mm", windows=[{"at": "fibular_head"}])
    refuse(ConfigError, "no landmark 'toe'", "domain.windows[0].at", windows=[{"at": "toe"}])


def test_a_window_beside_the_skin_is_refused():
    limb, sleeve = opened(edge_mm=20.0)
    window = find_windows(
        limb_skin(synthetic_body(), limb), limb, sleeve, domain_settings(windows=[{"at": "patella"}]).windows
    )
    away = Surface(sleeve.vertices * [1.4, 1.0, 1.4], sleeve.triangles)
    with pytest.raises(GeometryError, match="no single hole"):
        open_windows(away, limb, [type(window[0])(**{**vars(window[0]), "radii": np.full(3, 10.0)})])
