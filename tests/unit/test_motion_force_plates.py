"""Plates to feet: wrenches add up, unloaded noise is dropped, and wrong columns are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.filters import lowpass
from hilbrace.motion.foot_contacts import assign_contacts, feet_by_name
from hilbrace.motion.force_columns import plate_forces, read_plate_forces
from hilbrace.motion.force_plates import (
    FEET,
    PlateForces,
    check_columns,
    foot_forces,
    total_vertical,
    unload,
)
from hilbrace.motion.opensim_files import Storage
from tests.unit import motion_files as lab

RATE = 1000.0
NO_FILTER = 0.4 * RATE
TIME = np.arange(200) / RATE
FOOT = np.array([[-0.06, 0.04, 0.1], [0.14, 0.04, 0.1], [0.1, 0.03, 0.16]])
MIRROR = np.array([1.0, 1.0, -1.0])


def plates(force, point, torque=None, names=None) -> PlateForces:
    """Loads that do not change, or do over `TIME`: (plate, 3) or (sample, plate, 3)."""
    shape = (len(TIME), np.shape(force)[-2], 3)
    names = names or tuple(str(k + 1) for k in range(shape[1]))
    return PlateForces(
        "forces.mot",
        names,
        tuple(f"ground_force_{name}_vy" for name in names),
        TIME,
        RATE,
        np.broadcast_to(np.asarray(force, float), shape).copy(),
        np.broadcast_to(np.asarray(point, float), shape).copy(),
        np.broadcast_to(np.zeros(3) if torque is None else np.asarray(torque, float), shape).copy(),
    )


def feet(frames: int = len(TIME)) -> dict[str, np.ndarray]:
    """Both feet on the floor, 20 cm apart."""
    right = np.broadcast_to(FOOT, (frames, 3, 3))
    return {"right": right.copy(), "left": right * MIRROR}


def all_on(load: PlateForces, foot: int) -> np.ndarray:
    return np.full(load.force.shape[:2], foot)


vectors = st.lists(st.floats(-1, 1), min_size=3, max_size=3).map(np.array)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(vectors, vectors, vectors), min_size=1, max_size=4), st.floats(-0.5, 0.5))
def test_the_sum_over_plates_has_the_wrench_of_its_parts(parts, height):
    """The oracle is statics: equal resultants about any point, and no horizontal moment about the result."""
    force = np.array([[200 * f[0], 500 + 300 * f[1], 200 * f[2]] for f, _, _ in parts])
    point = np.array([[p[0], height, p[2]] for _, p, _ in parts])
    torque = np.array([20 * t for _, _, t in parts])
    load = plates(force, point, torque)
    found = foot_forces(load, all_on(load, 0), TIME, NO_FILTER, 20.0)
    total, centre, free = found.force[7, 0], found.centre_of_pressure[7, 0], found.free_torque[7, 0]
    assert total == pytest.approx(force.sum(0), abs=1e-9)
    assert centre[1] == pytest.approx(height, abs=1e-12)
    about = np.array([0.3, -0.2, 0.7])
    wanted = (np.cross(point - about, force) + torque).sum(0)
    assert np.cross(centre - about, total) + free == pytest.approx(wanted, abs=1e-8)
    assert free[[0, 2]] == pytest.approx([0, 0])
    assert not found.force[:, 1].any()


def test_an_unloaded_foot_has_zeros_everywhere():
    load = plates([[0, 15.0, 0]], [[300.0, 0, np.nan]])
    found = foot_forces(unload(load, 20.0), all_on(load, 0), TIME, 12.0, 20.0)
    assert not found.force.any()
    assert not found.centre_of_pressure.any()
    assert not found.free_torque.any()


def test_a_point_that_is_nan_while_unloaded_does_no_harm():
    load = plates([[0, 700.0, 0]], [[0.1, 0, 0.1]])
    load.force[:50] = [0.0, 4.0, 0.0]
    load.point[:50] = np.nan
    load.torque[:50] = np.nan
    found = foot_forces(unload(load, 20.0), all_on(load, 0), TIME, NO_FILTER, 20.0)
    assert np.isfinite(found.centre_of_pressure).all()
    assert found.centre_of_pressure[50:, 0] == pytest.approx(np.tile([0.1, 0, 0.1], (150, 1)))
    assert not found.force[:50].any()


def test_a_threshold_of_zero_still_calls_an_empty_plate_unloaded():
    load = plates([[0, 0.0, 0]], [[np.nan, np.nan, np.nan]])
    assert not unload(load, 0.0).point.any()


@pytest.mark.parametrize("part", ["point", "torque", "force"])
def test_nan_under_load_is_refused_with_its_sample(part):
    load = plates([[0, 700.0, 0]], [[0.1, 0, 0.1]])
    getattr(load, part)[41, 0, 2] = np.nan
    with pytest.raises(InputError, match="no number") as caught:
        unload(load, 20.0)
    assert "forces.mot, sample 42 (0.0410 s), plate 1" in caught.value.where


def test_filtered_forces_are_those_of_the_filter_and_keep_the_centre():
    load = plates([[0, 0, 0]], [[0.1, 0.006, -0.2]])
    load.force[60:120, 0, 1] = 2000 * np.sin(np.linspace(0, np.pi, 60))
    found = foot_forces(load, all_on(load, 1), TIME, 20.0, 20.0)
    expected = lowpass(load.force[:, 0, 1], RATE, 20.0)
    vertical = found.force[:, 1, 1]
    assert vertical == pytest.approx(np.where(expected >= 20, expected, 0.0))
    off = found.centre_of_pressure[vertical > 0, 1] - [0.1, 0.006, -0.2]
    assert np.abs(off).max() < 1e-9


def test_forces_are_sampled_at_the_markers_instants():
    load = plates([[0, 0, 0]], [[0, 0, 0]])
    load.force[:, 0, 1] = 500 + 1000 * TIME
    instants = np.arange(0, 0.19, 0.01)
    found = foot_forces(load, all_on(load, 0), instants, NO_FILTER, 20.0)
    assert found.force[:, 0, 1] == pytest.approx(500 + 1000 * instants)


WRONG = {
    "z for y": (
        [[10, 30, 700]],
        [[0, 0, 0]],
        [[0, 0, 0]],
        "along z, 700 N on average against 30 N",
    ),
    "x for y": ([[-650, 30, 10]], [[0, 0, 0]], [[0, 0, 0]], "largest is along x"),
    "downwards": ([[0, -700, 0]], [[0, 0, 0]], [[0, 0, 0]], "pulls the subject down with 700 N"),
    "millimetres": ([[0, 700, 0]], [[825.0, 0, 569]], [[0, 0, 0]], "up to 825 m off"),
    "N*mm": ([[0, 700, 0]], [[0.1, 0, 0]], [[0, 9000, 0]], "lever of 12.9 m"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_forces_in_the_wrong_columns_are_refused_by_name(fault):
    force, point, torque, what = WRONG[fault]
    with pytest.raises(InputError, match=what) as caught:
        check_columns(plates(force, point, torque), 20.0)
    assert "plate 1 (ground_force_1_vy)" in caught.value.where
    assert caught.value.hint


def test_a_drifting_unloaded_plate_is_not_judged():
    check_columns(plates([[30, 5, -60]], [[500, 0, 0]]), 20.0)


# --- columns --------------------------------------------------------------------------------------------

FAMILIES = {
    "ground_force_1_vx": ("1", "ground_force_1_v{}", "ground_force_1_p{}", "ground_force_1_m{}"),
    "ground_force_r_vx": ("r", "ground_force_r_v{}", "ground_force_r_p{}", "ground_torque_r_{}"),
    "ground_force1_vx": ("1", "ground_force1_v{}", "ground_force1_p{}", "ground_torque1_{}"),
    "ground_force_vx": ("0", "ground_force_v{}", "ground_force_p{}", "ground_torque_{}"),
    "1_ground_force_vx": ("1", "1_ground_force_v{}", "1_ground_force_p{}", "1_ground_torque_{}"),
    "R_ground_force_vx": ("R", "R_ground_force_v{}", "R_ground_force_p{}", "R_ground_torque_{}"),
    "ground_moment_1_mx": ("1", "ground_force_1_v{}", "ground_force_1_p{}", "ground_moment_1_m{}"),
    "no torque": ("1", "ground_force_1_v{}", "ground_force_1_p{}", None),
}


def storage(patterns) -> Storage:
    columns = {"knee_angle_r": np.zeros(3)}
    for k, pattern in enumerate(patterns):
        for j, axis in enumerate("xyz"):
            if pattern:
                columns[pattern.format(axis)] = np.full(3, 10.0 * k + j)
    return Storage(np.arange(3) / 100, columns, degrees=False)


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_of_names_is_read(family):
    plate, *patterns = FAMILIES[family]
    load = plate_forces(storage(patterns), "x.mot")
    assert load.names == (plate,)
    assert load.rate_hz == pytest.approx(100.0)
    assert load.force[0, 0].tolist() == [0, 1, 2]
    assert load.point[0, 0].tolist() == [10, 11, 12]
    assert load.torque[0, 0].tolist() == ([20, 21, 22] if patterns[2] else [0, 0, 0])


def test_digits_for_axes_are_read():
    columns = {f"{k}1_{a}": np.full(3, 1.0 + a) for k in "fpm" for a in (1, 2, 3)}
    assert plate_forces(Storage(np.arange(3.0), columns, degrees=False), "x").force[0, 0].tolist() == [
        2,
        3,
        4,
    ]


def test_files_without_ground_reactions_are_refused():
    with pytest.raises(InputError, match=r"no column names a ground reaction; there are knee_angle_r"):
        plate_forces(storage([]), "x.mot")


def test_a_plate_with_missing_columns_is_refused():
    half = storage(FAMILIES["ground_force_1_vx"][1:])
    del half.columns["ground_force_1_pz"]
    with pytest.raises(InputError, match="plate '1' has 2 of 3 columns of its point") as caught:
        plate_forces(half, "x.mot")
    assert "ground_force_1_px" in caught.value.hint


# --- contacts -------------------------------------------------------------------------------------------

RIGHT, LEFT = [0.05, 0.0, 0.1], [0.05, 0.0, -0.1]


def test_plates_find_their_feet():
    load = plates([[0, 300, 0], [0, 400, 0]], [LEFT, RIGHT])
    owner, notes = assign_contacts(load, TIME, feet(), {})
    assert (owner == [1, 0]).all()
    assert notes == (
        "Plate 1: left foot 0.00 to 0.20 s, up to 300 N, 4 cm from its markers.",
        "Plate 2: right foot 0.00 to 0.20 s, up to 400 N, 4 cm from its markers.",
    )


def test_a_centre_given_by_torque_finds_its_foot():
    """Points at the plate's middle and torques about it, as OpenSim's C3D reader writes them."""
    middle = np.array([0.4, 0.0, 0.5])
    force = np.array([0.0, 600.0, 0.0])
    torque = np.cross(np.array(LEFT) - middle, force)
    owner, _ = assign_contacts(plates([force], [middle], [torque]), TIME, feet(), {})
    assert (owner == 1).all()


def test_one_plate_may_meet_one_foot_after_the_other():
    load = plates([[0, 0, 0]], [RIGHT])
    load.force[10:60, 0, 1] = load.force[130:180, 0, 1] = 600
    load.point[100:, 0] = LEFT
    owner, _ = assign_contacts(load, TIME, feet(), {})
    assert set(owner[10:60, 0]) == {0}
    assert set(owner[130:180, 0]) == {1}
    assert set(owner[60:130, 0]) == {-1}


def test_both_feet_on_one_plate_are_refused():
    with pytest.raises(InputError, match="both feet are on plate 1") as caught:
        assign_contacts(plates([[0, 600, 0]], [[0.05, 0, 0]]), TIME, feet(), {})
    assert "motion.plates" in caught.value.hint


def test_a_load_far_from_both_feet_is_refused_and_a_drift_noted():
    with pytest.raises(InputError, match="the nearest foot is 1"):
        assign_contacts(plates([[0, 600, 0]], [[1.5, 0, 0.1]]), TIME, feet(), {})
    owner, notes = assign_contacts(plates([[0, 60, 0]], [[1.5, 0, 0.1]]), TIME, feet(), {})
    assert (owner == -1).all()
    assert notes == ("Plate 1 shows up to 60 N with no foot near it: left out.",)


def test_without_foot_markers_the_settings_have_to_tell():
    nobody = {foot: np.zeros((len(TIME), 0, 3)) for foot in FEET}
    load = plates([[0, 600, 0]], [RIGHT])
    with pytest.raises(InputError, match="no foot markers"):
        assign_contacts(load, TIME, nobody, {})
    owner, _ = assign_contacts(load, TIME, nobody, {"1": "left"})
    assert (owner == 1).all()


def test_given_plates_are_followed_and_swapped_ones_refused():
    load = plates([[0, 300, 0], [0, 400, 0], [0, 0, 0]], [RIGHT, LEFT, LEFT])
    owner, _ = assign_contacts(load, TIME, feet(), {"1": "right", "2": "left", "3": "unused"})
    assert (owner == [0, 1, -1]).all()
    with pytest.raises(InputError, match="plate 1 is given as the left foot's"):
        assign_contacts(load, TIME, feet(), {"1": "left", "2": "right"})


def test_plates_that_are_not_there_or_left_out_are_named():
    load = plates([[0, 300, 0], [0, 400, 0]], [RIGHT, LEFT])
    with pytest.raises(ConfigError, match="names plate '4'"):
        assign_contacts(load, TIME, feet(), {"4": "left"})
    with pytest.raises(ConfigError, match="says nothing about plate '2'"):
        assign_contacts(load, TIME, feet(), {"1": "right"})


def test_names_of_plates_count_only_where_the_markers_do_not_tell():
    load = plates([[0, 300, 0], [0, 400, 0]], [RIGHT, LEFT], names=("R", "l"))
    named = feet_by_name(load)
    assert named == {"R": "right", "l": "left"}
    owner, notes = assign_contacts(load, TIME, feet(), {}, named)
    assert owner[0].tolist() == [0, 1]
    assert "the file says" not in " ".join(notes)
    swapped, notes = assign_contacts(load, TIME, feet(), {}, {"R": "left", "l": "right"})
    assert np.array_equal(swapped, owner)
    assert "right foot" in notes[0]
    assert "though the file says left" in notes[0]
    blind = {"right": np.zeros((len(TIME), 0, 3)), "left": np.zeros((len(TIME), 0, 3))}
    unseen, _ = assign_contacts(load, TIME, blind, {}, {"R": "left", "l": "right"})
    assert unseen[0].tolist() == [1, 0]


def test_hidden_foot_markers_are_stepped_over():
    load = plates([[0, 600, 0]], [RIGHT])
    markers = feet()
    markers["right"][:150] = np.nan
    owner, _ = assign_contacts(load, TIME, markers, {})
    assert (owner == 0).all()


def test_total_vertical_adds_the_plates():
    assert total_vertical(plates([[1, 300, 0], [0, 400, 9]], [RIGHT, LEFT])) == pytest.approx(700)


# --- recorded files -------------------------------------------------------------------------------------


def test_a_recorded_file_with_points_of_hundreds_of_metres_while_unloaded(shared_data):
    load = read_plate_forces(Path(shared_data) / "rajagopal_walk/grf_walk.mot")
    assert load.names == ("r", "l")
    assert np.abs(load.point).max() > 300
    check_columns(load, 20.0)
    quiet = unload(load, 20.0)
    assert np.abs(quiet.point).max() < 5
    peaks = quiet.force[:, :, 1].max(axis=0)
    assert 900 < peaks.min()
    assert peaks.max() < 1200


def test_a_published_file_in_millimetres_is_refused(shared_data):
    load = read_plate_forces(shared_data / "c3d_force_plates/std_cop_walking2_grfs.sto")
    turned = replace(load, force=load.force[:, :, [0, 2, 1]], point=load.point[:, :, [0, 2, 1]])
    with pytest.raises(InputError, match="largest is along z"):
        check_columns(load, 20.0)
    with pytest.raises(InputError, match="m off"):
        check_columns(turned, 20.0)


def test_the_moments_of_the_opencap_files_are_about_the_point(shared_data):
    """Their horizontal moments are zero: the point is the centre of pressure, m the free torque."""
    load = read_plate_forces(shared_data / "opencap_subject4/grf/DJ1_grf.mot")
    assert not load.torque[:, :, [0, 2]].any()
    assert 1 < np.abs(load.torque[:, :, 1]).max() < 20


def test_lab_columns_find_the_same_feet():
    load = plate_forces(Storage(TIME, lab.force_columns(TIME), degrees=False), "x")
    assert load.names == ("1", "2", "3")
