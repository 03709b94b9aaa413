"""The parts a synthetic motion is made of: curves, height plan, rockers, splines, wrench, optimiser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import SolverError
from hilbrace.motion.synthetic import optimise
from hilbrace.motion.synthetic.coefficients import StoredCoefficients, store_coefficients, stored_coefficients
from hilbrace.motion.synthetic.curves import basis, clamped_knots, glide, hump, pulse, ramp, time_derivative
from hilbrace.motion.synthetic.feet import BALL, HEEL, TOE_TIP, Rockers, foot_path
from hilbrace.motion.synthetic.height_plan import Waypoint, plan_height
from hilbrace.motion.synthetic.motions import MOTIONS, motion
from hilbrace.motion.synthetic.solver import rotation_vector
from hilbrace.motion.synthetic.wrench import body_wrench
from hilbrace.run.records import load
from hilbrace.skeleton.kinematics import rotation_about, skeleton_from_table
from hilbrace.skeleton.table import load_table
from hilbrace.units import GRAVITY

TIME = np.linspace(-0.5, 1.5, 4001)
DENSE = 2.0 / 4000

STORED_COST = {"serve": 1100.0, "gait": 620.0, "squat": 5.0}
"""What the optimiser reached, rounded up; coefficients of another problem cost many times more."""


@pytest.mark.parametrize("curve", [ramp, hump, lambda t, a, b: glide(t, a, b, 0.4, 0.3)])
def test_curves_rest_outside_their_interval_and_are_smooth(curve) -> None:
    values = curve(TIME, 0.0, 1.0)
    assert not values[TIME <= 0].any()
    assert np.ptp(values[TIME >= 1]) < 1e-12
    acceleration = np.gradient(np.gradient(values, DENSE), DENSE)
    assert np.abs(np.diff(acceleration)).max() < 0.3


def test_curves_have_the_heights_they_promise() -> None:
    assert ramp(np.array([0.5, 2.0]), 0.0, 1.0) == pytest.approx([0.5, 1.0])
    assert hump(np.array([0.5]), 0.0, 1.0) == pytest.approx([1.0])
    assert pulse(np.array([0.0, 0.5, 1.0]), 0.1, 0.4, 0.6, 0.9) == pytest.approx([0.0, 1.0, 0.0])
    assert glide(np.array([1.0]), 0.0, 1.0, 0.4, 0.3) == pytest.approx([1.0])
    middle = glide(np.array([0.5, 0.6]), 0.0, 1.0, 0.4, 0.3)
    assert (middle[1] - middle[0]) / 0.1 == pytest.approx(1 / (1 - 0.35))


def test_time_derivative_is_exact_for_quintic_polynomials() -> None:
    time = np.linspace(0.0, 1.0, 40)
    polynomial = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0, -1.0, 0.7])
    assert time_derivative(time) @ polynomial(time) == pytest.approx(polynomial.deriv()(time), abs=1e-9)


def test_fine_knots_lie_where_they_are_wanted() -> None:
    knots = clamped_knots(0.0, 1.0, 0.1, 5, (0.4, 0.6, 0.02))
    assert (np.diff(knots) >= 0).all()
    inside = knots[(knots > 0.39) & (knots < 0.61)]
    assert np.diff(inside).max() < 0.021
    assert basis(knots, 5)(np.linspace(0, 1, 33)).sum(axis=1) == pytest.approx(np.ones(33))


@settings(deadline=None, max_examples=15)
@given(rise=st.floats(0.02, 0.08), depth=st.floats(0.10, 0.18))
def test_planned_height_keeps_its_waypoints_and_never_pulls(rise: float, depth: float) -> None:
    speed, airtime = np.sqrt(2 * GRAVITY * rise), 2 * np.sqrt(2 * rise / GRAVITY)
    points = [
        Waypoint(0.0, 0.9),
        Waypoint(0.8, 0.9 - depth),
        Waypoint(1.1, 0.9, speed),
        Waypoint(1.1 + airtime + 0.4, 0.9 - depth),
        Waypoint(2.8, 0.9),
    ]
    plan = plan_height(points, flight=(1.1, 1.1 + airtime))
    time = np.linspace(0.0, 2.8, 1401)
    assert plan.height(np.array([p.time for p in points])) == pytest.approx(
        [p.height for p in points], abs=1e-5
    )
    assert plan.acceleration(time).min() > -GRAVITY - 1e-6
    air = (time > 1.1) & (time < 1.1 + airtime)
    assert np.abs(plan.acceleration(time[air]) + GRAVITY).max() < 1e-6
    assert np.trapezoid(plan.acceleration(time), time) == pytest.approx(0.0, abs=1e-4)
    highest = plan.height(time[air]).max()
    assert highest == pytest.approx(0.9 + rise, abs=1e-4)


def test_waypoints_that_need_a_pull_are_refused() -> None:
    with pytest.raises(SolverError, match="waypoint"):
        plan_height([Waypoint(0.0, 1.0), Waypoint(0.3, 0.2), Waypoint(1.0, 1.0)])


@given(angle=st.floats(0.0, 0.5), yaw=st.floats(-0.4, 0.4), which=st.sampled_from([0, 1, 2]))
def test_each_rocker_keeps_its_pivot_on_the_floor(angle: float, yaw: float, which: int) -> None:
    place = np.array([[0.3, 0.0, -0.1]])
    flat = foot_path(place, yaw, Rockers(*np.zeros((3, 1))))
    angles = np.zeros((3, 1))
    angles[which] = angle
    turned = foot_path(place, yaw, Rockers(*angles))
    pivot = (HEEL, BALL, TOE_TIP)[which]
    assert turned.point(pivot) == pytest.approx(flat.point(pivot), abs=1e-12)
    assert turned.point(HEEL)[0, 1] >= -1e-12
    toes_up = turned.rotation[0, 1, 0]
    assert toes_up == pytest.approx(np.sin(angle) * (1 if which == 0 else -1), abs=1e-12)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_rotation_vector_inverts_rodrigues(vector: tuple[float, float, float]) -> None:
    angle = np.linalg.norm(vector)
    axis = np.array(vector) / angle if angle > 1e-3 else np.array([1.0, 0.0, 0.0])
    matrix = rotation_about(axis, np.array([angle]))
    assert rotation_vector(matrix)[0] == pytest.approx(axis * angle, abs=1e-7)


def test_wrench_of_a_body_at_rest_is_its_weight() -> None:
    skeleton = skeleton_from_table(load_table())
    time = np.linspace(0, 0.5, 20)
    pose = skeleton.forward({"pelvis_ty": np.ones(20), "knee_angle_r": np.full(20, 0.4)})
    wrench = body_wrench(skeleton, pose, np.zeros((20, 3)), time_derivative(time))
    com = skeleton.centre(pose)
    assert wrench.force == pytest.approx(np.tile([0.0, skeleton.mass * GRAVITY, 0.0], (20, 1)))
    assert wrench.moment == pytest.approx(np.cross(com, wrench.force), abs=1e-8)


def test_wrench_of_a_spinning_body_is_that_of_one_rigid_body() -> None:
    """All bodies turn about the vertical through the ground's origin: closed form from the total inertia."""
    skeleton = skeleton_from_table(load_table())
    time = np.linspace(0, 1, 201)
    angle, rate, change = 0.5 * time**2, time, np.ones_like(time)
    pose = skeleton.forward({"pelvis_rotation": angle})
    com = skeleton.centre(pose)
    vertical = np.array([0.0, 1.0, 0.0])
    acceleration = change[:, None] * np.cross(vertical, com) - rate[:, None] ** 2 * com * [1, 0, 1]
    wrench = body_wrench(skeleton, pose, acceleration, time_derivative(time))
    still = skeleton.forward({})
    centres = skeleton.centres(still)[0]
    about_axis = sum(
        (still[body].rotation[0] @ skeleton.inertia[k] @ still[body].rotation[0].T)[1, 1]
        + skeleton.masses[k] * (centres[k, 0] ** 2 + centres[k, 2] ** 2)
        for k, body in enumerate(skeleton.bodies)
    )
    assert wrench.moment[5:-5, 1] == pytest.approx(np.full(191, about_axis), rel=1e-6)


