"""Muscles of an OpenSim model, read pose by pose: capacities, lines of action, moment arms; inverse dynamics.

Everything is asked of OpenSim's direct interface: its tools would write files and solve again what is known.
Only the engine's process loads this module; see `hilbrace.biomech.opensim_worker`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypedDict

import numpy as np
import opensim as osim
from jaxtyping import Float, Int

from hilbrace.biomech.opensim_state import HeldModel
from hilbrace.errors import InputError

Array = np.ndarray


class MusclePaths(TypedDict):
    """What muscles do per unit tension over the frames of a motion.

    Capacity: force along the tendon at full activation [N]; arms: generalised force on each coordinate asked
    for [m or -]; pulls: force [-] and moment about the origin of the ground [m] on each part asked for, in
    the ground frame.
    """

    capacity: Float[Array, "frame muscle"]
    arms: Float[Array, "frame row muscle"]
    pulls: Float[Array, "frame part muscle 6"]


class Points(NamedTuple):
    """The points at which muscles pull on bodies, in one pose.

    Attributes:
        muscle: Number of the muscle.
        body: Number of the body.
        place: Point in the body's frame [m].
        pull: Force per unit tension, in the ground [-].
    """

    muscle: Int[Array, " point"]
    body: Int[Array, " point"]
    place: Float[Array, "point 3"]
    pull: Float[Array, "point 3"]


class MuscleTasks(HeldModel):
    """Tasks about muscles and the moments that they must supply."""

    def muscle_figures(self) -> dict[str, Any]:
        """Constant figures of the muscles that apply force.

        Returns:
            The fields of `hilbrace.biomech.muscles.MuscleFigures`.
        """
        muscles = self._muscles()
        return {
            "names": tuple(muscle.getName() for muscle in muscles),
            "max_force": np.array([muscle.getMaxIsometricForce() for muscle in muscles]),
            "optimal_length": np.array([muscle.getOptimalFiberLength() for muscle in muscles]),
            "slack_length": np.array([muscle.getTendonSlackLength() for muscle in muscles]),
            "least_activation": np.array([muscle.getMinControl() for muscle in muscles]),
        }

    def muscle_paths(
        self,
        coordinates: Float[Array, "frame coordinate"],
        speeds: Float[Array, "frame coordinate"],
        rows: Sequence[str],
        parts: Sequence[Sequence[str]],
    ) -> MusclePaths:
        """Capacities, moment arms and lines of action of all muscles over a motion.

        The capacity is that of OpenSim's static optimisation: fibre length and velocity by an inextensible
        tendon, active force alone.

        Args:
            coordinates: Free coordinates [rad or m], in the model's order.
            speeds: Their rates [rad/s or m/s].
            rows: Coordinates whose moment arms are wanted.
            parts: Sets of bodies, such as those below a joint.
        """
        muscles = self._muscles()
        shape = (len(coordinates), len(muscles))
        found: MusclePaths = {
            "capacity": np.empty(shape),
            "arms": np.empty((shape[0], len(rows), shape[1])),
            "pulls": np.empty((shape[0], len(parts), shape[1], 6)),
        }
        for frame, (values, rates) in enumerate(zip(coordinates, speeds, strict=True)):
            self._set_motion(values, rates)
            found["capacity"][frame] = [
                muscle.calcInextensibleTendonActiveFiberForce(self._state, 1.0) for muscle in muscles
            ]
            on_body, origins = self._on_bodies(muscles)
            found["arms"][frame] = self._arms(on_body, values, rows)
            found["pulls"][frame] = self._pulls(on_body, origins, parts)
            self._tell(frame + 1, len(coordinates))
        return found

    def moment_arms(
        self, coordinates: Float[Array, "frame coordinate"], rows: Sequence[str], names: Sequence[str]
    ) -> Float[Array, "frame row muscle"]:
        """Moment arms of some muscles in some poses [m].

        Args:
            coordinates: Free coordinates [rad or m], in the model's order.
            rows: Coordinates whose moment arms are wanted.
            names: Muscles.
        """
        every = {muscle.getName(): muscle for muscle in self._muscles()}
        muscles = [every[name] for name in names]
        arms = np.empty((len(coordinates), len(rows), len(muscles)))
        for frame, values in enumerate(coordinates):
            self._set_pose(self._complete(values))
            arms[frame] = self._arms(self._on_bodies(muscles)[0], values, rows)
            self._tell(frame + 1, len(coordinates))
        return arms

    def inverse_dynamics(
        self,
        coordinates: Float[Array, "frame coordinate"],
        speeds: Float[Array, "frame coordinate"],
        accelerations: Float[Array, "frame coordinate"],
        loads: Mapping[str, Float[Array, "frame 6"]],
    ) -> Float[Array, "frame coordinate"]:
        """Generalised forces that a motion needs, muscles aside, as OpenSim's inverse dynamics finds them.

        Args:
            coordinates: Free coordinates [rad or m], in the model's order.
            speeds: Their rates.
            accelerations: Rates of these.
            loads: External force [N] and moment about the origin of the ground [N*m] on some bodies.

        Returns:
            One generalised force per coordinate [N*m or N]; what coupled coordinates need is put on those
            that lead them.
        """
        muscles = self._muscles()
        for muscle in muscles:
            muscle.setAppliesForce(self._state, False)
        solver = osim.InverseDynamicsSolver(self._model)
        columns = [self._column[name] for name in self._names]
        forces = np.empty_like(coordinates)
        for frame, values in enumerate(coordinates):
            self._set_motion(values, speeds[frame])
            spread = osim.Vector.createFromMat(self._spread(values, accelerations[frame]))
            needed = solver.solve(self._state, spread).to_numpy().copy()
            jacobian = self._jacobian()
            for body, load in loads.items():
                force, moment = load[frame, :3], load[frame, 3:]
                at = self._bodies[body].getTransformInGround(self._state).p().to_numpy()
                turn, shift = jacobian[self._index(body)]
                needed -= turn.T @ (moment - np.cross(at, force)) + shift.T @ force
            forces[frame] = self._onto_leaders(needed[:, None], values)[columns, 0]
            self._tell(frame + 1, len(coordinates))
        for muscle in muscles:
            muscle.setAppliesForce(self._state, True)
        return forces

    def _muscles(self) -> list[Any]:
        """The muscles that apply force, in the model's order."""
        muscles = self._model.getMuscles()
        every = [muscles.get(k) for k in range(muscles.getSize())]
        return [muscle for muscle in every if muscle.get_appliesForce()]

    def _on_bodies(
        self, muscles: Sequence[Any]
    ) -> tuple[Float[Array, "body muscle 2 3"], Float[Array, "body 3"]]:
        """Moment about the body's origin and force per unit tension, in the ground; and the origins."""
        points = _points(muscles, self._state, list(self._bodies))
        rotations, origins = self._frames(tuple(self._bodies))
        arm = np.einsum("pij,pj->pi", rotations[points.body], points.place)
        on_body = np.zeros((len(self._bodies), len(muscles), 2, 3))
        wrench = np.stack([np.cross(arm, points.pull), points.pull], axis=1)
        np.add.at(on_body, (points.body, points.muscle), wrench)
        return on_body, origins

    def _arms(
        self,
        on_body: Float[Array, "body muscle 2 3"],
        values: Float[Array, " coordinate"],
        rows: Sequence[str],
    ) -> Float[Array, "row muscle"]:
        jacobian = self._jacobian()[[self._index(body) for body in self._bodies]]
        flat = jacobian.reshape(-1, jacobian.shape[-1])
        forces = flat.T @ np.moveaxis(on_body, 1, 3).reshape(len(flat), -1)
        return self._onto_leaders(forces, values)[[self._column[name] for name in rows]]

    def _pulls(
        self,
        on_body: Float[Array, "body muscle 2 3"],
        origins: Float[Array, "body 3"],
        parts: Sequence[Sequence[str]],
    ) -> Float[Array, "part muscle 6"]:
        names = tuple(self._bodies)
        moment = on_body[:, :, 0] + np.cross(origins[:, None], on_body[:, :, 1])
        wrench = np.concatenate([on_body[:, :, 1], moment], axis=2)
        pulls = [wrench[[names.index(body) for body in part]].sum(axis=0) for part in parts]
        return np.array(pulls).reshape(len(parts), on_body.shape[1], 6)


