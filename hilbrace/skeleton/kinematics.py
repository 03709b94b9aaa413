"""Forward kinematics of the musculoskeletal model: every frame of a motion at once, without OpenSim.

A joint carries the child's frame from the parent's by a translation along three axes of the parent's joint
frame and three rotations R1 R2 R3 about fixed axes, each by a function of one coordinate (Seth, Sherman,
Eastman, Delp: "Minimal formulation of joint motion for biomechanisms", Nonlinear Dynamics 62, 2010).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.skeleton.splines import JointFunction, Linear, joint_function
from hilbrace.skeleton.table import BodyFigures, JointFigures, Table

Array = np.ndarray
Coordinates = Mapping[str, float | Float[Array, " #frame"]]
"""Values of coordinates by name [rad or m], one number or one per frame; one that is left out is zero."""

Complete = Mapping[str, Float[Array, " #frame"]]
"""Values of all coordinates that are needed, as arrays."""


class Transform(NamedTuple):
    """A body's frame in the ground, per frame of the motion: rotation matrix and origin [m]."""

    rotation: Float[Array, "frame 3 3"]
    origin: Float[Array, "frame 3"]


Pose = dict[str, Transform]
"""Frames of the bodies by name, ``"ground"`` included."""

LEG = ("femur", "tibia", "talus", "calcn")
"""Bodies of a leg whose frames `Skeleton.leg` renews."""

_AT_REST = np.zeros(1)


@dataclass(frozen=True)
class Axis:
    """One rotation about, or translation along, ``direction`` by ``function(coordinate)``."""

    direction: Float[Array, " 3"]
    coordinate: str | None
    function: JointFunction

    def value(self, q: Complete) -> Float[Array, " #frame"]:
        """Angle [rad] or distance [m]."""
        return self.function(self._argument(q))

    def slope(self, q: Complete) -> Float[Array, " #frame"]:
        """Change of the angle or distance per unit of the coordinate."""
        return self.function.slope(self._argument(q))

    def rotation(self, q: Complete) -> Float[Array, "#frame 3 3"]:
        """Rotation matrix of this axis in the pose."""
        return rotation_about(self.direction, self.value(q))

    def _argument(self, q: Complete) -> Array:
        return _AT_REST if self.coordinate is None else q.get(self.coordinate, _AT_REST)


@dataclass(frozen=True)
class Joint:
    """A joint of the tree, ready to be evaluated.

    Attributes:
        parent: Parent body.
        child: Child body.
        coordinates: Names of its coordinates.
        rotations: Rotations in the order of multiplication.
        translations: Translations along axes of the parent's joint frame.
        parent_rotation: Joint frame in the parent.
        parent_origin: Its origin in the parent [m].
        child_rotation: Child's frame in the moved joint frame.
        child_origin: The child's origin there [m].
    """

    parent: str
    child: str
    coordinates: tuple[str, ...]
    rotations: tuple[Axis, ...]
    translations: tuple[Axis, ...]
    parent_rotation: Float[Array, "3 3"]
    parent_origin: Float[Array, " 3"]
    child_rotation: Float[Array, "3 3"]
    child_origin: Float[Array, " 3"]

    def carry(self, parent: Transform, q: Complete) -> Transform:
        """Frame of the child from the frame of the parent."""
        frame = parent.rotation @ self.parent_rotation
        origin = parent.origin + parent.rotation @ self.parent_origin
        for axis in self.translations:
            origin = origin + (frame @ axis.direction) * axis.value(q)[:, None]
        for axis in self.rotations:
            frame = frame @ axis.rotation(q)
        return Transform(frame @ self.child_rotation, origin + frame @ self.child_origin)


