"""Transcribe a full-body model file of Rajagopal et al. into the figures that the package carries.

Run once, when the source changes::

    python -m hilbrace.skeleton.transcribe Rajagopal2015.osim hilbrace/skeleton/rajagopal.json

The source is an OpenSim document of version 30000. Only its figures are kept: bodies, joints, couplers, wrap
cylinders, muscles, actuators and markers. Bone meshes, the groups of the force set and the bounds of controls
are left out.

Source: A. Rajagopal, C. Dembia, M. DeMers, D. Delp, J. Hicks, S. Delp, "Full-body musculoskeletal model for
muscle-driven simulation of human gait", IEEE Transactions on Biomedical Engineering 63(10), 2016.
"""

from __future__ import annotations

import argparse
import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from hilbrace.errors import InputError

_CURVES = ("ActiveForceLengthCurve", "ForceVelocityCurve", "FiberForceLengthCurve", "TendonForceLengthCurve")
_SHARED_FIGURES = ("fiber_damping", "default_activation", "minimum_activation")
_MUSCLE_FIGURES = (
    "max_isometric_force",
    "optimal_fiber_length",
    "tendon_slack_length",
    "pennation_angle_at_optimal",
)


def transcribe(path: Path) -> dict[str, Any]:
    """Read the figures of a model file.

    Args:
        path: OpenSim document of version 30000 that holds a full-body model of Rajagopal's kind.

    Returns:
        The table described in `hilbrace.skeleton.table.Table` [m, kg, N, rad], knees as in the source.

    Raises:
        InputError: The file is no such document, or holds an element that the table cannot express.
    """
    try:
        model = ET.parse(path).getroot().find("Model")
    except (OSError, ET.ParseError) as fault:
        raise InputError(
            f"cannot read the model: {fault}", where=str(path), hint="name an .osim file of version 30000"
        ) from fault
    if model is None or model.find("BodySet/objects") is None:
        raise _unexpected("no bodies", path.name)
    shared, muscles = _muscles(model)
    return {
        "credits": _text(model, "credits"),
        "publications": _text(model, "publications"),
        "gravity": _numbers(model, "gravity"),
        "bodies": _bodies(model),
        "joints": _joints(model),
        "couplers": [_coupler(item) for item in _objects(model, "ConstraintSet")],
        "wraps": _wraps(model),
        "muscle_common": shared,
        "muscles": muscles,
        "actuators": _actuators(model),
        "markers": {
            item.attrib["name"]: [_text(item, "body"), _numbers(item, "location"), _flag(item, "fixed")]
            for item in _objects(model, "MarkerSet")
        },
    }


