"""The synthetic subject obeys mechanics, its model's limits, and its own ground."""

from __future__ import annotations

import functools
import importlib
import itertools

import numpy as np
import pytest

from hilbrace.errors import ConfigError, SolverError
from hilbrace.motion.synthetic import SyntheticMotion, generate
from hilbrace.motion.synthetic.feet import BALL, HALF_WIDTH, HEEL, TOE_TIP
from hilbrace.motion.synthetic.gait import SPEED, STANCE, STRIDE
from hilbrace.skeleton.kinematics import Pose, skeleton_from_table
from hilbrace.skeleton.table import coordinate_ranges, load_table
from hilbrace.units import DEG, GRAVITY

NAMES = ("serve", "gait", "squat")
FLIGHT = (1.45, 1.72)
"""Take-off and touch-down of the serve [s]."""


@functools.cache
def motion(name: str) -> SyntheticMotion:
    return generate(name)


@functools.cache
def pose(name: str) -> Pose:
    return skeleton_from_table(load_table()).forward(motion(name).coordinates)


def airborne(name: str) -> np.ndarray:
    time = motion(name).time
    inside = (time > FLIGHT[0] + 1e-9) & (time < FLIGHT[1] - 1e-9)
    return inside if name == "serve" else np.zeros(len(time), dtype=bool)


def second_derivative(values: np.ndarray, rate_hz: float) -> np.ndarray:
    """Central differences, one frame shorter at both ends."""
    return (values[2:] - 2 * values[1:-1] + values[:-2]) * rate_hz**2


@pytest.mark.parametrize("name", NAMES)
def test_feet_supply_all_that_the_body_needs_while_they_are_loaded(name: str) -> None:
    case = motion(name)
    force, moment = case.forces.total()
    loaded = case.forces.force[:, :, 1].sum(axis=1) > 1.0
    weight = case.mass_kg * GRAVITY
    assert loaded.mean() > 0.85
    assert np.abs(case.wrench.force - force).max() < 1e-6 * weight
    assert np.abs(case.wrench.moment - moment)[loaded].max() < 1e-6 * weight


@pytest.mark.parametrize("name", NAMES)
def test_unloaded_residual_moment_is_below_one_percent_of_weight_times_height(name: str) -> None:
    """Bound of Hicks et al. 2015 (J. Biomech. Eng. 137): 1 % of COM height times the largest force."""
    case = motion(name)
    _, moment = case.forces.total()
    residual = np.abs(case.wrench.moment - moment)
    bound = 0.01 * case.com[:, 1].mean() * np.linalg.norm(case.wrench.force, axis=1).max()
    assert residual.max() < bound
    assert np.sqrt(np.mean(residual**2)) < 0.05 * bound


@pytest.mark.parametrize("name", NAMES)
def test_force_follows_from_the_motion_of_the_bodies(name: str) -> None:
    """Newton's law on body positions recomputed from the coordinates alone, by finite differences."""
    case = motion(name)
    com = skeleton_from_table(load_table()).centre(pose(name))
    acceleration = second_derivative(com, case.rate_hz)
    force = case.forces.force.sum(axis=1)[1:-1]
    expected = case.mass_kg * (acceleration + np.array([0.0, GRAVITY, 0.0]))
    weight = case.mass_kg * GRAVITY
    assert np.sqrt(np.mean((force - expected) ** 2)) < 0.01 * weight
    assert np.abs(force - expected).max() < 0.10 * weight


def test_flight_is_ballistic() -> None:
    case, free = motion("serve"), airborne("serve")
    inside = free[1:-1] & free[2:] & free[:-2]
    acceleration = second_derivative(case.com, case.rate_hz)[inside]
    assert np.abs(acceleration - [0.0, -GRAVITY, 0.0]).max() < 1e-5
    assert not case.forces.force[free].any()
    assert not case.forces.free_moment[free].any()
    assert np.ptp(case.wrench.angular_momentum[free], axis=0).max() < 0.25


@pytest.mark.parametrize("name", NAMES)
def test_impulse_balances_momentum(name: str) -> None:
    case = motion(name)
    force = case.forces.force.sum(axis=1) - np.array([0.0, case.mass_kg * GRAVITY, 0.0])
    impulse = np.trapezoid(force, case.time, axis=0)
    velocity = np.gradient(case.com, case.time, axis=0, edge_order=2)
    change = case.mass_kg * (velocity[-1] - velocity[0])
    assert np.abs(impulse - change).max() < 0.002 * case.mass_kg * GRAVITY * case.time[-1]


