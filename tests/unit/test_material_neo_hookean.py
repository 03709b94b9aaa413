"""Energy density against closed forms and invariances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.errors import GeometryError
from hilbrace.material.neo_hookean import energy_density, worst_energy_density

NU = 0.45
MU = 1 / (2 * (1 + NU))
LAMBDA = {"plane_stress": NU / (1 - NU**2), "plane_strain": NU / ((1 + NU) * (1 - 2 * NU))}


def _frames(*gradients):
    return np.array(gradients, dtype=float)[:, None]


@pytest.mark.parametrize("lame", LAMBDA)
@pytest.mark.parametrize("stretch", [0.7, 1.0, 1.3])
def test_even_stretch_has_the_closed_form(lame, stretch):
    value = energy_density(_frames(stretch * np.eye(2)), NU, lame)[0, 0]
    log_area = 2 * np.log(stretch)
    expected = MU * (stretch**2 - 1) - MU * log_area + LAMBDA[lame] / 2 * log_area**2
    assert value == pytest.approx(expected, abs=1e-14)


@given(st.floats(-3, 3), st.floats(0.5, 2), st.floats(0.5, 2), st.floats(-1, 1))
def test_turning_either_frame_changes_nothing(angle, a, b, shear):
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    g = np.array([[a, shear], [0, b]])
    values = energy_density(_frames(g, turn @ g, g @ turn), NU)
    assert values[:, 0] == pytest.approx(values[0, 0], abs=1e-12)
    assert values[0, 0] >= -1e-12


def test_rest_has_no_energy_and_no_stress():
    assert energy_density(_frames(np.eye(2)), NU)[0, 0] == 0
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-5
        assert energy_density(_frames(np.eye(2) + step.reshape(2, 2)), NU)[0, 0] < 1e-9


def test_small_strain_is_hookes_law():
    e = 1e-4
    strain = np.array([[1 + e, 0], [0, 1 - NU * e]])
    # uniaxial stress in a sheet of unit modulus: e^2 / 2
    assert energy_density(_frames(strain), NU)[0, 0] == pytest.approx(e**2 / 2, rel=1e-3)


def test_worst_frame_counts():
    frames = np.stack([_frames(np.eye(2) * s)[0] for s in (1.0, 1.2, 0.9)])
    assert worst_energy_density(frames, NU) == pytest.approx(energy_density(frames, NU).max(axis=0))


def test_folded_skin_is_refused_by_frame_and_triangle():
    frames = np.tile(np.eye(2), (3, 4, 1, 1))
    frames[1, 2] = np.diag([1.0, -1.0])
    with pytest.raises(GeometryError, match="turns over") as error:
        energy_density(frames, NU)
    assert error.value.where == "frame 1, triangle 2"
