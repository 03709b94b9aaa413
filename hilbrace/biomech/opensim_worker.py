"""What the OpenSim process does: hold a model, find poses from markers, report poses as arrays.

Only this module and its kin (`opensim_model`, `opensim_state`, `opensim_muscles`) import OpenSim, and only
the process that `hilbrace.biomech.engine.Engine` starts imports them. The least-squares fit itself is in
`hilbrace.biomech.marker_fit`; here is the model that it moves.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import opensim as osim
from jaxtyping import Float

from hilbrace.biomech import opensim_model
from hilbrace.biomech.marker_fit import SHARED_WEIGHT_M2, Carriers, Problem, Variables, fit_frame
from hilbrace.biomech.opensim_muscles import MuscleTasks
from hilbrace.skeleton.table import load_table

Array = np.ndarray

osim.Logger.setLevelString("Off")
osim.Logger.removeFileSink()


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


class Worker(MuscleTasks):
    """One model and the tasks that use it. Every public method is a task of the engine.

    Args:
        report: Called with (done, total) during long tasks.
    """

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

    def scale_model(
        self, bodies: Sequence[str], scales: Float[Array, "body 3"], mass_kg: float
    ) -> dict[str, Any]:
        """Scale the model at hand.

        Args:
            bodies: Names of the bodies that ``scales`` belong to; others keep their size.
            scales: Factors along each body's axes [-].
            mass_kg: Mass of the scaled model [kg].

        Returns:
            See `read_model`.
        """
        factors = dict(zip(bodies, np.asarray(scales, dtype=float), strict=True))
        return self._take(opensim_model.scale_model(self._model, factors, mass_kg))

    def write_model(self, path: str) -> None:
        """Write the model as it is, with its markers, to an ``.osim`` file."""
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        self._model.printToXML(path)

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
