"""The fit of a jointed model to markers: on a chain whose kinematics stand here, and against OpenSim."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.biomech.engine import Engine
from hilbrace.biomech.marker_fit import SHARED_WEIGHT_M2, Carriers, Problem, fit_frame, linearise
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.errors import SolverError
from hilbrace.skeleton.kinematics import rotation_about
from tests.unit.biomech_oracle import ask

AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
LINK = np.array([0.0, -0.4, 0.05])
BODY = np.array([0, 0, 0, 1, 1, 1, 2, 2])
LOCATIONS = np.random.default_rng(1).uniform(-0.2, 0.2, (len(BODY), 3))
WEIGHTS = np.linspace(0.2, 1.0, len(BODY))


def chain(q: np.ndarray) -> Carriers:
    """A base that moves in space, and three turns, one body after the other, each ``LINK`` further out."""
    frame, origin = np.eye(3), q[:3].copy()
    turn = np.zeros((3, 6))
    rotations, origins, velocities = [], [], []
    centres: list[np.ndarray] = []
    for k, axis in enumerate(AXES):
        turn = turn.copy()
        turn[:, 3 + k] = frame @ axis
        centres.append(origin.copy())
        frame = frame @ rotation_about(axis, np.array(q[3 + k]))
        shift = np.zeros((3, 6))
        shift[:, :3] = np.eye(3)
        for j in range(k + 1):
            shift[:, 3 + j] = np.cross(turn[:, 3 + j], origin - centres[j])
        rotations.append(frame)
        origins.append(origin.copy())
        velocities.append(np.stack([turn, shift]))
        origin = origin + frame @ LINK
    return Carriers(np.array(rotations)[BODY], np.array(origins)[BODY], np.array(velocities)[BODY])


def problem(stiffness: float = 0.0, free: tuple[int, ...] = tuple(range(6))) -> Problem:
    return Problem(
        carriers=chain,
        couple=lambda q: None,
        locations=LOCATIONS,
        weights=WEIGHTS,
        free=np.array(free),
        stiffness=np.full(len(free), stiffness),
        rest=np.zeros(6),
    )


def markers(q: np.ndarray) -> np.ndarray:
    bodies = chain(q)
    return bodies.origins + np.einsum("mij,mj->mi", bodies.rotations, LOCATIONS)


POSES = st.lists(st.floats(-0.6, 0.6), min_size=6, max_size=6).map(np.array)


@settings(deadline=None, max_examples=30)
@given(POSES)
def test_a_known_pose_is_found_from_afar(pose):
    found, distance, support = fit_frame(problem(), markers(pose), np.zeros(6), 0)
    assert np.abs(found - pose).max() < 1e-6
    assert distance.max() < 1e-6
    assert (support > 0).all()


@settings(deadline=None, max_examples=30)
@given(POSES, st.integers(0, 1000))
def test_gradient_and_second_derivative_are_those_of_the_cost(pose, seed):
    """Central differences; targets lie off the model, so that the markers' arcs count."""
    targets = markers(pose) + np.random.default_rng(seed).normal(0.0, 0.1, (len(BODY), 3))
    task = problem(stiffness=0.02)
    here = pose + 0.1
    at = linearise(task, targets, WEIGHTS, here)
    step = 1e-5
    slope, bend = np.empty(6), np.empty((6, 6))
    for k in range(6):
        away = np.eye(6)[k] * step
        after, before = (linearise(task, targets, WEIGHTS, here + sign * away) for sign in (1, -1))
        slope[k] = (after.cost - before.cost) / (2 * step)
        bend[k] = -(after.descent - before.descent) / (2 * step)
    assert np.allclose(-2.0 * at.descent, slope, rtol=1e-6, atol=1e-8)
    assert np.allclose(at.information + at.curvature, bend, rtol=1e-5, atol=1e-7)


def test_the_jacobian_of_the_chain_is_right():
    """The oracle above is worth no more than its own velocities."""
    pose, step = np.linspace(-0.4, 0.5, 6), 1e-6
    bodies = chain(pose)
    arms = np.einsum("mij,mj->mi", bodies.rotations, LOCATIONS)
    slopes = bodies.velocities[:, 1] + np.cross(bodies.velocities[:, 0], arms[:, :, None], axis=1)
    for k in range(6):
        away = np.eye(6)[k] * step
        assert np.allclose(
            slopes[:, :, k], (markers(pose + away) - markers(pose - away)) / (2 * step), atol=1e-8
        )


def test_hidden_markers_do_not_count():
    pose = np.linspace(-0.3, 0.4, 6)
    points = markers(pose)
    points[[1, 4]] = np.nan
    found, distance, _ = fit_frame(problem(), points, np.zeros(6), 0)
    assert np.abs(found - pose).max() < 1e-6
    assert np.flatnonzero(np.isnan(distance)).tolist() == [1, 4]


