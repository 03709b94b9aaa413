"""Build, upgrade and scale OpenSim models. Only a worker process imports this module.

The opensim wheel brings libraries that clash with those of other packages in one process; see
`hilbrace.biomech.opensim_worker`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import opensim as osim

from hilbrace.errors import InputError
from hilbrace.skeleton.kinematics import body_fixed_xyz
from hilbrace.skeleton.table import (
    KNEE_EXTRA,
    SIDES,
    Function,
    JointFigures,
    MuscleFigures,
    Table,
    TransformAxis,
)

_CURVES = ("ActiveForceLengthCurve", "ForceVelocityCurve", "FiberForceLengthCurve", "TendonForceLengthCurve")
_ALIGNED = 0.8  # cosine from which an axis counts as anterior, vertical or lateral


def build_model(
    table: Table, *, unlock: Collection[str] = (), name: str = "hilbrace_full_body"
) -> osim.Model:
    """Build the model that a table describes.

    Args:
        table: Figures, as from `hilbrace.skeleton.table.load_table` or scaled from there.
        unlock: Coordinates that the table locks and that shall be free, such as ``subtalar_angle_r``.
        name: Name of the model.

    Returns:
        The model, connected; call ``initSystem()`` on it, and keep it alive while its parts are in use.

    Raises:
        InputError: ``unlock`` names a coordinate that the table does not have.
    """
    known = {item["name"] for joint in table["joints"] for item in joint["coordinates"]}
    unknown = sorted(set(unlock) - known)
    if unknown:
        raise InputError(
            "no such coordinate to unlock", where=unknown[0], hint=f"use {', '.join(sorted(known))}"
        )
    model = osim.Model()
    model.setName(name)
    model.setGravity(_vec3(table["gravity"]))
    frames = _add_bodies(model, table)
    for joint in table["joints"]:
        model.addJoint(_joint(joint, frames, unlock))
    for coupler in table["couplers"]:
        constraint = osim.CoordinateCouplerConstraint()
        constraint.setName(coupler["name"])
        constraint.setIndependentCoordinateNames(_array_str(coupler["independent"]))
        constraint.setDependentCoordinateName(coupler["dependent"])
        constraint.setFunction(_function(coupler["function"]))
        model.addConstraint(constraint)
    for muscle_name, figures in table["muscles"].items():
        model.addForce(_muscle(muscle_name, figures, table["muscle_common"], frames))
    for actuator_name, figures in table["actuators"].items():
        actuator = osim.CoordinateActuator(figures["coordinate"])
        actuator.setName(actuator_name)
        actuator.setOptimalForce(figures["optimal_force"])
        model.addForce(actuator)
    for marker_name, (body, location, fixed) in table["markers"].items():
        marker = osim.Marker(marker_name, frames[body], _vec3(location))
        marker.set_fixed(fixed)
        model.addMarker(marker)
    model.finalizeConnections()
    return model


def read_model(path: Path) -> osim.Model:
    """Read a model file of the user and give it 3-DoF knees.

    Raises:
        InputError: OpenSim cannot read the file, or its knees cannot be upgraded (`upgrade_knees`).
    """
    if not path.is_file():
        raise InputError("no such model", where=str(path), hint="check biomech.model")
    try:
        model = osim.Model(str(path))
        model.finalizeConnections()
    except RuntimeError as fault:
        reason = str(fault).strip().splitlines()[0]
        raise InputError(
            f"OpenSim cannot read the model: {reason}", where=str(path), hint="open it in OpenSim first"
        ) from fault
    return upgrade_knees(model)


def upgrade_knees(model: osim.Model) -> osim.Model:
    """Free adduction and internal rotation of both knees, in place.

    Rotations of the knee joint that were constant or coupled to flexion become the coordinates
    ``knee_adduction_r`` and ``knee_rotation_r`` (and ``_l``), positive for adduction and internal rotation
    on both sides; translations stay as they are. A knee that has these coordinates already is left alone.

    Args:
        model: A model whose knees are custom joints with the coordinates ``knee_angle_r`` and
            ``knee_angle_l``, flexion positive, in frames that are x anterior, y up, z right when straight.

    Returns:
        The same model, connected anew.

    Raises:
        InputError: The model has no such knees.
    """
    for side in SIDES:
        joint = _knee(model, side)
        present = {joint.get_coordinates(i).getName() for i in range(joint.numCoordinates())}
        wanted = {f"{extra.name}_{side}" for extra in KNEE_EXTRA}
        if wanted <= present:
            continue
        if len(present) > 1:
            raise InputError(
                f"the knee has the coordinates {', '.join(sorted(present))}",
                where=joint.getName(),
                hint=f"name them knee_angle_{side}, {', '.join(sorted(wanted))}",
            )
        for extra, (axis, sign) in zip(KNEE_EXTRA, _free_axes(joint, side), strict=True):
            _free_rotation(joint, axis, f"{extra.name}_{side}", extra.limit, sign)
    model.finalizeFromProperties()
    model.finalizeConnections()
    return model


def scale_model(model: osim.Model, scales: Mapping[str, Any], mass_kg: float) -> osim.Model:
    """Scale a model in place with OpenSim's own ``Model::scale``, mass distribution preserved.

    Joint frames, centres of mass, wraps, muscle paths and markers are scaled with their bodies, fibres and
    tendons with the lengths of their muscles in the model's default pose.

    Args:
        model: A connected model.
        scales: Factors along x, y, z of each body's frame; a body left out keeps its size.
        mass_kg: Mass of the scaled model [kg].

    Returns:
        The same model.

    Raises:
        InputError: A factor or the mass is not positive, or a body is unknown.
    """
    bodies = model.getBodySet()
    scale_set = osim.ScaleSet()
    for body, factors in scales.items():
        if bodies.getIndex(body) < 0 or len(factors) != 3 or min(factors) <= 0:
            raise InputError(
                f"no scale factors {list(factors)} for this body",
                where=body,
                hint="give three positive factors for a body of the model",
            )
        scale = osim.Scale()
        scale.setSegmentName(body)
        scale.setScaleFactors(_vec3(factors))
        scale.setApply(True)
        scale_set.cloneAndAppend(scale)
    if not mass_kg > 0:
        raise InputError(f"a mass of {mass_kg} kg", where="scale_model", hint="give the subject's mass in kg")
    state = model.initSystem()
    model.scale(state, scale_set, True, float(mass_kg))
    model.finalizeConnections()
    return model


def _add_bodies(model: osim.Model, table: Table) -> dict[str, Any]:
    frames: dict[str, Any] = {"ground": model.getGround()}
    for name, figures in table["bodies"].items():
        inertia = osim.Inertia(*figures["inertia"])
        body = osim.Body(name, figures["mass"], _vec3(figures["com"]), inertia)
        model.addBody(body)
        frames[name] = body
    for name, figures in table["wraps"].items():
        cylinder = osim.WrapCylinder()
        cylinder.setName(name)
        cylinder.set_xyz_body_rotation(_vec3(figures["rotation"]))
        cylinder.set_translation(_vec3(figures["translation"]))
        cylinder.set_quadrant(figures["quadrant"])
        cylinder.set_active(figures["active"])
        cylinder.set_radius(figures["radius"])
        cylinder.set_length(figures["length"])
        frames[figures["body"]].addWrapObject(cylinder)
    return frames


def _joint(figures: JointFigures, frames: Mapping[str, Any], unlock: Collection[str]) -> Any:
    """A joint with its coordinates named, ranged and locked as in the table."""
    where = (
        figures["name"],
        frames[figures["parent"]],
        *map(_vec3, figures["parent_frame"]),
        frames[figures["child"]],
        *map(_vec3, figures["child_frame"]),
    )
    if "transform" in figures:
        joint = osim.CustomJoint(*where, _spatial_transform(figures["transform"]))
        for item in figures["coordinates"]:  # the constructor makes none, and ranges are wanted now
            coordinate = osim.Coordinate()
            coordinate.setName(item["name"])
            joint.append_coordinates(coordinate)
    else:
        joint = getattr(osim, figures["type"])(*where)
        for index, item in enumerate(figures["coordinates"]):
            joint.upd_coordinates(index).setName(item["name"])
    for index, item in enumerate(figures["coordinates"]):
        coordinate = joint.upd_coordinates(index)
        coordinate.setDefaultValue(item["default"])
        coordinate.set_range(0, item["range"][0])
        coordinate.set_range(1, item["range"][1])
        coordinate.setDefaultClamped(item["clamped"])
        coordinate.setDefaultLocked(item["locked"] and item["name"] not in unlock)
    return joint


def _spatial_transform(axes: list[TransformAxis]) -> osim.SpatialTransform:
    transform = osim.SpatialTransform()
    for index, figures in enumerate(axes):
        axis = transform.updTransformAxis(index)
        if figures["of"] is not None:
            axis.setCoordinateNames(_array_str(figures["of"]))
        axis.setAxis(_vec3(figures["axis"]))
        axis.set_function(_function(figures["function"]))  # copies; setFunction would adopt the object
    return transform


def _muscle(name: str, figures: MuscleFigures, common: dict[str, Any], frames: Mapping[str, Any]) -> Any:
    muscle = osim.Millard2012EquilibriumMuscle(
        name,
        figures["max_isometric_force"],
        figures["optimal_fiber_length"],
        figures["tendon_slack_length"],
        figures["pennation_angle_at_optimal"],
    )
    muscle.set_fiber_damping(common["fiber_damping"])
    muscle.set_default_activation(common["default_activation"])
    muscle.set_minimum_activation(common["minimum_activation"])
    muscle.set_ignore_tendon_compliance(figures["ignore_tendon_compliance"])
    for curve_name in _CURVES:
        curve = getattr(muscle, f"upd_{curve_name}")()
        for setting, value in common[curve_name].items():
            getattr(curve, f"set_{setting}")(value)
    for number, (body, location) in enumerate(figures["points"], start=1):
        muscle.addNewPathPoint(f"{name}-P{number}", frames[body], _vec3(location))
    wraps = muscle.updGeometryPath().updWrapSet()
    for wrap_name, method, (first, last) in figures["wraps"]:
        wrap = osim.PathWrap()
        wrap.set_wrap_object(wrap_name)
        wrap.set_method(method)
        wrap.set_range(0, first)
        wrap.set_range(1, last)
        wraps.cloneAndAppend(wrap)
    return muscle


def _knee(model: osim.Model, side: str) -> Any:
    """The custom joint that holds ``knee_angle`` of a side."""
    name = f"knee_angle_{side}"
    coordinates = model.updCoordinateSet()
    if coordinates.getIndex(name) < 0:
        raise InputError(
            f"the model has no coordinate '{name}'", where=model.getName(), hint="name the knee flexions so"
        )
    joint_name = coordinates.get(name).getJoint().getName()
    joint = osim.CustomJoint.safeDownCast(model.updJointSet().get(joint_name))
    if joint is None:
        raise InputError(
            "the knee is no custom joint", where=joint_name, hint="use a model with a CustomJoint as knee"
        )
    return joint


def _free_axes(joint: Any, side: str) -> list[tuple[int, float]]:
    """Index and sign of the rotations that are adduction and internal rotation, from the joint's geometry.

    Adduction of the right tibia turns about its anterior axis, internal rotation about its upward axis;
    both turn the other way on the left. Flexion turns about the axis to the left on both sides.
    """
    frame = osim.PhysicalOffsetFrame.safeDownCast(joint.getChildFrame())
    orientation = np.eye(3) if frame is None else body_fixed_xyz(_array(frame.get_orientation()))
    transform = joint.getSpatialTransform()
    axes = [orientation @ _array(transform.getTransformAxis(i).getAxis()) for i in range(3)]
    mirror = 1.0 if side == "r" else -1.0
    flexion = next(i for i in range(3) if abs(axes[i][2]) == max(abs(axis[2]) for axis in axes))
    directions = [(np.array([mirror, 0.0, 0.0])), np.array([0.0, mirror, 0.0])]
    found: list[tuple[int, float]] = []
    for direction in directions:
        index = max((i for i in range(3) if i != flexion), key=lambda i: abs(axes[i] @ direction))
        cosine = float(axes[index] @ direction)
        if abs(cosine) < _ALIGNED:
            raise InputError(
                "the knee's axes are not anterior, upward and lateral",
                where=joint.getName(),
                hint="use body frames that are x anterior, y up, z right",
            )
        found.append((index, float(np.sign(cosine))))
    slope = _slope_at_zero(transform.getTransformAxis(flexion))
    if slope * axes[flexion][2] > -_ALIGNED:
        raise InputError(
            f"knee_angle_{side} does not flex the knee when it grows",
            where=joint.getName(),
            hint="use a model in which knee flexion is positive",
        )
    return found


def _slope_at_zero(axis: Any) -> float:
    step = 1e-4
    low, high = (axis.getFunction().calcValue(osim.Vector(1, x)) for x in (-step, step))
    return (high - low) / (2.0 * step)


def _free_rotation(joint: Any, axis: int, name: str, limit: float, sign: float) -> None:
    coordinate = osim.Coordinate()
    coordinate.setName(name)
    coordinate.setRangeMin(-limit)
    coordinate.setRangeMax(limit)
    coordinate.set_clamped(False)
    joint.append_coordinates(coordinate)  # must exist before an axis names it
    entry = joint.upd_SpatialTransform().updTransformAxis(axis)
    entry.setCoordinateNames(_array_str(name))
    entry.set_function(osim.LinearFunction(sign, 0.0))


def _function(figures: Function) -> Any:
    match figures:
        case {"constant": value}:
            return osim.Constant(value)
        case {"linear": [a, b]}:
            return osim.LinearFunction(a, b)
        case {"spline": [x, y]}:
            spline = osim.SimmSpline()
            for knot, value in zip(x, y, strict=True):
                spline.addPoint(knot, value)
            return spline
    raise InputError("unknown joint function", where=str(figures), hint="use linear, constant or spline")


def _array_str(name: str) -> osim.ArrayStr:
    names = osim.ArrayStr()
    names.append(name)
    return names


def _vec3(values: Any) -> osim.Vec3:
    return osim.Vec3(*(float(value) for value in values))


def _array(vector: Any) -> np.ndarray:
    return np.array([vector.get(i) for i in range(3)])
