"""Curves of modulus and volume: fit, monotony, derivatives, blending, tensors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hilbrace.config.material import CELLS as NAMES
from hilbrace.errors import ConfigError
from hilbrace.material.curves import fit_monotone_cubic, load_curves, load_microstructures, load_table
from hilbrace.material.homogenize import coverage, homogenize, mean_modulus, subpixel_distance

CELLS = load_microstructures("sinusoidal", "voronoi_open")
D = np.linspace(0, 1, 201)

LARGEST_ERROR = {"star": 9e-3, "voronoi_tri": 3e-3}
"""The star's modulus bends too sharply for a cubic where its points grow together; struts along the pixels,
as on the border of the triangles, get wider a pixel at a time."""

COARSE = {"star": 0.12}
"""Relative error of half as many pixels where it is above 0.08: the hinges of the star are short."""


@pytest.mark.parametrize("name", NAMES)
def test_fit_error_is_below_the_papers(name):
    curves, columns = load_curves(name), load_table(name)["columns"]
    assert len(columns["width"]) == 25
    d = np.linspace(0, 1, 25)
    assert curves.width(d) == pytest.approx(np.array(columns["width"]), abs=1e-7)
    for fitted, sampled, reported in (
        (curves.modulus(d), columns["E_mean"], curves.modulus_error),
        (curves.volume(d), columns["volume"], curves.volume_error),
    ):
        error = np.mean((fitted - np.array(sampled)) ** 2)
        assert error == pytest.approx(reported, rel=1e-3)
        assert error < 1e-4
        assert np.abs(fitted - sampled).max() < LARGEST_ERROR.get(name, 2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_curves_rise(name):
    curves = load_curves(name)
    assert (np.diff(curves.modulus(D)) > 0).all()
    assert (np.diff(curves.volume(D)) > 0).all()
    assert curves.modulus(0.0) > 0


@pytest.mark.parametrize("name", NAMES)
def test_slopes_match_finite_differences(name):
    curves, h = load_curves(name), 1e-6
    for value, slope in ((curves.modulus, curves.modulus_slope), (curves.volume, curves.volume_slope)):
        assert slope(D) == pytest.approx((value(D + h) - value(D - h)) / (2 * h), abs=1e-8)


def test_firm_cell_is_several_times_stiffer_at_equal_volume():
    volumes = np.linspace(0.12, 0.54, 30)
    firm = np.interp(volumes, CELLS.firm.volume(D), CELLS.firm.modulus(D))
    soft = np.interp(volumes, CELLS.soft.volume(D), CELLS.soft.modulus(D))
    assert (firm / soft > 3.0).all()
    assert (CELLS.firm.modulus(D) > CELLS.soft.modulus(D)).all()


@pytest.mark.parametrize("name", NAMES)
def test_shipped_table_agrees_with_a_coarse_recomputation(name):
    columns, pixels = load_table(name)["columns"], 64
    distance = subpixel_distance(name, pixels)
    for k in (8, 16, 24):
        density = coverage(distance, columns["width"][k], pixels)
        assert density.mean() == pytest.approx(columns["volume"][k], abs=2e-3)
        assert mean_modulus(homogenize(density, 0.45)) == pytest.approx(
            columns["E_mean"][k], rel=COARSE.get(name, 0.08)
        )


def test_blend_runs_from_soft_to_firm_and_inverts():
    d = np.linspace(0, 1, 11)
    for s, cell in ((0.0, CELLS.soft), (1.0, CELLS.firm)):
        assert CELLS.modulus(d, s) == pytest.approx(cell.modulus(d))
        assert CELLS.volume(d, s) == pytest.approx(cell.volume(d))
        assert CELLS.width(d, s) == pytest.approx(cell.width(d))
    s = np.linspace(0, 1, 11)
    assert CELLS.design_variable(CELLS.width(d, s), s) == pytest.approx(d)
    assert CELLS.modulus(0.5, 0.5) == pytest.approx((CELLS.soft.modulus(0.5) + CELLS.firm.modulus(0.5)) / 2)


def test_curves_serve_torch_with_gradients():
    d = torch.linspace(0, 1, 9, dtype=torch.float64, requires_grad=True)
    s = torch.linspace(0, 1, 9, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda d, s: CELLS.modulus(d, s) + CELLS.volume(d, s), (d, s))
    plain = CELLS.modulus(d.detach().numpy(), s.detach().numpy())
    assert CELLS.modulus(d, s).detach().numpy() == pytest.approx(plain)


def test_monotone_fit_is_exact_on_cubics_and_never_falls_on_noise():
    d = np.linspace(0, 1, 25)
    c, error = fit_monotone_cubic(d, 0.1 + d**3)
    assert c == pytest.approx((0.1, 0, 0, 1), abs=1e-9)
    assert error < 1e-20
    noisy, _ = fit_monotone_cubic(d, np.where(d < 0.5, 0.3, 0.0))
    assert (np.diff(np.polynomial.Polynomial(noisy)(D)) >= -1e-12).all()


def test_unknown_cell_is_refused():
    with pytest.raises(ConfigError, match="no microstructure named 'plaid'"):
        load_curves("plaid")
