"""Mass and height of the subject."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.errors import InputError
from hilbrace.motion.c3d import read_c3d
from hilbrace.motion.marker_maps import MarkerMap, read_marker_map
from hilbrace.motion.subject import check_weight, standing_force, subject_height, subject_mass
from hilbrace.units import GRAVITY

MAP = MarkerMap("m", {"a": "RACR", "b": "LACR", "c": "RLMAL", "d": "LLMAL"}, {})


def test_a_person_who_stands_still_is_weighed():
    force = 700 + 5 * np.sin(np.arange(100))
    assert standing_force(force) == pytest.approx(force.mean())


@pytest.mark.parametrize(
    "force",
    [np.full(10, 50.0), np.linspace(300, 900, 50), np.zeros(0), np.array([700.0, np.nan]), np.zeros(9)],
)
def test_nobody_stands_still_there(force):
    assert standing_force(force) is None


def test_the_mass_is_weighed_or_given():
    assert subject_mass(None, 70 * GRAVITY, "static") == pytest.approx(70.0)
    assert subject_mass(70.0, None, "static") == 70.0
    assert subject_mass(70.0, 79 * GRAVITY, "static") == 70.0


@pytest.mark.parametrize("weighed", [59.0, 81.0])
def test_a_mass_that_the_plates_contradict_names_both(weighed):
    with pytest.raises(InputError, match=rf"70.0 kg, but the plates weigh {weighed:.1f} kg"):
        subject_mass(70.0, weighed * GRAVITY, "static")


def test_an_unknown_mass_is_refused():
    with pytest.raises(InputError, match="mass is unknown") as caught:
        subject_mass(None, None, "walk.trc")
    assert "subject.mass_kg" in caught.value.hint


def test_the_height_is_given_estimated_or_unknown():
    standing = np.array([[0, 1.48, 0], [0, 1.46, 0], [0, 0.09, 0], [0, 0.07, 0]])
    names = ("a", "b", "c", "d")
    assert subject_height(1.81, MAP, names, standing) == 1.81
    assert subject_height(None, MAP, names, standing) == pytest.approx(1.39 / 0.779, abs=1e-3)
    assert subject_height(None, MAP, names[:2], standing[:2]) == 0.0


HEIGHTS = {
    "mcgill_HC032A/HC032A01.c3d": 1.58,
    "mcgill_HC038A/HC038A01.c3d": 1.74,
    "stairs_85kg/Static_trial.c3d": 1.679,
}


@pytest.mark.parametrize("name", HEIGHTS)
def test_the_estimate_of_people_of_known_height(shared_data, name):
    table = read_c3d(shared_data / "c3d_plugin_gait" / name).markers
    standing = np.nanmedian(table.positions[:, :, [0, 2, 1]], axis=0)
    height = subject_height(None, read_marker_map("plug_in_gait"), table.names, standing)
    assert height == pytest.approx(HEIGHTS[name], rel=0.03)


def test_forces_that_no_body_of_that_mass_makes_are_refused():
    check_weight(np.array([0.0, 2000.0]), 60.0, "x")
    for peak in (0.7, 20000.0):
        with pytest.raises(InputError, match="times the weight of 60"):
            check_weight(np.array([0.0, peak]), 60.0, "x")
