"""A model that OpenSim holds in one pose at a time, and what can be read off it.

Only the engine's process loads this module; see `hilbrace.biomech.opensim_worker`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import opensim as osim
from jaxtyping import Float

from hilbrace.biomech.marker_fit import Variables
from hilbrace.errors import InputError

Array = np.ndarray
Report = Callable[[int, int], None]

REPORT_EVERY_S = 0.2


class HeldModel:
    """A model, its state, and the order of its variables.

    Simbody orders variables along the multibody tree, which is not the order of the model's coordinate set.

    Args:
        report: Called with (done, total) during long tasks.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._said = 0.0

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

    def _complete(self, values: Float[Array, " coordinate"]) -> Variables:
        q = self._default.copy()
        q[[self._column[name] for name in self._names]] = values
        self._couple(q)
        return q

    def _set_motion(self, values: Float[Array, " coordinate"], speeds: Float[Array, " coordinate"]) -> None:
        self._state.setQ(osim.Vector.createFromMat(self._complete(values)))
        self._state.setU(osim.Vector.createFromMat(self._spread(values, speeds)))
        self._model.realizeVelocity(self._state)

    def _spread(self, values: Float[Array, " coordinate"], rates: Float[Array, " coordinate"]) -> Variables:
        """Rates of all coordinates, coupled ones included (their couplings are straight lines)."""
        full = np.zeros(len(self._default))
        full[[self._column[name] for name in self._names]] = rates
        for leader, follower, slope in self._slopes(values):
            full[follower] = slope * full[leader]
        return full

    def _onto_leaders(
        self, forces: Float[Array, "variable column"], values: Float[Array, " coordinate"]
    ) -> Float[Array, "variable column"]:
        """Put generalised forces on coupled coordinates (kneecaps) onto those that lead them."""
        for leader, follower, slope in self._slopes(values):
            forces[leader] += slope * forces[follower]
        return forces

    def _slopes(self, values: Float[Array, " coordinate"]) -> list[tuple[int, int, float]]:
        """Leader, follower and slope of every coupling in a pose."""
        found = []
        for coupler in self._couplers:
            leader = coupler.getIndependentCoordinateNames().get(0)
            at, step = values[self._names.index(leader)], 1e-6
            function = coupler.getFunction()
            low, high = (function.calcValue(osim.Vector(1, float(at + d))) for d in (-step, step))
            follower = self._column[coupler.getDependentCoordinateName()]
            found.append((self._column[leader], follower, (high - low) / (2.0 * step)))
        return found


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
