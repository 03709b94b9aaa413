"""What the OpenSim process does: hold a model, find poses from markers, report poses as arrays.

Only this module and `hilbrace.biomech.opensim_model` import OpenSim, and only the process that
`hilbrace.biomech.engine.Engine` starts imports them.

Inverse kinematics is a weighted least-squares fit of the whole model to all markers (Lu & O'Connor, "Bone
position estimation from skin marker co-ordinates using global optimisation with joint constraints",
J. Biomech. 32, 1999), solved frame by frame by Levenberg-Marquardt steps with the system Jacobian of the
multibody code.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import opensim as osim
from jaxtyping import Float, Int
from scipy.linalg import solve_triangular

from hilbrace.biomech import opensim_model
from hilbrace.errors import InputError, SolverError
from hilbrace.skeleton.table import load_table

Array = np.ndarray
Report = Callable[[int, int], None]
Variables = Float[Array, " variable"]
"""Values of all coordinates, coupled ones included, in the order of the multibody code [rad or m]."""

osim.Logger.setLevelString("Off")
osim.Logger.removeFileSink()

REPORT_EVERY_S = 0.2
STEP_TOLERANCE = 1e-7
"""Largest change of a coordinate [rad or m] at which a pose counts as found."""
LONGEST_STEP = 0.3
"""Largest change of a coordinate in one step [rad or m], so that no limb swings over into another minimum."""
MAX_STEPS = 300
SHARED_WEIGHT_M2 = 1e-5
"""Stiffness [m^2] that holds every free coordinate near its start: as much as one marker of weight 1 at 3 mm.

