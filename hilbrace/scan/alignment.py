"""Where to begin a fit: from landmarks, or by trying how a standing leg may lie in the scan's axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import igl
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from hilbrace.errors import InputError
from hilbrace.run.progress import Report
from hilbrace.scan.fit_limb import Limb, Pose, limb_of, pose_limb
from hilbrace.scan.fit_pose import LAST_SIDEWAYS, LimbFit, Marks, fit_pose
from hilbrace.scan.surface_scan import SurfaceScan

Array = np.ndarray

YAWS = 8
SLIDE = 0.05
"""Distance between the places along the leg that are tried [m]."""
OVERHANG = 0.15
"""How far a scan may reach beyond the model at a start [m]."""
STATURES = (-1.5, 0.0, 1.5)
"""Leg lengths that are tried, in standard deviations of the population."""
TRIED, FINALISTS = 12, 4
"""Starts that are tried and that go on where the direction is unknown; half as many where it is given."""
COARSE_POINTS, START_POINTS = 150, 400
CAP = 0.06
LEADING = 4
"""Shape coefficients that a start may change: height, build."""
CLEAR = 1.15
"""A runner-up that fits less than this many times worse leaves the direction in doubt [-]."""


@dataclass(frozen=True)
class Start:
    """Where a fit begins.

    Attributes:
        fit: The start.
        doubt: True where another direction fits almost as well.
    """

    fit: LimbFit
    doubt: bool


def start_from_marks(limb: Limb, marks: Marks) -> Start:
    """Lay the mean person onto landmarks.

    Args:
        limb: The limb.
        marks: Three landmarks at least, not on one line.

    Raises:
        InputError: The landmarks do not fix the limb.
    """
    mean = _upright(limb)
    own = pose_limb(limb, mean.shape, mean.pose).vertices[marks.vertex]
    spread = np.linalg.svd(own - own.mean(axis=0), compute_uv=False)
    if len(own) < 3 or spread[1] < 0.02:
        raise InputError(
            f"{len(own)} landmarks that lie on one line do not fix the leg",
            where="landmarks",
            hint="mark both sides of the knee, and the kneecap or both sides of the ankle",
        )
    rotation = Rotation.align_vectors(marks.places - marks.places.mean(axis=0), own - own.mean(axis=0))[
        0
    ].as_matrix()
    translation = marks.places.mean(axis=0) - rotation @ own.mean(axis=0)
    return Start(replace(mean, pose=replace(mean.pose, rotation=rotation, translation=translation)), False)


def find_start(
    limb: Limb,
    scan: SurfaceScan,
    up: Float[Array, "3"] | None,
    forward: Float[Array, "3"] | None,
    progress: Report,
) -> Start:
    """Try directions and places of a standing leg, and keep the one that fits best.

    Args:
        limb: The limb.
        scan: The scan.
        up: Upward direction in the scan's axes; both ends of its long axis are tried if left out.
        forward: Forward direction; all around if left out.
        progress: Called with (starts tried, starts in all).
    """
    mean = _upright(limb)
    people = [replace(mean, shape=shape) for shape in _statures(limb)]
    coarse = [fit for person in people for fit in _starts(person, scan, up, forward)]
    known = up is not None and forward is not None
    tried, finalists_kept = (TRIED // 2, FINALISTS // 2) if known else (TRIED, FINALISTS)
    chosen = sorted(coarse, key=lambda one: one.misfit)[:tried]
    done: list[LimbFit] = []
    for number, fit in enumerate(chosen):
        done.append(fit_pose(fit, scan, START_POINTS, 10, shaped=LEADING))
        progress(number + 1, len(chosen) + finalists_kept)
    finalists: list[LimbFit] = []
    for fit in sorted(done, key=lambda one: one.misfit)[:finalists_kept]:
        finalists.append(fit_pose(fit, scan, 3 * START_POINTS, 8))
        progress(len(chosen) + len(finalists), len(chosen) + finalists_kept)
    first, *others = sorted(finalists, key=lambda one: one.misfit)
    rivals = [one for one in others if _turned(first, one) > np.deg2rad(30.0)]
    return Start(first, any(one.misfit < CLEAR * first.misfit for one in rivals))


def mirrored_misfit(fit: LimbFit, scan: SurfaceScan) -> float:
    """Misfit of the other leg in the same place, over the leg's own: below 1 it fits better [-].

    Both are fitted alike, from the same person, so that the leg has no advantage from what went before.

    Args:
        fit: A fitted leg.
        scan: The scan.
    """
    found = []
    knee = pose_limb(fit.limb, fit.shape, fit.pose).joints[f"knee_{fit.limb.sides[0]}"]
    for side in ("l", "r"):
        one = replace(fit, limb=limb_of(fit.limb.model, (side,)))
        there = pose_limb(one.limb, one.shape, one.pose).joints[f"knee_{side}"]
        one = replace(one, pose=replace(one.pose, translation=one.pose.translation + knee - there))
        one = fit_pose(one, scan, START_POINTS, 12, shaped=LEADING)
        found.append(fit_pose(one, scan, START_POINTS, 12, sideways=LAST_SIDEWAYS).misfit)
    left, right = found
    return right / left if fit.limb.sides == ("l",) else left / right


def _upright(limb: Limb) -> LimbFit:
    pose = Pose(np.eye(3), np.zeros(3), np.zeros(len(limb.angle_names)))
    return LimbFit(limb=limb, shape=np.zeros(len(limb.directions)), pose=pose)


def _statures(limb: Limb) -> list[Float[Array, " coefficient"]]:
    """Ordinary people with short, middling and long legs."""
    moves = limb.model.joint_moves()
    side = limb.sides[0]
    longer = (moves[f"hip_{side}"] - moves[f"ankle_{side}"])[:, 1] * limb.model.spread**2
    longer[LEADING:] = 0.0
    longer /= np.linalg.norm(longer / limb.model.spread)
    return [stature * longer for stature in STATURES]


def _turned(one: LimbFit, other: LimbFit) -> float:
    return float(Rotation.from_matrix(one.pose.rotation.T @ other.pose.rotation).magnitude())


def _starts(
    mean: LimbFit, scan: SurfaceScan, up: Float[Array, "3"] | None, forward: Float[Array, "3"] | None
) -> list[LimbFit]:
    """A person at each direction and height, with the misfit there."""
    posed = pose_limb(mean.limb, mean.shape, mean.pose).vertices
    distance = _distance_to(posed, mean.limb)
    sample = scan.points[:: max(1, len(scan.points) // COARSE_POINTS)]
    found = []
    for rotation in _rotations(scan, up, forward):
        turned = sample @ rotation  # The scan in OpenSim axes, were this the right direction.
        low, high = turned[:, 1].min(), turned[:, 1].max()
        for shift in _slides((low, high), (posed[:, 1].min(), posed[:, 1].max())):
            moved = turned + np.array([0.0, shift, 0.0])
            moved += _beside(posed, moved)
            gap = float(np.minimum(distance(moved), CAP).mean())
            translation = rotation @ (turned[0] - moved[0])
            pose = replace(mean.pose, rotation=rotation, translation=translation)
            found.append(replace(mean, pose=pose, misfit=gap))
    return found


def _rotations(
    scan: SurfaceScan, up: Float[Array, "3"] | None, forward: Float[Array, "3"] | None
) -> list[Float[Array, "3 3"]]:
    """Rotations from OpenSim axes into the scan's that are to be tried."""
    if up is None:
        centred = scan.points - scan.points.mean(axis=0)
        long = np.linalg.eigh(centred.T @ centred)[1][:, -1]
        ups = [long, -long]
    else:
        ups = [up / np.linalg.norm(up)]
    rotations = []
    for axis in ups:
        seed = forward if forward is not None else np.eye(3)[np.abs(axis).argmin()]
        ahead = seed - (seed @ axis) * axis
        ahead /= np.linalg.norm(ahead)
        frame = np.column_stack([ahead, axis, np.cross(ahead, axis)])
        yaws = [0.0] if forward is not None else np.arange(YAWS) * 2.0 * np.pi / YAWS
        rotations += [frame @ Rotation.from_rotvec([0.0, yaw, 0.0]).as_matrix() for yaw in yaws]
    return rotations