@pytest.mark.parametrize("name", sorted(MOTIONS))
def test_stored_coefficients_solve_the_optimisers_problem(name: str) -> None:
    task = optimise.problem(name)
    found = optimise.evaluate(task, stored_coefficients(name), None)
    assert found.solution.error < 1e-8
    assert found.residual @ found.residual < STORED_COST[name]
    start = optimise.evaluate(task, task.motion.reference, None)
    assert start.residual @ start.residual > 30 * (found.residual @ found.residual)


def test_fixed_coefficients_are_those_of_the_reference() -> None:
    for name in MOTIONS:
        task = motion(name)
        fixed = ~task.free
        assert stored_coefficients(name)[fixed] == pytest.approx(task.reference[fixed], abs=1e-8)


def test_slopes_of_the_optimiser_agree_with_central_differences() -> None:
    """Probes shared by coefficients that act on distant frames give the slopes of single probes."""
    task = optimise.problem("squat")
    coefficients = stored_coefficients("squat") + 0.002
    current = optimise.evaluate(task, coefficients, None)
    slopes = optimise._jacobian(task, coefficients, current)
    unknowns = np.argwhere(task.motion.free)
    for k in (3, 20, len(unknowns) - 4):
        step = np.zeros_like(coefficients)
        step[tuple(unknowns[k])] = 1e-4
        ahead, behind = (
            optimise.evaluate(task, coefficients + s * step, current.solution).residual for s in (1, -1)
        )
        single = (ahead - behind) / 2e-4
        assert np.linalg.norm(slopes[:, k] - single) < 0.02 * np.linalg.norm(single)


def test_optimiser_lowers_the_cost_and_writes_what_it_found(tmp_path: Path) -> None:
    path = tmp_path / "squat.npz"
    assert optimise.main(["squat", "--iterations", "1", "--out", str(path)]) == 0
    task = optimise.problem("squat")
    before = optimise.evaluate(task, task.motion.reference, None).residual
    after = optimise.evaluate(task, load(StoredCoefficients, path).values, None).residual
    assert after @ after < 0.2 * (before @ before)
    again = tmp_path / "again.npz"
    store_coefficients("squat", load(StoredCoefficients, path).values, again)
    assert again.read_bytes() == path.read_bytes()


def test_horizontal_flight_of_the_serve_is_straight_by_construction() -> None:
    """Whatever the coefficients, the centre of mass has no horizontal acceleration in flight."""
    task = motion("serve")
    time = np.linspace(1.45, 1.72, 28)
    plan = task.plan(time)
    random = np.random.default_rng(5)
    coefficients = np.where(task.free, random.normal(size=task.free.shape), task.reference)
    acceleration = plan.root.com_acceleration(coefficients)
    assert np.abs(acceleration[:, [0, 2]]).max() < 1e-6
