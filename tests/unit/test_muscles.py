"""Which muscles supply which moments, on small legs whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.biomech.contact import Crossing
from hilbrace.biomech.muscles import MuscleFigures, balanced_coordinates, recruit

FRAMES = 3


def figures(strengths) -> MuscleFigures:
    count = len(strengths)
    return MuscleFigures(
        tuple(f"muscle_{k}" for k in range(count)),
        np.array(strengths, dtype=float),
        np.full(count, 0.1),
        np.full(count, 0.2),
        np.zeros(count),
    )


def test_locked_coordinates_are_told_from_moving_ones():
    names = ("pelvis_tx", "knee_angle_r", "subtalar_angle_r", "ankle_angle_r")
    values = np.array([[0.0, 0.1, 0.0, 0.2], [0.1, 0.2, 0.0, 0.3]])
    moving, locked = balanced_coordinates(names, values)
    assert moving == ("knee_angle_r", "ankle_angle_r")
    assert locked == ("subtalar_angle_r",)


def test_moments_are_supplied():
    arms = np.broadcast_to([[[-0.04, 0.03]]], (FRAMES, 1, 2)).copy()
    capacity = np.broadcast_to([2000.0, 1500.0], (FRAMES, 2)).copy()
    moments = np.array([[-20.0], [0.0], [15.0]])
    found = recruit(capacity, arms, moments, ("knee_angle_r",), {}, figures([2000, 1500]))
    assert np.allclose(np.einsum("frm,fm->fr", arms, found.tension), moments, atol=0.02)
    assert found.tension[0, 1] == pytest.approx(0.0, abs=1e-3)
    assert found.tension[2, 0] == pytest.approx(0.0, abs=1e-3)
    assert found.balanced == ("knee_angle_r",)


def test_a_coordinate_that_no_muscle_reaches_is_not_asked_for():
    arms = np.zeros((FRAMES, 2, 1))
    arms[:, 0] = 0.04
    moments = np.broadcast_to([10.0, 50.0], (FRAMES, 2)).copy()
    rows = ("knee_angle_r", "knee_adduction_r")
    found = recruit(np.full((FRAMES, 1), 1000.0), arms, moments, rows, {}, figures([1000]))
    assert found.balanced == ("knee_angle_r",)


def test_ligaments_and_condyles_carry_the_frontal_moment():
    """A knee adductor could supply it, but a reserve of 100 N*m is cheaper than its activation."""
    arms = np.full((FRAMES, 1, 1), 0.03)
    moments = np.full((FRAMES, 1), 20.0)
    rows = ("knee_adduction_r",)
    found = recruit(np.full((FRAMES, 1), 1000.0), arms, moments, rows, {}, figures([1000]))
    left = moments - arms[:, 0] * found.tension
    assert (left > 15.0).all()


def test_surfaces_prefer_the_muscle_that_does_not_press_on_the_knee():
    """Soleus and gastrocnemius share a plantarflexor moment; the latter presses on the knee."""
    arms = np.full((FRAMES, 1, 2), -0.04)
    capacity = np.full((FRAMES, 2), 3000.0)
    moments = np.full((FRAMES, 1), -80.0)
    across = Crossing(np.zeros((FRAMES, 2, 3)), np.zeros((FRAMES, 2, 3)))
    across.pull[:, 1, 1] = 1.0
    net = np.tile([0.0, -700.0, 0.0], (FRAMES, 1))
    knee = {"knee_r": (across, net, np.zeros((FRAMES, 3)))}
    plain = recruit(capacity, arms, moments, ("ankle_angle_r",), {}, figures([3000, 3000]))
    spared = recruit(capacity, arms, moments, ("ankle_angle_r",), knee, figures([3000, 3000]))
    assert np.allclose(plain.tension[:, 0], plain.tension[:, 1])
    assert (spared.tension[:, 1] < 0.7 * spared.tension[:, 0]).all()
    assert np.allclose(spared.tension.sum(axis=1), plain.tension.sum(axis=1), rtol=1e-3)


def test_compartments_replace_the_reserve_of_the_frontal_moment():
    arms = np.full((FRAMES, 1, 1), 0.03)
    across = Crossing(np.zeros((FRAMES, 1, 3)), np.zeros((FRAMES, 1, 3)))
    across.pull[..., 1] = 1.0
    net = np.zeros((FRAMES, 3))
    found = recruit(
        np.full((FRAMES, 1), 1000.0),
        arms,
        np.full((FRAMES, 1), 20.0),
        ("knee_adduction_l",),
        {"knee_l": (across, net, net)},
        figures([1000]),
    )
    assert found.balanced == ()