@dataclass(frozen=True)
class Skeleton:
    """Bodies, joints and markers of a model; build it with `skeleton_from_table`.

    Attributes:
        bodies: Names of the bodies, in the model's order.
        coordinates: Names of all coordinates (41 free, 2 of the kneecaps), in OpenSim's order.
        masses: Mass of each body [kg].
        com: Centre of mass of each body in its frame [m].
        inertia: Inertia of each body about its centre of mass, in its frame [kg*m^2].
        joints: Joints, parents before children.
        couplers: Coordinate driven -> coordinate that drives it, and the function.
        marker_body: Body of each marker; the keys are the marker names.
        marker_location: Place of each marker in its body [m].
    """

    bodies: tuple[str, ...]
    coordinates: tuple[str, ...]
    masses: Float[Array, " body"]
    com: dict[str, Float[Array, " 3"]]
    inertia: Float[Array, "body 3 3"]
    joints: dict[str, Joint]
    couplers: dict[str, tuple[str, JointFunction]]
    marker_body: dict[str, str]
    marker_location: dict[str, Float[Array, " 3"]]

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return float(self.masses.sum())

    def complete(self, q: Coordinates) -> dict[str, Float[Array, " frame"]]:
        """All coordinates of the model: zero where left out, the kneecaps as their knees drive them.

        Args:
            q: Values by name [rad or m], one number or one per frame.

        Raises:
            InputError: A name is not of this model, or the numbers of frames differ.
        """
        unknown = [name for name in q if name not in self.coordinates]
        if unknown:
            raise InputError(
                "not a coordinate of the model", where=unknown[0], hint=f"use {', '.join(self.coordinates)}"
            )
        given = {name: np.atleast_1d(np.asarray(value, dtype=float)) for name, value in q.items()}
        lengths = {len(value) for value in given.values() if len(value) != 1}
        if len(lengths) > 1 or any(value.ndim != 1 for value in given.values()):
            raise InputError(
                f"coordinates with {sorted(lengths)} frames", where="pose", hint="give one value per frame"
            )
        frames = lengths.pop() if lengths else 1
        full = {n: np.broadcast_to(given.get(n, _AT_REST), (frames,)) for n in self.coordinates}
        for driven, (driver, function) in self.couplers.items():
            if driven not in given:
                full[driven] = function(full[driver])
        return full

    def forward(self, q: Coordinates) -> Pose:
        """Frames of all bodies.

        Args:
            q: Values of coordinates by name [rad or m]; those left out are zero, kneecaps follow the knees.

        Raises:
            InputError: A name is not of this model, or the numbers of frames differ.
        """
        full = self.complete(q)
        frames = len(full[self.coordinates[0]])
        ground = Transform(np.broadcast_to(np.eye(3), (frames, 3, 3)), np.zeros((frames, 3)))
        return self.advance(full, {"ground": ground}, self.bodies)

    def advance(self, q: Complete, pose: Pose, children: Iterable[str]) -> Pose:
        """The pose with the frames of some bodies renewed, each from its parent's frame in the pose.

        Args:
            q: Values by name, one per frame; none is checked here, so that inner loops are quick.
            pose: Frames that the children's parents already have. It is not changed.
            children: Bodies to renew, parents before children.
        """
        renewed = dict(pose)
        for child in children:
            joint = self.joints[child]
            renewed[child] = joint.carry(renewed[joint.parent], q)
        return renewed

    def leg(self, q: Complete, side: str, pose: Pose) -> Pose:
        """The pose with one leg renewed from thigh to heel (`LEG`); ``side`` is ``"r"`` or ``"l"``."""
        return self.advance(q, pose, [f"{body}_{side}" for body in LEG])

    def point(
        self, pose: Pose, body: str, location: Float[Array, " 3"] | Sequence[float]
    ) -> Float[Array, "frame 3"]:
        """A point fixed in a body, in the ground [m], one row per frame."""
        rotation, origin = pose[body]
        return origin + rotation @ np.asarray(location, dtype=float)

    def centres(self, pose: Pose) -> Float[Array, "frame body 3"]:
        """Centre of mass of each body in the ground [m]."""
        return np.stack([self.point(pose, body, self.com[body]) for body in self.bodies], axis=1)

    def centre(self, pose: Pose) -> Float[Array, "frame 3"]:
        """Centre of mass of the whole model in the ground [m]."""
        return np.einsum("b,fbi->fi", self.masses / self.mass, self.centres(pose))

    def markers(self, pose: Pose, names: Sequence[str] | None = None) -> Float[Array, "frame marker 3"]:
        """Places of markers in the ground [m].

        Args:
            pose: Frames from `forward`.
            names: Markers wanted, in order; all of `marker_body` if left out.

        Raises:
            InputError: A marker is not of this model.
        """
        names = tuple(self.marker_body) if names is None else names
        for name in names:
            if name not in self.marker_body:
                raise InputError(
                    "not a marker of the model", where=name, hint=f"use {', '.join(self.marker_body)}"
                )
        places = [self.point(pose, self.marker_body[n], self.marker_location[n]) for n in names]
        return np.stack(places, axis=1)

    def joint_axes(self, child: str, q: Coordinates) -> dict[str, Float[Array, "frame 3"]]:
        """Angular velocity of a body relative to its parent per unit rate of each coordinate of its joint.

        For a rotation by one coordinate alone this is its unit axis; the body turns about it when the
        coordinate grows.

        Args:
            child: Body whose joint to its parent is meant.
            q: Values of coordinates [rad or m].

        Returns:
            Axes by coordinate, in the frame of the child.
        """
        joint = self.joints[child]
        full = self.complete(q)
        frames = len(full[self.coordinates[0]])
        axes = {name: np.zeros((frames, 3)) for name in joint.coordinates}
        after = joint.child_rotation
        for axis in reversed(joint.rotations):
            if axis.coordinate is not None:
                turned = np.swapaxes(after, -1, -2) @ axis.direction
                axes[axis.coordinate] = axes[axis.coordinate] + axis.slope(full)[:, None] * turned
            after = axis.rotation(full) @ after
        return axes


