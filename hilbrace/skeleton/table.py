"""The musculoskeletal model as a table of figures: 22 bodies, 80 muscles, 41 free coordinates.

The figures are those of Rajagopal et al., "Full-body musculoskeletal model for muscle-driven simulation of
human gait", IEEE Trans. Biomed. Eng. 63(10), 2016 (transcribed by `hilbrace.skeleton.transcribe`). The source
couples knee adduction and rotation to flexion by splines; `load_table` frees both (37 + 4 = 41 coordinates),
because they are what a knee brace acts on. Lengths are in metres, masses in kilograms, angles in radians; the
frame of each body is x anterior, y up, z to the subject's right when all coordinates are zero.
"""

from __future__ import annotations

import copy
import functools
import json
import math
from importlib import resources
from typing import Any, Literal, NamedTuple, NotRequired, TypedDict

Vector = list[float]
Function = dict[str, Any]
"""``{"linear": [a, b]}`` for a x + b, ``{"constant": c}``, or ``{"spline": [[x..], [y..]]}``."""

SIDES = ("r", "l")


class BodyFigures(TypedDict):
    """Mass [kg], centre of mass [m] and inertia xx yy zz xy xz yz about it [kg*m^2], in the body's frame."""

    mass: float
    com: Vector
    inertia: Vector


class CoordinateFigures(TypedDict):
    """One generalised coordinate [rad or m]."""

    name: str
    default: float
    range: Vector
    clamped: bool
    locked: bool


class TransformAxis(TypedDict):
    """One of three rotations, then three translations, of a joint: by function(coordinate) on an axis."""

    axis: Vector
    of: str | None
    function: Function


class JointFigures(TypedDict):
    """A joint between frames fixed in parent and child: [location, body-fixed x-y-z angles]."""

    name: str
    type: Literal["CustomJoint", "PinJoint", "UniversalJoint"]
    parent: str
    child: str
    parent_frame: list[Vector]
    child_frame: list[Vector]
    coordinates: list[CoordinateFigures]
    transform: NotRequired[list[TransformAxis]]


class CouplerFigures(TypedDict):
    """A coordinate that follows another: dependent = function(independent)."""

    name: str
    independent: str
    dependent: str
    function: Function


class WrapFigures(TypedDict):
    """A cylinder that muscles wrap around; its axis is the z axis of its frame."""

    body: str
    rotation: Vector
    translation: Vector
    quadrant: str
    radius: float
    length: float
    active: bool


class MuscleFigures(TypedDict):
    """A muscle of the kind of Millard et al. 2013: force [N], lengths [m], path points and wraps."""

    max_isometric_force: float
    optimal_fiber_length: float
    tendon_slack_length: float
    pennation_angle_at_optimal: float
    ignore_tendon_compliance: bool
    points: list[Any]
    wraps: list[Any]


class Table(TypedDict):
    """All figures of one model. ``markers``: body, location [m], whether the marker is held fixed."""

    credits: str
    publications: str
    gravity: Vector
    bodies: dict[str, BodyFigures]
    joints: list[JointFigures]
    couplers: list[CouplerFigures]
    wraps: dict[str, WrapFigures]
    muscle_common: dict[str, Any]
    muscles: dict[str, MuscleFigures]
    actuators: dict[str, dict[str, Any]]
    markers: dict[str, list[Any]]


class FreeKneeAxis(NamedTuple):
    """A coordinate that the knee gains: the rotation of the joint that it drives, and its limit [rad]."""

    name: str
    axis: int
    limit: float
    sign_right: float
    sign_left: float


KNEE_EXTRA = (
    FreeKneeAxis("knee_adduction", 1, math.radians(20.0), 1.0, 1.0),
    FreeKneeAxis("knee_rotation", 2, math.radians(35.0), 1.0, -1.0),
)
"""Adduction and internal rotation of the tibia, positive on both sides.

The left knee's frame is the right one's mirrored about the sagittal plane and turned, so that the second
axis already points along adduction; only the third needs its sign changed.
"""


class CoordinateRange(NamedTuple):
    """A coordinate of the model and the values it may take [rad or m]."""

    name: str
    low: float
    high: float
    locked: bool
    follows: str | None


def load_source_table() -> Table:
    """The figures as published: knee adduction and rotation are splines of flexion (37 free coordinates)."""
    return json.loads(_source_text())


def load_table() -> Table:
    """The figures of the model that we use: 41 free coordinates, 3 at each knee. The caller owns the copy."""
    return with_free_knees(load_source_table())


def with_free_knees(table: Table) -> Table:
    """Replace the knees' coupled adduction and rotation by coordinates of their own (`KNEE_EXTRA`).

    Args:
        table: A table whose knee joints are named ``walker_knee_r`` and ``walker_knee_l``.

    Returns:
        A new table; the knees' translations stay functions of flexion.
    """
    table = copy.deepcopy(table)
    for joint in table["joints"]:
        if not joint["name"].startswith("walker_knee_") or "transform" not in joint:
            continue
        side = joint["name"][-1]
        for extra in KNEE_EXTRA:
            name = f"{extra.name}_{side}"
            sign = extra.sign_right if side == "r" else extra.sign_left
            joint["transform"][extra.axis]["of"] = name
            joint["transform"][extra.axis]["function"] = {"linear": [sign, 0.0]}
            joint["coordinates"].append(
                {
                    "name": name,
                    "default": 0.0,
                    "range": [-extra.limit, extra.limit],
                    "clamped": False,
                    "locked": False,
                }
            )
    return table


def coordinate_ranges(table: Table) -> tuple[CoordinateRange, ...]:
    """All coordinates with their ranges in the model's order; ``follows`` names what drives a coupled one."""
    leaders = {coupler["dependent"]: coupler["independent"] for coupler in table["couplers"]}
    return tuple(
        CoordinateRange(name, low, high, item["locked"], leaders.get(name))
        for joint in table["joints"]
        for item in joint["coordinates"]
        for name, (low, high) in [(item["name"], item["range"])]
    )


def free_coordinates(table: Table) -> tuple[str, ...]:
    """Names of the coordinates that no coupler drives (41), locked ones included, in the model's order."""
    return tuple(item.name for item in coordinate_ranges(table) if item.follows is None)


@functools.cache
def _source_text() -> str:
    return resources.files("hilbrace.skeleton").joinpath("rajagopal.json").read_text("utf-8")