It decides only where the markers do not (a forearm with one marker); angles of a leg move by a few hundredths
of a degree.
"""


class Problem(NamedTuple):
    """What stays the same over the frames of an inverse-kinematics fit.

    Attributes:
        carriers: Bodies that carry markers.
        carrier: Which of them carries each marker.
        rows: Each marker's body in the system Jacobian.
        locations: Place of each marker in its body [m].
        weights: Weight of each marker [-].
        free: Columns of the coordinates that are sought.
        stiffness: Stiffness that holds each of them near ``rest`` [m^2].
        rest: Start of the search and centre of the hold.
    """

    carriers: tuple[str, ...]
    carrier: Int[Array, " marker"]
    rows: Int[Array, " marker"]
    locations: Float[Array, "marker 3"]
    weights: Float[Array, " marker"]
    free: Int[Array, " free"]
    stiffness: Float[Array, " free"]
    rest: Variables


class Linearised(NamedTuple):
    """The cost of a fit about a pose.

    Attributes:
        cost: Weighted sum of squares [m^2].
        descent: Half its negative gradient.
        information: Half its second derivative for straight paths of the markers (Gauss-Newton).
        curvature: What the curvature of their paths adds to it.
        difference: Measured less model marker [m].
    """

    cost: float
    descent: Float[Array, " free"]
    information: Float[Array, "free free"]
    curvature: Float[Array, "free free"]
    difference: Float[Array, "marker 3"]


class Worker:
    """One model and the tasks that use it. Every public method is a task of the engine.

    Args:
        report: Called with (done, total) during long tasks.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._said = 0.0

    def build_model(
        self, bodies: Sequence[str], scales: Float[Array, "body 3"], mass_kg: float
    ) -> dict[str, Any]:
        """Take the built-in model, scaled.

        Args:
            bodies: Names of the bodies that ``scales`` belong to.
            scales: Factors along each body's axes [-].
            mass_kg: Mass of the scaled model [kg].

        Returns:
            See `read_model`.
        """
        model = opensim_model.build_model(load_table())
        factors = dict(zip(bodies, np.asarray(scales, dtype=float), strict=True))
        return self._take(opensim_model.scale_model(model, factors, mass_kg))

    def read_model(self, path: str) -> dict[str, Any]:
        """Take a model file; knees of one degree of freedom gain adduction and rotation.

        Args:
            path: An ``.osim`` file.

        Returns:
            Figures of the model, the fields of `hilbrace.biomech.model_figures.ModelFigures`.

        Raises:
            InputError: OpenSim cannot read the file, or its knees cannot be freed.
        """
        return self._take(opensim_model.read_model(Path(path)))

    def write_model(self, path: str) -> None:
        """Write the model as it is, with its markers, to an ``.osim`` file."""
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        self._model.printToXML(path)

    def _take(self, model: osim.Model) -> dict[str, Any]:
        for coordinate in _items(model.updCoordinateSet()):
            coordinate.setDefaultClamped(False)
        state = model.initSystem()
        self._model, self._state = model, state
        self._matter = model.getMatterSubsystem()
        variables = osim.createStateVariableNamesInSystemOrder(model)
        self._order = [name.split("/")[-2] for name in variables if name.endswith("/value")]
        self._column = {name: k for k, name in enumerate(self._order)}
        self._couplers = [c for c in map(_as_coupler, _items(model.getConstraintSet())) if c is not None]
        followers = {c.getDependentCoordinateName() for c in self._couplers}
        self._names = [c.getName() for c in _items(model.getCoordinateSet()) if c.getName() not in followers]
        self._bodies = {body.getName(): body for body in _items(model.getBodySet())}
        self._default = np.array(state.getQ().to_numpy())
        self._check_speeds()
        return self._figures()

    def _figures(self) -> dict[str, Any]:
        coordinates = self._model.getCoordinateSet()
        bodies = self._bodies.values()
        markers = {marker.getName(): marker for marker in _items(self._model.getMarkerSet())}
        joints = {_base_body(joint.getChildFrame()): joint for joint in _items(self._model.getJointSet())}
        return {
            "name": self._model.getName(),
            "coordinates": tuple(self._names),
            "defaults": self._default[[self._column[name] for name in self._names]],
            "locked": tuple(name for name in self._names if coordinates.get(name).getDefaultLocked()),
            "bodies": tuple(self._bodies),
            "masses": np.array([body.getMass() for body in bodies]),
            "centres": np.array([body.getMassCenter().to_numpy() for body in bodies]),
            "inertias": np.array([_inertia(body) for body in bodies]),
            "joint_centres": {
                body: _base_location(joint.getChildFrame(), osim.Vec3(0)) for body, joint in joints.items()
            },
            "marker_bodies": {name: _base_body(marker.getParentFrame()) for name, marker in markers.items()},
            "marker_locations": {
                name: _base_location(marker.getParentFrame(), marker.get_location())
                for name, marker in markers.items()
            },
            "muscles": int(self._model.getMuscles().getSize()),
        }

    def _check_speeds(self) -> None:
        """Speeds must be derivatives of the coordinates, or Jacobian columns were no partial derivatives."""
        speeds = np.linspace(0.5, 1.0, self._state.getNU())
        self._state.setU(osim.Vector.createFromMat(speeds))
        self._model.realizeVelocity(self._state)
        derivatives = self._state.getQDot().to_numpy()
        if len(derivatives) != len(speeds) or np.abs(derivatives - speeds).max() > 1e-9:
            raise InputError(
                "a joint's speeds are not the derivatives of its coordinates",
                where=self._model.getName(),
                hint="replace ball and free joints of the model by custom joints",
            )

    def _set_pose(self, q: Variables) -> None:
        self._state.setQ(osim.Vector.createFromMat(q))
        self._model.realizePosition(self._state)

    def _follow(self, q: Variables) -> None:
        """Set the coupled coordinates (kneecaps) in place."""
        for coupler in self._couplers:
            leaders = coupler.getIndependentCoordinateNames()
            values = [q[self._column[leaders.get(k)]] for k in range(leaders.getSize())]
            argument = osim.Vector.createFromMat(np.array(values))
            q[self._column[coupler.getDependentCoordinateName()]] = coupler.getFunction().calcValue(argument)

    def _jacobian(self) -> Float[Array, "mobilised 2 3 variable"]:
        """Angular and linear velocity of each body's frame per unit speed, in the ground."""
        matrix = osim.Matrix()
        self._matter.calcSystemJacobian(self._state, matrix)
        columns = matrix.to_numpy()
        return columns.reshape(-1, 2, 3, columns.shape[1])

    def _frames(self, bodies: Sequence[str]) -> tuple[Float[Array, "body 3 3"], Float[Array, "body 3"]]:
        rotations, origins = np.empty((len(bodies), 3, 3)), np.empty((len(bodies), 3))
        for k, name in enumerate(bodies):
            transform = self._bodies[name].getTransformInGround(self._state)
            rotation = transform.R()
            for row in range(3):
                for column in range(3):
                    rotations[k, row, column] = rotation.get(row, column)
            origins[k] = transform.p().to_numpy()
        return rotations, origins

    def _index(self, body: str) -> int:
        return int(self._bodies[body].getMobilizedBodyIndex())

    def _tell(self, done: int, total: int) -> None:
        now = time.monotonic()
        if done == total or now - self._said > REPORT_EVERY_S:
            self._said = now
            self._report(done, total)

    def poses(self, coordinates: Float[Array, "frame coordinate"]) -> dict[str, Array]:
        """Frames of all bodies.

        Args:
            coordinates: Free coordinates [rad or m], in the model's order.

        Returns:
            ``rotations`` (frame body 3 3) and ``origins`` (frame body 3) [m], to ground.
        """
        bodies = tuple(self._bodies)
        rotations = np.empty((len(coordinates), len(bodies), 3, 3))
        origins = np.empty((len(coordinates), len(bodies), 3))
        for frame, values in enumerate(coordinates):
            self._set_pose(self._complete(values))
            rotations[frame], origins[frame] = self._frames(bodies)
            self._tell(frame + 1, len(coordinates))
        return {"rotations": rotations, "origins": origins}

    def partial_velocities(
        self,
        coordinates: Float[Array, "frame coordinate"],
        moving: Sequence[str],
        bodies: Sequence[str],
    ) -> Float[Array, "frame body 2 3 moving"]:
        """Angular velocity [1] and velocity of the frame's origin [m] per unit speed of some coordinates.

        Args:
            coordinates: Free coordinates [rad or m], in the model's order.
            moving: Coordinates that move.
            bodies: Bodies watched.

        Returns:
            Angular (first) and linear (second) velocities in the ground frame.
        """
        columns = [self._column[name] for name in moving]
        rows = [self._index(body) for body in bodies]
        result = np.empty((len(coordinates), len(bodies), 2, 3, len(moving)))
        for frame, values in enumerate(coordinates):
            self._set_pose(self._complete(values))
            result[frame] = self._jacobian()[rows][..., columns]
            self._tell(frame + 1, len(coordinates))
        return result

    def _complete(self, values: Float[Array, " coordinate"]) -> Variables:
        q = self._default.copy()
        q[[self._column[name] for name in self._names]] = values
        self._follow(q)
        return q

    def inverse_kinematics(
        self,
        bodies: Sequence[str],
        locations: Float[Array, "marker 3"],
        weights: Float[Array, " marker"],
        measured: Float[Array, "frame marker 3"],
        start: Float[Array, " coordinate"],
        fixed: Sequence[str] = (),
        held: Mapping[str, float] | None = None,
    ) -> dict[str, Array]:
        """Find the coordinates whose markers lie nearest to the measured ones, each frame from the last.

        Each frame minimises ``sum_m w_m |x_m - x_m(q)|^2 + sum_c h_c (q_c - start_c)^2`` over the free
        coordinates. Their ranges are not enforced: a clamped coordinate would pull its neighbours in
        silence.

        Args:
            bodies: Body of each marker.
            locations: Place of each marker in its body [m].
            weights: Weight of each marker [-].
            measured: Measured positions [m]; NaN where hidden.
            start: Coordinates at which the search starts [rad or m].
            fixed: Coordinates that keep their start value.
            held: Stiffness [m^2] that holds a coordinate near its start, beyond `SHARED_WEIGHT_M2`.

        Returns:
            ``coordinates`` (frame coordinate), ``errors`` (frame marker) [m] with NaN in gaps, and
            ``support`` (frame coordinate) [m^2]: stiffness that the visible markers give each coordinate
            when all others are free; zero for fixed ones.

        Raises:
            SolverError: A frame does not converge.
        """
        problem = self._problem(bodies, locations, weights, start, set(fixed), held or {})
        q = problem.rest.copy()
        coordinates = np.empty((len(measured), len(self._names)))
        errors = np.empty(measured.shape[:2])
        support = np.zeros((len(measured), len(q)))
        columns = [self._column[name] for name in self._names]
        for frame, points in enumerate(measured):
            q, errors[frame], support[frame, problem.free] = self._fit(problem, points, q, frame)
            coordinates[frame] = q[columns]
            self._tell(frame + 1, len(measured))
        return {"coordinates": coordinates, "errors": errors, "support": support[:, columns]}

    def _problem(
        self,
        bodies: Sequence[str],
        locations: Float[Array, "marker 3"],
        weights: Float[Array, " marker"],
        start: Float[Array, " coordinate"],
        fixed: Collection[str],
        held: Mapping[str, float],
    ) -> Problem:
        carriers = tuple(dict.fromkeys(bodies))
        free = [name for name in self._names if name not in fixed]
        return Problem(
            carriers=carriers,
            carrier=np.array([carriers.index(body) for body in bodies]),
            rows=np.array([self._index(body) for body in bodies]),
            locations=np.asarray(locations, dtype=float),
            weights=np.asarray(weights, dtype=float),
            free=np.array([self._column[name] for name in free]),
            stiffness=SHARED_WEIGHT_M2 + np.array([held.get(name, 0.0) for name in free]),
            rest=self._complete(np.asarray(start, dtype=float)),
        )

    def _fit(
        self, problem: Problem, points: Float[Array, "marker 3"], q: Variables, frame: int
    ) -> tuple[Variables, Float[Array, " marker"], Float[Array, " free"]]:
        """One frame by Newton steps, damped where a step is no gain (Levenberg-Marquardt).

        Returns:
            The pose, the distance of each marker [m], and the support of each free coordinate [m^2].
        """
        seen = np.array(np.isfinite(points).all(axis=1))
        weights = np.where(seen, problem.weights, 0.0)
        targets = np.where(seen[:, None], points, 0.0)
        damping, unit = 1e-6, np.eye(len(problem.free))
        now = self._linearise(problem, targets, weights, q)
        for _ in range(MAX_STEPS):
            step = _step(now, damping * unit)
            trial = q.copy()
            trial[problem.free] += step
            self._follow(trial)
            after = self._linearise(problem, targets, weights, trial)
            found = np.abs(step).max() < STEP_TOLERANCE
            if found or after.cost <= now.cost:
                q, now, damping = trial, after, max(damping / 8.0, 1e-10)
            else:
                damping *= 8.0
            if found:
                distance = np.where(seen, np.linalg.norm(now.difference, axis=1), np.nan)
                support = 1.0 / np.diag(np.linalg.inv(now.information)) - problem.stiffness
                return q, distance, np.maximum(support, 0.0)
        raise SolverError(
            "the model cannot be brought onto the markers",
            where=f"frame {frame + 1}",
            hint="look for swapped or mislabelled markers there, or leave the frame out with motion.window",
        )

    def _linearise(
        self,
        problem: Problem,
        targets: Float[Array, "marker 3"],
        weights: Float[Array, " marker"],
        q: Variables,
    ) -> Linearised:
        """The fit's cost at a pose, with its derivatives."""
        self._set_pose(q)
        rotations, origins = self._frames(problem.carriers)
        arms = np.einsum("mij,mj->mi", rotations[problem.carrier], problem.locations)
        difference = targets - origins[problem.carrier] - arms
        turn, shift = np.moveaxis(self._jacobian()[problem.rows][..., problem.free], 1, 0)
        slopes = shift + np.cross(turn, arms[:, :, None], axis=1)
        pull = weights[:, None] * difference
        flat = slopes.reshape(-1, slopes.shape[-1])
        away = (q - problem.rest)[problem.free]
        return Linearised(
            cost=float((pull * difference).sum() + problem.stiffness @ away**2),
            descent=flat.T @ pull.ravel() - problem.stiffness * away,
            information=(flat * np.repeat(weights, 3)[:, None]).T @ flat + np.diag(problem.stiffness),
            curvature=_curvature(turn, slopes, pull),
            difference=difference,
        )


