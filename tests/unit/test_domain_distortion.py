"""Figures of a flat map against closed forms and limits, and the advice that they lead to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hilbrace.domain.distortion import MapDistortion, advice, area_ratio, map_distortion
from tests.unit.flat_sleeve import flattened, opened_sleeve

SLEEVE = opened_sleeve()


@pytest.mark.parametrize("window", [0.0, 26.0])
@pytest.mark.parametrize("method", ["lscm", "periodic"])
def test_conformal_maps_of_the_sleeve_keep_their_limits(method, window):
    made, found = flattened(opened_sleeve(window), method)
    assert found.flipped_triangles == 0
    assert found.quasi_conformal_mean <= 1.02
    assert found.quasi_conformal_mean <= found.quasi_conformal_p99 <= found.quasi_conformal_max
    if method == "periodic":
        assert found.seam_gap <= 1e-9
    else:
        assert np.isnan(found.seam_gap)
        assert found.figures()["seam_gap"] is None
    corner = made.uv[made.cut_triangles]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    signed = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    assert (signed > 0).all()


def test_a_window_is_left_out_of_the_map():
    whole, windowed = opened_sleeve(), opened_sleeve(26.0)
    assert 20 < len(whole.triangles) - len(windowed.triangles) < 400


def test_an_even_stretch_has_its_own_ratio():
    flat, _ = flattened(SLEEVE, "lscm")
    _, before = flattened(SLEEVE, "lscm")
    found = map_distortion(replace(flat, uv=flat.uv * [1.0, 0.5]))
    assert found.quasi_conformal_mean == pytest.approx(2.0, rel=0.02)
    assert found.map_area_ratio_max == pytest.approx(before.map_area_ratio_max, rel=1e-9)


def test_the_ratios_of_all_triangles_make_up_the_map():
    made, found = flattened(SLEEVE, "periodic")
    corner = made.vertices[made.triangles]
    on_skin = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    assert np.average(area_ratio(made), weights=on_skin) == pytest.approx(1.0, rel=1e-9)
    assert found.map_area_ratio_min < 1.0 < found.map_area_ratio_max


def test_turned_triangles_and_an_open_seam_are_counted():
    made, _ = flattened(SLEEVE, "periodic")
    uv = made.uv.copy()
    uv[made.seam_pairs[3, 1]] += [2e-9, 0.0]
    inner = int(np.argmin(np.abs(uv - 0.5 * uv.max(axis=0)).sum(axis=1)))
    uv[inner] += 0.4
    found = map_distortion(replace(made, uv=uv))
    assert 1 <= found.flipped_triangles <= 6
    assert found.seam_gap == pytest.approx(2e-9, rel=1e-3)
    said = advice(found, "periodic")
    assert any("turns" in one for one in said)
    assert any("seam" in one for one in said)


GOOD = MapDistortion(0, 1.005, 1.02, 1.03, 0.7, 1.4, float("nan"))


@pytest.mark.parametrize("method", ["lscm", "periodic", "slim"])
def test_a_good_map_needs_no_advice(method):
    assert advice(GOOD, method) == ()


@pytest.mark.parametrize(
    ("method", "mend"), [("lscm", "'slim'"), ("periodic", "'slim'"), ("slim", "shorter region")]
)
@pytest.mark.parametrize("limits", [(0.49, 1.4), (0.8, 2.01)])
def test_areas_out_of_their_limits_name_the_mend(method, mend, limits):
    low, high = limits
    (said,) = advice(replace(GOOD, map_area_ratio_min=low, map_area_ratio_max=high), method)
    assert mend in said
    assert f"{low:.2f} to {high:.2f}" in said


def test_sheared_cells_are_told():
    (said,) = advice(replace(GOOD, quasi_conformal_mean=1.2), "slim")
    assert "'lscm'" in said
    assert "1.20" in said
