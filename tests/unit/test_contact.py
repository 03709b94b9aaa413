"""Contact forces against statics that can be done by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.biomech.contact import (
    COMPARTMENTS_M,
    Crossing,
    acting_force,
    compartments,
    crossing,
    surface_loads,
    through_kneecap,
)

FORCES = st.floats(-3000.0, 3000.0)


def turned_about_z(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def test_pulls_are_expressed_in_the_bone_about_the_joint():
    """A unit force in the ground at a known point, the bone turned and moved."""
    rotation, centre = turned_about_z(0.7), np.array([0.1, 0.5, -0.2])
    point, force = np.array([0.2, 0.4, 0.1]), np.array([0.0, 0.6, 0.8])
    wrench = np.concatenate([force, np.cross(point, force)])
    found = crossing(wrench[None, None], rotation[None], centre[None])
    assert np.allclose(rotation @ found.pull[0, 0], force)
    assert np.allclose(rotation @ found.turn[0, 0], np.cross(point - centre, force))


def test_muscles_whose_pulls_cancel_below_the_joint_do_not_cross_it():
    pulls = np.zeros((2, 2, 6))
    pulls[:, 0, :3], pulls[:, 1, :3] = 1e-15, [0.0, 1.0, 0.0]
    found = crossing(pulls, np.broadcast_to(np.eye(3), (2, 3, 3)), np.zeros((2, 3)))
    assert not found.pull[:, 0].any()
    assert found.pull[:, 1].any()


@pytest.mark.parametrize(("joint", "lateral_z"), [("knee_r", 1.0), ("knee_l", -1.0)])
@given(medial=FORCES, lateral=FORCES)
def test_compartments_are_found_from_their_resultant(joint, lateral_z, medial, lateral):
    """Two forces that press on the tibia, half the distance to either side, added up and taken apart."""
    arm = np.array([0.0, 0.0, 0.5 * COMPARTMENTS_M * lateral_z])
    inner, outer = np.array([0.0, -medial, 0.0]), np.array([0.0, -lateral, 0.0])
    moment = np.cross(arm, outer) + np.cross(-arm, inner)
    found = compartments((inner + outer)[None], moment[None], joint)
    assert np.allclose(np.ravel(found), [medial, lateral], atol=1e-6)


def test_a_knee_has_two_surfaces_and_an_ankle_one():
    force, moment = np.array([[10.0, -800.0, 5.0]]), np.zeros((1, 3))
    assert [load.tolist() for load in surface_loads(force, moment, "knee_l")] == [[400.0], [400.0]]
    assert [load.tolist() for load in surface_loads(force, moment, "ankle_l")] == [[800.0]]


def test_both_conventions_of_the_acting_force():
    """Contact C on the distal bone, muscles pulling it by P: net = C + P, literal = C - P (Eq. 1)."""
    contact, pull = np.array([[0.0, -2000.0, 100.0]]), np.array([[0.0, 1200.0, -30.0]])
    net = contact + pull
    assert np.allclose(acting_force(net, pull[:, None] / 3.0, np.full((1, 1), 3.0), "intersegmental"), net)
    literal = acting_force(net, pull[:, None] / 3.0, np.full((1, 1), 3.0), "paper_literal")
    assert np.allclose(literal, contact - pull)


def test_the_ligament_balances_the_tibia():
    """Quadriceps of arm 20 mm over a ligament of arm 36 mm: the tibia feels 20/36 of their tension."""
    pull, turn = np.array([[[0.0, 1.0, 0.0]] * 2]), np.array([[[0.0, 0.0, 0.036], [0.0, 0.0, -0.03]]])
    flexion = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -1.0]])
    arms = np.array([[-0.020, 0.030]])
    found = through_kneecap(Crossing(pull, turn), flexion, arms)
    assert np.allclose(found.pull[0, 0], [0.0, 20.0 / 36.0, 0.0])
    assert np.allclose(found.turn[0, 0] @ flexion[0, 3:], arms[0, 0])
    assert np.array_equal(found.pull[0, 1], pull[0, 1])


def test_muscles_that_do_not_cross_stay_out_of_the_kneecap():
    nothing = Crossing(np.zeros((1, 1, 3)), np.zeros((1, 1, 3)))
    found = through_kneecap(nothing, np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -1.0]]), np.array([[0.02]]))
    assert not found.pull.any()