def _step(at: Linearised, damping: Float[Array, "free free"]) -> Float[Array, " free"]:
    """Newton's step where the cost is convex, Gauss-Newton's elsewhere; never longer than `LONGEST_STEP`."""
    try:
        factor = np.linalg.cholesky(at.information + at.curvature + damping)
    except np.linalg.LinAlgError:
        factor = np.linalg.cholesky(at.information + damping)
    step = solve_triangular(factor.T, solve_triangular(factor, at.descent, lower=True))
    return step * min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP))


def _curvature(
    turn: Float[Array, "marker 3 free"], slopes: Float[Array, "marker 3 free"], pull: Float[Array, "marker 3"]
) -> Float[Array, "free free"]:
    """Half the second derivative of a fit's cost that stems from markers moving on arcs.

    When coordinate i turns a body, it turns the slopes of all coordinates j further out: d2x / dq_i dq_j =
    w_i x s_j. Coordinates come in the order of the multibody tree, inner ones first. Without this term the
    steps overshoot wherever markers stay far from the model. Translations are not turned by their own
    joint; those that splines couple to knee flexion are left out of the curvature.

    Args:
        turn: Angular velocity of each marker's body per unit speed.
        slopes: Velocity of each marker per unit speed [m].
        pull: Weight times measured less model marker [m].
    """
    turned = np.where(np.abs(turn).max(axis=1, keepdims=True) > 0.0, slopes, 0.0)
    inner = np.einsum("mci,mcj->ij", turn, np.cross(turned, pull[:, :, None], axis=1))
    upper = np.triu(inner)
    return -(upper + np.triu(inner, 1).T)


def _items(collection: Any) -> list[Any]:
    """Members of an OpenSim set; the set's owner must stay alive."""
    return [collection.get(k) for k in range(collection.getSize())]


def _as_coupler(constraint: Any) -> osim.CoordinateCouplerConstraint | None:
    return osim.CoordinateCouplerConstraint.safeDownCast(constraint)


def _inertia(body: Any) -> Float[Array, "3 3"]:
    """Inertia about the centre of mass in the body's frame [kg*m^2]."""
    xx, yy, zz, xy, xz, yz = (body.get_inertia().get(k) for k in range(6))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _base_body(frame: Any) -> str:
    return frame.findBaseFrame().getName()


def _base_location(frame: Any, location: Any) -> Float[Array, " 3"]:
    """A point of a frame in the body that carries the frame [m]."""
    transform = frame.findTransformInBaseFrame()
    return np.array(transform.shiftFrameStationToBase(location).to_numpy())
