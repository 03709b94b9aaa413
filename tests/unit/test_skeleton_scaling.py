"""Scaled figures against OpenSim's own Model::scale, and closed forms."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import InputError
from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.scaling import scaled_inertia, scaled_table
from hilbrace.skeleton.table import load_table
from tests.unit.opensim_oracle import ask, random_poses

TABLE = load_table()
MASS = 61.5


def uneven_scales() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(7)
    scales = {body: rng.uniform(0.8, 1.25, 3) for body in TABLE["bodies"]}
    scales["tibia_l"] = np.full(3, 1.1)
    return scales


@functools.cache
def both() -> tuple[dict[str, Any], dict[str, Any], Any, dict[str, list[float]]]:
    """OpenSim's scaled model, a model built from our scaled table, the table, and the poses."""
    q = random_poses(TABLE, 8, seed=2)
    table = scaled_table(TABLE, uneven_scales(), MASS)
    theirs = ask(table=TABLE, scales=uneven_scales(), mass=MASS, poses=q)
    return theirs, ask(table=table, poses=q), table, q


def test_kinematics_of_the_scaled_table_are_opensims():
    theirs, _, table, q = both()
    skeleton = skeleton_from_table(table)
    pose = skeleton.forward({name: np.array(values) for name, values in q.items()})
    for index, body in enumerate(skeleton.bodies):
        np.testing.assert_allclose(pose[body].origin, theirs["position"][:, index], rtol=0, atol=1e-12)
        np.testing.assert_allclose(pose[body].rotation, theirs["rotation"][:, index], rtol=0, atol=1e-12)
    np.testing.assert_allclose(skeleton.markers(pose), theirs["marker"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(skeleton.centre(pose), theirs["com"], rtol=0, atol=1e-12)


def test_masses_and_inertias_are_opensims():
    theirs, _, table, _ = both()
    assert float(theirs["mass"]) == pytest.approx(MASS, abs=1e-12)
    bodies = list(table["bodies"].values())
    np.testing.assert_allclose([b["mass"] for b in bodies], theirs["body_mass"], rtol=1e-13)
    np.testing.assert_allclose([b["com"] for b in bodies], theirs["body_com"], atol=1e-15)
    np.testing.assert_allclose([b["inertia"] for b in bodies], theirs["body_inertia"], rtol=1e-12, atol=1e-17)


def test_muscle_paths_and_wraps_are_opensims():
    theirs, ours, _, _ = both()
    np.testing.assert_allclose(ours["length"], theirs["length"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(ours["wraps"], theirs["wraps"])
    np.testing.assert_allclose(ours["wrap_size"], theirs["wrap_size"], rtol=1e-13)


def test_fibres_differ_from_opensims_only_where_a_muscle_wraps_when_straight():
    theirs, ours, _, _ = both()
    apart = np.abs(ours["fibres"] / theirs["fibres"] - 1.0).max(axis=1)
    assert np.median(apart) < 1e-12
    assert apart.max() < 0.02
    straight = [not TABLE["muscles"][name]["wraps"] for name in ours["muscles"].tolist()]
    assert sum(straight) > 30
    assert apart[straight].max() < 1e-12


@settings(deadline=None, max_examples=25)
@given(st.floats(0.6, 1.5), st.floats(20.0, 150.0))
def test_a_person_of_the_same_build_is_the_model_enlarged(factor, mass):
    table = scaled_table(TABLE, {body: np.full(3, factor) for body in TABLE["bodies"]}, mass)
    model, person = skeleton_from_table(TABLE), skeleton_from_table(table)
    angles = {"hip_flexion_r": 0.7, "knee_angle_r": 1.2, "knee_adduction_r": 0.1, "lumbar_bending": 0.3}
    small, large = model.forward(angles), person.forward(angles)
    for body in model.bodies:
        np.testing.assert_allclose(large[body].origin, factor * small[body].origin, atol=1e-12)
        np.testing.assert_allclose(large[body].rotation, small[body].rotation, atol=1e-12)
    np.testing.assert_allclose(person.masses, model.masses * mass / model.mass, rtol=1e-12)
    np.testing.assert_allclose(
        person.inertia, model.inertia * factor**2 * mass / model.mass, rtol=1e-9, atol=1e-18
    )
    for name, muscle in table["muscles"].items():
        assert muscle["tendon_slack_length"] == pytest.approx(
            factor * TABLE["muscles"][name]["tendon_slack_length"], rel=1e-9
        )


@settings(deadline=None)
@given(st.lists(st.floats(0.7, 1.4), min_size=3, max_size=3), st.integers(0, 2))
def test_an_uneven_cylinder_is_the_stretched_cylinder(factor, axis):
    mass, radius, length = 3.0, 0.06, 0.4

    def moments(radius_squared: float, long: float) -> np.ndarray:
        values = np.full(3, mass * (long**2 / 12 + radius_squared / 4))
        values[axis] = mass * radius_squared / 2
        return values

    body: Any = {"mass": mass, "com": [0.0, 0.0, 0.0], "inertia": [*moments(radius**2, length), 0, 0, 0]}
    across = [f for k, f in enumerate(factor) if k != axis]
    expected = moments(radius**2 * across[0] * across[1], length * factor[axis])
    if max(factor) - min(factor) > 1e-6:
        np.testing.assert_allclose(scaled_inertia(body, np.array(factor))[:3], expected, rtol=1e-9)


def test_an_unchanged_model_stays_as_it_is():
    table = scaled_table(TABLE, {}, skeleton_from_table(TABLE).mass)
    assert table["joints"] == TABLE["joints"]
    assert table["markers"] == TABLE["markers"]
    for name, muscle in table["muscles"].items():
        before = TABLE["muscles"][name]
        assert muscle["points"] == before["points"]
        assert muscle["optimal_fiber_length"] == pytest.approx(before["optimal_fiber_length"], rel=1e-12)


def test_the_unscaled_table_is_not_touched():
    before = load_table()
    scaled_table(before, uneven_scales(), MASS)
    assert before == load_table()


@pytest.mark.malformed
@pytest.mark.parametrize(
    ("scales", "mass", "what"),
    [
        ({"shin": np.ones(3)}, 60.0, "shin"),
        ({"tibia_r": np.array([1.0, 0.0, 1.0])}, 60.0, "tibia_r"),
        ({"tibia_r": np.array([1.0, np.nan, 1.0])}, 60.0, "tibia_r"),
        ({"tibia_r": np.ones(2)}, 60.0, "tibia_r"),
        ({}, 0.0, "mass"),
        ({}, float("nan"), "mass"),
    ],
)
def test_senseless_scales_are_refused(scales, mass, what):
    with pytest.raises(InputError, match=what):
        scaled_table(TABLE, scales, mass)