def _points(muscles: Sequence[Any], state: Any, bodies: list[str]) -> Points:
    """Where muscles pull on bodies, wraps and moving points included; points on the ground are left out."""
    number = {name: k for k, name in enumerate(bodies)}
    owners: list[tuple[int, int]] = []
    figures: list[tuple[Array, Array]] = []
    for owner, muscle in enumerate(muscles):
        found = osim.ArrayPointForceDirection()
        path = osim.GeometryPath.safeDownCast(muscle.updPath())
        if path is None:
            raise InputError(
                f"the muscle {muscle.getName()} has a path without points",
                where="biomech.model",
                hint="use a model whose muscles run over points and wraps (GeometryPath)",
            )
        path.getPointForceDirections(state, found)
        for k in range(found.getSize()):
            entry = found.get(k)
            frame, place, pull = entry.frame(), entry.point(), entry.direction()
            body = number.get(frame.getName())
            if body is None:
                body = number.get(frame.findBaseFrame().getName())
                if body is None:
                    continue
                place = frame.findTransformInBaseFrame().shiftFrameStationToBase(place)
            owners.append((owner, body))
            figures.append((place.to_numpy(), pull.to_numpy()))
    muscle_of, body_of = np.array(owners, dtype=int).reshape(-1, 2).T
    table = np.array(figures, dtype=float).reshape(-1, 2, 3)
    return Points(muscle_of, body_of, table[:, 0], table[:, 1])