def rotation_about(
    direction: Float[Array, " 3"], angle: Float[Array, "*frame"]
) -> Float[Array, "*frame 3 3"]:
    """Rotation matrices about one axis (Rodrigues' formula).

    Args:
        direction: Unit axis.
        angle: Angles [rad].
    """
    x, y, z = direction
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle, dtype=float)[..., None, None]
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def body_fixed_xyz(angles: Sequence[float] | Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Rotation matrix of body-fixed x-y-z angles [rad], OpenSim's way to write an orientation."""
    x, y, z = (rotation_about(np.eye(3)[k], np.array(angles[k])) for k in range(3))
    return x @ y @ z


def skeleton_from_table(table: Table) -> Skeleton:
    """Prepare a model for kinematics.

    Args:
        table: Figures of the model, as from `hilbrace.skeleton.table.load_table` or scaled from there.

    Raises:
        InputError: The table holds a joint function of unknown kind.
    """
    joints = {figures["child"]: _joint(figures) for figures in table["joints"]}
    couplers = {
        item["dependent"]: (item["independent"], joint_function(item["function"]))
        for item in table["couplers"]
    }
    return Skeleton(
        bodies=tuple(joints),
        coordinates=tuple(name for joint in joints.values() for name in joint.coordinates),
        masses=np.array([table["bodies"][name]["mass"] for name in joints]),
        com={name: np.array(table["bodies"][name]["com"]) for name in joints},
        inertia=np.array([inertia_tensor(table["bodies"][name]) for name in joints]),
        joints=joints,
        couplers=couplers,
        marker_body={name: entry[0] for name, entry in table["markers"].items()},
        marker_location={name: np.array(entry[1]) for name, entry in table["markers"].items()},
    )


def inertia_tensor(body: BodyFigures) -> Float[Array, "3 3"]:
    """Inertia matrix of a body from the six figures of the table [kg*m^2]."""
    xx, yy, zz, xy, xz, yz = body["inertia"]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _joint(figures: JointFigures) -> Joint:
    rotations, translations = _axes(figures)
    (parent_origin, parent_angles), (child_origin, child_angles) = (
        figures["parent_frame"],
        figures["child_frame"],
    )
    child_rotation = body_fixed_xyz(child_angles).T
    return Joint(
        parent=figures["parent"],
        child=figures["child"],
        coordinates=tuple(item["name"] for item in figures["coordinates"]),
        rotations=rotations,
        translations=translations,
        parent_rotation=body_fixed_xyz(parent_angles),
        parent_origin=np.array(parent_origin),
        child_rotation=child_rotation,
        child_origin=-child_rotation @ np.array(child_origin),
    )


def _axes(figures: JointFigures) -> tuple[tuple[Axis, ...], tuple[Axis, ...]]:
    """Rotations and translations of a joint, those that never move left out."""
    if "transform" not in figures:
        directions = {"PinJoint": (2,), "UniversalJoint": (0, 1)}[figures["type"]]
        names = [item["name"] for item in figures["coordinates"]]
        pairs = zip(directions, names, strict=True)
        return tuple(Axis(np.eye(3)[k], name, Linear(1.0, 0.0)) for k, name in pairs), ()
    axes = []
    for entry in figures["transform"]:
        direction = np.array(entry["axis"])
        function = joint_function(entry["function"])
        axes.append(Axis(direction / np.linalg.norm(direction), entry["of"], function))
    moving = [axis.coordinate is not None or axis.function(_AT_REST).any() for axis in axes]
    return (
        tuple(axis for axis, moves in zip(axes[:3], moving[:3], strict=True) if moves),
        tuple(axis for axis, moves in zip(axes[3:], moving[3:], strict=True) if moves),
    )
