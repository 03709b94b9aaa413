"""Scale the model's figures to a person, the way OpenSim's ``Model::scale`` does.

Every body has three factors along the axes of its frame; `segment_scales` measures them on a standing person.
Joint frames, centres of mass, wraps, path points and markers move with their bodies. Inertias follow the
factors at unchanged mass, then one factor for all masses and inertias makes the total mass the person's.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.skeleton.anthropometry import Scales, measure_segments, segment_scales
from hilbrace.skeleton.kinematics import Pose, Skeleton, body_fixed_xyz, skeleton_from_table
from hilbrace.skeleton.table import BodyFigures, Function, JointFigures, MuscleFigures, Table, WrapFigures

Array = np.ndarray

__all__ = ["Scales", "measure_segments", "scaled_inertia", "scaled_table", "segment_scales"]

_SAME = 1e-12


def scaled_table(table: Table, scales: Scales, mass_kg: float) -> Table:
    """The figures of a model scaled to a person.

    Equal to OpenSim's own scaling but for one point: fibre and tendon lengths follow the straight path
    through a muscle's points in the neutral pose, where OpenSim's takes the path around the wraps.

    Args:
        table: Figures of the unscaled model.
        scales: Factors of the bodies, as from `segment_scales`.
        mass_kg: Mass of the person [kg].

    Returns:
        A new table.

    Raises:
        InputError: A body is unknown, or a factor or the mass is not positive.
    """
    factors = {body: np.ones(3) for body in ("ground", *table["bodies"])}
    for body, given in scales.items():
        factor = np.asarray(given, dtype=float)
        if body not in table["bodies"] or factor.shape != (3,) or not np.all(factor > 0):
            raise InputError(
                f"no scale factors {factor.tolist()} for this body",
                where=body,
                hint="give three positive factors for a body of the model",
            )
        factors[body] = factor
    if not mass_kg > 0:
        raise InputError(
            f"a mass of {mass_kg} kg", where="scaled_table", hint="give the subject's mass in kg"
        )
    scaled = copy.deepcopy(table)
    density = mass_kg / sum(body["mass"] for body in table["bodies"].values())
    scaled["bodies"] = {n: _scaled_body(b, factors[n], density) for n, b in table["bodies"].items()}
    scaled["joints"] = [_scaled_joint(joint, factors) for joint in scaled["joints"]]
    scaled["wraps"] = {n: _scaled_wrap(w, factors[w["body"]]) for n, w in scaled["wraps"].items()}
    scaled["markers"] = {
        name: [body, _times(location, factors[body]), fixed]
        for name, (body, location, fixed) in table["markers"].items()
    }
    for muscle in scaled["muscles"].values():
        muscle["points"] = [[body, _times(place, factors[body])] for body, place in muscle["points"]]
    _scale_fibres(table, scaled)
    return scaled


def scaled_inertia(body: BodyFigures, factor: Float[Array, " 3"]) -> list[float]:
    """Inertia of a body stretched along its axes at unchanged mass (OpenSim's rule).

    Under equal factors it grows with their square. Otherwise the body is taken for a cylinder along the axis
    of least inertia, whose radius and length are stretched; the products grow with both of their factors.

    Args:
        body: Figures of the unscaled body.
        factor: Factors along the axes.

    Returns:
        Inertia xx yy zz xy xz yz [kg*m^2].
    """
    x, y, z = factor
    moments, products = np.array(body["inertia"][:3]), np.array(body["inertia"][3:])
    if np.ptp(factor) <= _SAME * factor.max():
        return [*(moments * x * x).tolist(), *(products * x * x).tolist()]
    mass = body["mass"]
    axis = int(np.argmin(moments))
    across = [k for k in range(3) if k != axis]
    radius_squared = max(2.0 * moments[axis] / mass, 0.0)
    length_squared = max(12.0 * (moments[across[0]] / mass - 0.25 * radius_squared), 0.0)
    radius_squared *= factor[across[0]] * factor[across[1]]
    length_squared *= factor[axis] ** 2
    stretched = np.full(3, mass * (length_squared / 12.0 + 0.25 * radius_squared))
    stretched[axis] = 0.5 * mass * radius_squared
    return [*stretched.tolist(), *(products * np.array([x * y, x * z, y * z])).tolist()]


def _scaled_body(body: BodyFigures, factor: Float[Array, " 3"], density: float) -> BodyFigures:
    return {
        "mass": body["mass"] * density,
        "com": _times(body["com"], factor),
        "inertia": [value * density for value in scaled_inertia(body, factor)],
    }


def _scaled_joint(joint: JointFigures, factors: Scales) -> JointFigures:
    parent, child = factors[joint["parent"]], factors[joint["child"]]
    joint = copy.deepcopy(joint)
    joint["parent_frame"][0] = _times(joint["parent_frame"][0], parent)
    joint["child_frame"][0] = _times(joint["child_frame"][0], child)
    for axis in joint.get("transform", [])[3:]:
        if axis["function"] != {"linear": [1.0, 0.0]}:  # OpenSim leaves free translations alone
            axis["function"] = _scaled_function(axis["function"], float(np.dot(axis["axis"], parent)))
    return joint


def _scaled_function(function: Function, factor: float) -> Function:
    match function:
        case {"constant": value}:
            return {"constant": factor * value}
        case {"linear": [a, b]}:
            return {"linear": [factor * a, factor * b]}
        case {"spline": [x, y]}:
            return {"spline": [list(x), [factor * value for value in y]]}
    raise InputError("unknown joint function", where=str(function), hint="use linear, constant or spline")


def _scaled_wrap(wrap: WrapFigures, factor: Float[Array, " 3"]) -> WrapFigures:
    """Radius by the mean stretch across the cylinder, length by the stretch along it."""
    stretch = np.linalg.norm(body_fixed_xyz(wrap["rotation"]) * factor[:, None], axis=0)
    scaled = wrap.copy()
    scaled["translation"] = _times(wrap["translation"], factor)
    scaled["radius"] = wrap["radius"] * float(stretch[0] + stretch[1]) / 2.0
    scaled["length"] = wrap["length"] * float(stretch[2])
    return scaled


def _scale_fibres(table: Table, scaled: Table) -> None:
    before, after = skeleton_from_table(table), skeleton_from_table(scaled)
    pose_before, pose_after = before.forward({}), after.forward({})
    for name, muscle in scaled["muscles"].items():
        longer = _straight_length(after, pose_after, muscle)
        ratio = longer / _straight_length(before, pose_before, table["muscles"][name])
        muscle["optimal_fiber_length"] *= ratio
        muscle["tendon_slack_length"] *= ratio


def _straight_length(skeleton: Skeleton, pose: Pose, muscle: MuscleFigures) -> float:
    points = np.stack([skeleton.point(pose, body, place)[0] for body, place in muscle["points"]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _times(place: Any, factor: Float[Array, " 3"]) -> list[float]:
    return (np.asarray(place) * factor).tolist()