def test_what_no_marker_shows_stays_at_rest_and_says_so():
    pose = np.linspace(-0.3, 0.4, 6)
    points = markers(pose)
    points[BODY == 2] = np.nan
    found, _, support = fit_frame(problem(stiffness=1e-5), points, np.zeros(6), 0)
    assert abs(found[5]) < 1e-6
    assert support[5] == 0.0
    assert (support[:5] > 1e-3).all()


def test_a_hold_weighs_as_bayes_says():
    """One turn about a fixed axis: the estimate is information / (information + hold) of the truth."""
    task = problem(stiffness=0.05, free=(3,))
    angle = np.array([0.0, 0.0, 0.0, 0.02, 0.0, 0.0])
    information = linearise(problem(free=(3,)), markers(angle), WEIGHTS, angle).information[0, 0]
    found, _, _ = fit_frame(task, markers(angle), np.zeros(6), 0)
    assert found[3] == pytest.approx(0.02 * information / (information + 0.05), rel=1e-3)


def test_a_search_without_end_is_refused_with_its_frame():
    calls = iter(range(10_000))

    def drifting(q: np.ndarray) -> Carriers:
        """A model that runs away from the markers, ever more slowly."""
        bodies = chain(q)
        return bodies._replace(origins=bodies.origins + np.array([0.995 ** next(calls), 0.0, 0.0]))

    task = problem()._replace(carriers=drifting)
    with pytest.raises(SolverError, match="cannot be brought onto the markers") as refused:
        fit_frame(task, markers(np.full(6, 0.3)), np.zeros(6), 41)
    assert refused.value.where == "frame 42"


def shared(away: np.ndarray) -> np.ndarray:
    """Cost of the weak hold that every coordinate has in our fit alone [m^2]."""
    return SHARED_WEIGHT_M2 * (away**2).sum(axis=1)


@pytest.mark.slow
def test_the_weighted_cost_is_never_above_that_of_opensim_s_tool():
    """Markers 2 cm off, weights of 0.1 to 1, against the InverseKinematicsTool at its tightest accuracy."""
    with Engine() as engine:
        figures = ModelFigures(**engine.call("build_model", bodies=(), scales=np.zeros((0, 3)), mass_kg=70.0))
        names = tuple(figures.marker_bodies)
        bodies = tuple(figures.marker_bodies.values())
        locations = np.array(list(figures.marker_locations.values()))
        random = np.random.default_rng(4)
        weights = random.uniform(0.1, 1.0, len(names))
        pose = np.zeros((5, len(figures.coordinates)))
        for k, name in enumerate(figures.coordinates):
            if name not in figures.locked and not name.startswith("pelvis_t"):
                pose[:, k] = 0.3 * np.sin(np.linspace(0.0, 0.2, 5) + 7.0 * random.random())
        for side in "rl":
            pose[:, figures.coordinates.index(f"knee_angle_{side}")] += 0.5
            pose[:, figures.coordinates.index(f"elbow_flex_{side}")] += 0.5

        def model_markers(values: np.ndarray) -> np.ndarray:
            frames = engine.call("poses", coordinates=values)
            rows = figures.rows(bodies)
            arms = np.einsum("fmij,mj->fmi", frames["rotations"][:, rows], locations)
            return frames["origins"][:, rows] + arms

        measured = model_markers(pose) + random.normal(0.0, 0.02, (5, len(names), 3))
        ours = engine.call(
            "inverse_kinematics",
            bodies=bodies,
            locations=locations,
            weights=weights,
            measured=measured,
            start=pose[0],
            fixed=figures.locked,
        )
        theirs = ask(
            "inverse_kinematics_tool",
            mass_kg=np.array(70.0),
            locked=np.array(figures.locked),
            markers=np.array(names),
            weights=weights,
            measured=measured,
            start_names=np.array(figures.coordinates),
            start=pose[0],
        )
        legs = [k for k, n in enumerate(figures.coordinates) if n.startswith(("hip", "knee", "ankle"))]
        columns = [theirs["names"].tolist().index(name) for name in figures.coordinates]
        their_error = np.linalg.norm(model_markers(theirs["coordinates"][:, columns]) - measured, axis=2)
    their_poses = theirs["coordinates"][:, columns]
    our_cost = (weights * ours["errors"] ** 2).sum(axis=1) + shared(ours["coordinates"] - pose[0])
    their_cost = (weights * their_error**2).sum(axis=1) + shared(their_poses - pose[0])
    assert (our_cost <= their_cost * (1 + 1e-9)).all()
    assert (our_cost > 0.99 * their_cost).all()  # it is the same problem
    assert np.abs(ours["coordinates"] - their_poses)[:, legs].max() < np.radians(0.1)