@pytest.mark.parametrize("name", NAMES)
def test_coordinates_stay_inside_the_models_ranges(name: str) -> None:
    case = motion(name)
    for item in coordinate_ranges(load_table()):
        if item.follows is None:
            values = case.coordinates[item.name]
            assert values.min() >= item.low, item.name
            assert values.max() <= item.high, item.name
    for side in "rl":
        assert np.array_equal(
            case.coordinates[f"knee_angle_{side}_beta"], case.coordinates[f"knee_angle_{side}"]
        )


@pytest.mark.parametrize("name", NAMES)
def test_loaded_feet_do_not_move(name: str) -> None:
    """Heel, ball or toe tip of a loaded foot stays where it stands, and nothing goes below the floor."""
    case = motion(name)
    for k, side in enumerate("rl"):
        foot = pose(name)[f"calcn_{side}"]
        loaded = case.forces.force[:, k, 1] > 20.0
        paths = [foot.origin + foot.rotation @ point for point in (HEEL, BALL, TOE_TIP)]
        assert min(path[:, 1].min() for path in paths[:2]) > -1e-6
        both = loaded[1:] & loaded[:-1]
        steps = np.stack([np.linalg.norm(np.diff(path, axis=0), axis=1) for path in paths[:2]])
        tip = toe_tip_speed(case, side)
        slowest = np.minimum(steps.min(axis=0), tip)[both]
        assert slowest.max() * case.rate_hz < 0.12
        assert slowest.sum() < 0.012


def toe_tip_speed(case: SyntheticMotion, side: str) -> np.ndarray:
    """Travel per frame of the end of the toes [m]."""
    toes = pose(case.name)[f"toes_{side}"]
    tip = toes.origin + toes.rotation @ np.array([0.06, 0.002, 0.0])
    return np.linalg.norm(np.diff(tip, axis=0), axis=1)


@pytest.mark.parametrize("name", NAMES)
def test_centre_of_pressure_lies_in_the_foot(name: str) -> None:
    case = motion(name)
    for k, side in enumerate("rl"):
        foot = pose(name)[f"calcn_{side}"]
        loaded = case.forces.force[:, k, 1] > 50.0
        local = np.einsum("tji,tj->ti", foot.rotation, case.forces.centre_of_pressure[:, k] - foot.origin)
        assert local[loaded, 0].min() > HEEL[0] - 0.02
        assert local[loaded, 0].max() < TOE_TIP[0] + 0.01
        assert np.abs(local[loaded, 2]).max() < HALF_WIDTH


@pytest.mark.parametrize("name", NAMES)
def test_friction_and_free_moments_are_those_of_shoes_on_a_floor(name: str) -> None:
    case = motion(name)
    force = case.forces.force
    loaded = force[:, :, 1] > 50.0
    ratio = np.hypot(force[..., 0], force[..., 2])[loaded] / force[..., 1][loaded]
    assert ratio.max() < 0.4
    assert np.abs(case.forces.free_moment).max() < 12.0
    assert force[:, :, 1].min() >= 0.0


def test_serve_bends_jumps_and_lands_with_adducting_knees() -> None:
    case = motion("serve")
    weight = case.mass_kg * GRAVITY
    peak = case.forces.force[:, :, 1].max(axis=0) / weight
    assert ((peak > 1.2) & (peak < 2.0)).all()
    after = case.time > FLIGHT[1]
    for side, adduction in (("r", 3.0), ("l", 5.0)):
        knee = case.coordinates[f"knee_angle_{side}"] / DEG
        assert 70 < knee[case.time < FLIGHT[0]].max() < 95
        assert 70 < knee[after].max() < 95
        assert case.coordinates[f"knee_adduction_{side}"][after].max() / DEG == pytest.approx(
            adduction, abs=0.2
        )
    toes = pose("serve")["toes_r"].origin[:, 1]
    assert toes[airborne("serve")].max() > 0.03


def test_gait_walks_upright() -> None:
    case = motion("gait")
    speed = np.polyfit(case.time, case.com[:, 0], 1)[0]
    assert speed == pytest.approx(SPEED, abs=0.02)
    start = -0.2 * STRIDE
    for side, lag in (("r", 0.0), ("l", 0.5)):
        phase = ((case.time + start) / STRIDE - lag) % 1.0
        knee = case.coordinates[f"knee_angle_{side}"] / DEG
        middle = (phase > 0.12) & (phase < 0.42)
        assert 5 < knee[middle].min() < 15
        assert knee[middle].max() < 22
        assert knee[phase < STANCE * 0.6].max() < 26
        assert knee[phase > STANCE].max() > 50
        toes = pose("gait")[f"toes_{side}"]
        swinging = (phase > 0.85) & (phase < 0.97)
        assert toes.rotation[swinging, 1, 0].min() > -0.1


