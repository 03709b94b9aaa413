"""What the OpenSim process does: hold a model, find poses from markers, report poses as arrays.

Only this module and `hilbrace.biomech.opensim_model` import OpenSim, and only the process that
`hilbrace.biomech.engine.Engine` starts imports them. The least-squares fit itself is in
`hilbrace.biomech.marker_fit`; here is the model that it moves.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import opensim as osim
from jaxtyping import Float

from hilbrace.biomech import opensim_model
from hilbrace.biomech.marker_fit import SHARED_WEIGHT_M2, Carriers, Problem, Variables, fit_frame
from hilbrace.errors import InputError
from hilbrace.skeleton.table import load_table

Array = np.ndarray
Report = Callable[[int, int], None]

osim.Logger.setLevelString("Off")
osim.Logger.removeFileSink()

REPORT_EVERY_S = 0.2


class Poses(TypedDict):
    """Frames of all bodies, to ground; origins in [m]."""

    rotations: Float[Array, "frame body 3 3"]
    origins: Float[Array, "frame body 3"]


class FittedPoses(TypedDict):
    """Poses found from markers.

    Coordinates are in [rad or m]. Errors are distances of the markers [m], NaN in gaps. Support is the
    stiffness [m^2] that the visible markers give each coordinate when all others are free; zero for fixed
    ones.
    """

    coordinates: Float[Array, "frame coordinate"]
    errors: Float[Array, "frame marker"]
    support: Float[Array, "frame coordinate"]


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

    def _couple(self, q: Variables) -> None:
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

    def poses(self, coordinates: Float[Array, "frame coordinate"]) -> Poses:
        """Frames of all bodies over some frames of time.

        Args:
            coordinates: Free coordinates [rad or m], in the model's order.
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
        self._couple(q)
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
    ) -> FittedPoses:
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
            held: Stiffness [m^2] that holds a coordinate near its start, beyond
                `hilbrace.biomech.marker_fit.SHARED_WEIGHT_M2`.

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
            q, errors[frame], support[frame, problem.free] = fit_frame(problem, points, q, frame)
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
        names = tuple(dict.fromkeys(bodies))
        carrier = np.array([names.index(body) for body in bodies])
        rows = np.array([self._index(body) for body in bodies])
        free = [name for name in self._names if name not in fixed]

        def carriers(q: Variables) -> Carriers:
            self._set_pose(q)
            rotations, origins = self._frames(names)
            return Carriers(rotations[carrier], origins[carrier], self._jacobian()[rows])

        return Problem(
            carriers=carriers,
            couple=self._couple,
            locations=np.asarray(locations, dtype=float),
            weights=np.asarray(weights, dtype=float),
            free=np.array([self._column[name] for name in free]),
            stiffness=SHARED_WEIGHT_M2 + np.array([held.get(name, 0.0) for name in free]),
            rest=self._complete(np.asarray(start, dtype=float)),
        )


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