def one_record_a_line(table: dict[str, Any]) -> str:
    """The table as JSON text with one body, joint, muscle or marker a line, so that changes read well."""
    parts: list[str] = []
    for key, value in table.items():
        if key in ("gravity", "muscle_common") or not isinstance(value, dict | list):
            body = json.dumps(value)
        elif isinstance(value, dict):
            rows = (f"{json.dumps(name)}: {json.dumps(record)}" for name, record in value.items())
            body = "{\n" + ",\n".join(rows) + "\n}"
        else:
            body = "[\n" + ",\n".join(json.dumps(record) for record in value) + "\n]"
        parts.append(f"{json.dumps(key)}: {body}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _bodies(model: ET.Element) -> dict[str, Any]:
    bodies: dict[str, Any] = {}
    for item in _objects(model, "BodySet"):
        if item.attrib["name"] == "ground":
            continue
        moments = [_number(item, f"inertia_{axes}") for axes in ("xx", "yy", "zz", "xy", "xz", "yz")]
        bodies[item.attrib["name"]] = {
            "mass": _number(item, "mass"),
            "com": _numbers(item, "mass_center"),
            "inertia": moments,
        }
    return bodies


def _joints(model: ET.Element) -> list[dict[str, Any]]:
    joints: list[dict[str, Any]] = []
    for item in _objects(model, "BodySet"):
        holder = item.find("Joint")
        if holder is None or len(holder) == 0:
            continue
        joint = holder[0]
        if _flag(joint, "reverse"):
            raise _unexpected("a reversed joint", joint.attrib["name"])
        record: dict[str, Any] = {
            "name": joint.attrib["name"],
            "type": joint.tag,
            "parent": _text(joint, "parent_body"),
            "child": item.attrib["name"],
            "parent_frame": [_numbers(joint, "location_in_parent"), _numbers(joint, "orientation_in_parent")],
            "child_frame": [_numbers(joint, "location"), _numbers(joint, "orientation")],
            "coordinates": [_coordinate(entry) for entry in _objects(joint, "CoordinateSet")],
        }
        if joint.tag == "CustomJoint":
            record["transform"] = [_transform_axis(axis) for axis in joint.iterfind("SpatialTransform/*")]
        joints.append(record)
    return joints


def _coordinate(item: ET.Element) -> dict[str, Any]:
    if _flag(item, "prescribed"):
        raise _unexpected("a prescribed coordinate", item.attrib["name"])
    return {
        "name": item.attrib["name"],
        "default": _number(item, "default_value"),
        "range": _numbers(item, "range"),
        "clamped": _flag(item, "clamped"),
        "locked": _flag(item, "locked"),
    }


def _transform_axis(item: ET.Element) -> dict[str, Any]:
    coordinate = (item.findtext("coordinates") or "").strip() or None
    return {"axis": _numbers(item, "axis"), "of": coordinate, "function": _function(item, "function")}


def _function(item: ET.Element, tag: str) -> dict[str, Any]:
    holder = item.find(tag)
    if holder is None or len(holder) != 1:
        raise _unexpected(f"<{tag}> without one function", item.attrib.get("name", item.tag))
    function = holder[0]
    if function.tag == "LinearFunction":
        return {"linear": _numbers(function, "coefficients")}
    if function.tag == "Constant":
        return {"constant": _number(function, "value")}
    if function.tag == "SimmSpline":
        return {"spline": [_numbers(function, "x"), _numbers(function, "y")]}
    raise _unexpected(f"a {function.tag}", item.attrib.get("name", item.tag))


def _coupler(item: ET.Element) -> dict[str, Any]:
    return {
        "name": item.attrib["name"],
        "independent": _text(item, "independent_coordinate_names"),
        "dependent": _text(item, "dependent_coordinate_name"),
        "function": _function(item, "coupled_coordinates_function"),
    }


def _wraps(model: ET.Element) -> dict[str, Any]:
    wraps: dict[str, Any] = {}
    for body in _objects(model, "BodySet"):
        for item in _objects(body, "WrapObjectSet"):
            if item.tag != "WrapCylinder":
                raise _unexpected(f"a {item.tag}", item.attrib["name"])
            wraps[item.attrib["name"]] = {
                "body": body.attrib["name"],
                "rotation": _numbers(item, "xyz_body_rotation"),
                "translation": _numbers(item, "translation"),
                "quadrant": _text(item, "quadrant"),
                "radius": _number(item, "radius"),
                "length": _number(item, "length"),
                "active": _flag(item, "active"),
            }
    return wraps


def _muscles(model: ET.Element) -> tuple[dict[str, Any], dict[str, Any]]:
    shared: dict[str, Any] | None = None
    muscles: dict[str, Any] = {}
    for item in _objects(model, "ForceSet"):
        if item.tag == "CoordinateActuator":
            continue
        name = item.attrib["name"]
        if item.tag != "Millard2012EquilibriumMuscle":
            raise _unexpected(f"a {item.tag}", name)
        common = _shared_settings(item)
        if shared not in (None, common):
            raise _unexpected("curve settings of its own", name)
        shared = common
        muscles[name] = {figure: _number(item, figure) for figure in _MUSCLE_FIGURES}
        muscles[name]["ignore_tendon_compliance"] = _flag(item, "ignore_tendon_compliance")
        muscles[name].update(_path(item))
    return shared or {}, muscles


def _shared_settings(muscle: ET.Element) -> dict[str, Any]:
    settings: dict[str, Any] = {figure: _number(muscle, figure) for figure in _SHARED_FIGURES}
    for curve in _CURVES:
        leaves = (
            (item.tag, (item.text or "").strip()) for item in muscle.iterfind(f"{curve}/*") if not len(item)
        )
        settings[curve] = {tag: float(text) for tag, text in leaves if text}
    return settings


def _path(muscle: ET.Element) -> dict[str, Any]:
    points: list[Any] = []
    for item in muscle.iterfind("GeometryPath/PathPointSet/objects/*"):
        if item.tag != "PathPoint":
            raise _unexpected(f"a {item.tag}", muscle.attrib["name"])
        points.append([_text(item, "body"), _numbers(item, "location")])
    wraps: list[Any] = []
    for item in muscle.iterfind("GeometryPath/PathWrapSet/objects/*"):
        first_last = [int(bound) for bound in _numbers(item, "range")]
        wraps.append([_text(item, "wrap_object"), _text(item, "method"), first_last])
    return {"points": points, "wraps": wraps}


def _actuators(model: ET.Element) -> dict[str, Any]:
    actuators = [item for item in _objects(model, "ForceSet") if item.tag == "CoordinateActuator"]
    return {
        item.attrib["name"]: {
            "coordinate": _text(item, "coordinate"),
            "optimal_force": _number(item, "optimal_force"),
        }
        for item in actuators
    }


def _objects(item: ET.Element, group: str) -> list[ET.Element]:
    return list(item.iterfind(f"{group}/objects/*"))


def _text(item: ET.Element, tag: str) -> str:
    text = item.findtext(tag)
    if text is None:
        raise _unexpected(f"no <{tag}>", item.attrib.get("name", item.tag))
    return text.strip()


def _numbers(item: ET.Element, tag: str) -> list[float]:
    return [float(word) for word in _text(item, tag).split()]


def _number(item: ET.Element, tag: str) -> float:
    return float(_text(item, tag))


def _flag(item: ET.Element, tag: str) -> bool:
    return _text(item, tag) == "true"


def _unexpected(what: str, where: str) -> InputError:
    return InputError(
        f"the model holds {what}", where=where, hint="transcribe Rajagopal2015.osim of version 30000"
    )


def main() -> None:
    """Command line: source file, then the JSON file to write."""
    parser = argparse.ArgumentParser(description="Transcribe a model file into the package's table.")
    parser.add_argument("source", type=Path, help="OpenSim model, version 30000")
    parser.add_argument("out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    arguments.out.write_text(one_record_a_line(transcribe(arguments.source)), "utf-8")


if __name__ == "__main__":
    main()