def test_gait_is_the_same_on_both_sides() -> None:
    case = motion("gait")
    half = round(STRIDE / 2 * case.rate_hz)
    right, left = case.coordinates["knee_angle_r"], case.coordinates["knee_angle_l"]
    assert np.abs(right[:-half] - left[half:]).max() < 1e-8
    assert np.allclose(case.forces.force[:-half, 0] * [1, 1, -1], case.forces.force[half:, 1], atol=1e-4)


def test_each_step_of_the_gait_has_a_plate_of_its_own() -> None:
    case = motion("gait")
    edges = [(plate.centre[0] - plate.half[0], plate.centre[0] + plate.half[0]) for plate in case.plates]
    assert [plate.foot for plate in case.plates] == ["l", "r", "l", "r"]
    assert all(a[1] <= b[0] for a, b in itertools.pairwise(edges))
    for plate in case.plates:
        k = "rl".index(plate.foot)
        inside = (case.time >= plate.interval[0]) & (case.time <= plate.interval[1])
        loaded = inside & (case.forces.force[:, k, 1] > 20.0)
        offset = np.abs(case.forces.centre_of_pressure[loaded, k][:, [0, 2]] - plate.centre)
        assert (offset < plate.half).all()
    total = sum(
        (case.forces.force[:, "rl".index(p.foot), 1] > 0)
        & (case.time >= p.interval[0] - 1e-9)
        & (case.time <= p.interval[1] + 1e-9)
        for p in case.plates
    )
    assert np.array_equal(total, (case.forces.force[:, :, 1] > 0).sum(axis=1))


def test_markers_are_ninety_six_names_with_the_noise_asked_for() -> None:
    case = motion("squat")
    assert len(case.marker_names) == len(set(case.marker_names)) == 96
    assert not any(name.endswith("JC") for name in case.marker_names)
    noise = case.markers - case.true_markers
    assert np.std(noise) == pytest.approx(case.noise_m, rel=0.01)
    assert np.abs(case.static_markers - case.static.markers[0]).max() < 6 * case.noise_m
    distances = np.linalg.norm(case.true_markers[0][:, None] - case.true_markers[0][None], axis=2)
    assert distances[np.triu_indices(96, 1)].min() > 0.015


def test_marker_sides_mirror_each_other_in_the_standing_trial() -> None:
    case = generate("squat", rate_hz=100, noise_m=0.0)
    place = dict(zip(case.marker_names, case.static_markers, strict=True))
    for name, right in place.items():
        if name.startswith("R_"):
            assert np.allclose(right * [1, 1, -1], place["L_" + name[2:]], atol=1e-9), name


def test_seed_decides_the_noise_and_nothing_else() -> None:
    one, same, other = (generate("squat", rate_hz=60, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(one.markers, same.markers)
    assert not np.array_equal(one.markers, other.markers)
    assert np.array_equal(one.true_markers, other.true_markers)
    assert np.array_equal(one.forces.force, other.forces.force)


@pytest.mark.parametrize("rate", [60.0, 128.0])
def test_the_motion_does_not_depend_on_the_rate(rate: float) -> None:
    coarse, fine = generate("squat", rate_hz=rate), motion("squat")
    knee = np.interp(coarse.time, fine.time, fine.coordinates["knee_angle_l"])
    assert np.abs(coarse.coordinates["knee_angle_l"] - knee).max() < 1e-4
    assert coarse.time[-1] == pytest.approx(fine.time[-1], abs=1 / rate)


def test_nonsense_is_refused() -> None:
    with pytest.raises(ConfigError, match="smash"):
        generate("smash")
    with pytest.raises(ConfigError, match="rate"):
        generate("squat", rate_hz=5)
    with pytest.raises(ConfigError, match="noise"):
        generate("squat", noise_m=-1)


def test_coefficients_of_another_version_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("hilbrace.motion.synthetic.generate")
    monkeypatch.setattr(module, "stored_coefficients", lambda name: np.zeros((7, 6)))
    with pytest.raises(SolverError, match="coefficients"):
        generate("squat")