def _slides(scan: tuple[float, float], model: tuple[float, float]) -> list[float]:
    """Shifts along the leg that bring the scan, but for an overhang, within the model."""
    lowest = model[0] - OVERHANG - scan[0]
    highest = model[1] + OVERHANG - scan[1]
    if highest <= lowest:
        return [model[0] - scan[0], (sum(model) - sum(scan)) / 2.0, model[1] - scan[1]]
    return list(np.arange(lowest, highest + SLIDE, SLIDE))


def _beside(model: Float[Array, "vertex 3"], scan: Float[Array, "point 3"]) -> Float[Array, "3"]:
    """Horizontal shift that lays the scan's middle on the model's at the same heights."""
    inside = (model[:, 1] > scan[:, 1].min()) & (model[:, 1] < scan[:, 1].max())
    own = model[inside] if inside.sum() > 10 else model
    shift = own.mean(axis=0) - scan.mean(axis=0)
    shift[1] = 0.0
    return shift


def _distance_to(
    vertices: Float[Array, "vertex 3"], limb: Limb
) -> Callable[[Float[Array, "point 3"]], Float[Array, " point"]]:
    tree = igl.AABB()
    vertices, triangles = np.ascontiguousarray(vertices), np.ascontiguousarray(limb.triangles)
    tree.init(vertices, triangles)
    return lambda points: np.sqrt(tree.squared_distance(vertices, triangles, np.ascontiguousarray(points))[0])
