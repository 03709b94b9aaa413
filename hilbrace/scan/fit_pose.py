"""Shape and pose of a limb from a scan: iterated closest points with a body model (stage one).

Each point of the scan pulls the nearest place of the model along the model's normal, and a little sideways;
strays pull less (Cauchy's weight). Shape coefficients and angles are held by their spread in the population,
so that what a scan does not show stays ordinary.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from hilbrace.scan.fit_limb import ANGLES, Limb, Pose, PosedLimb, pose_limb
from hilbrace.scan.nearest import Nearest, nearest
from hilbrace.scan.surface_scan import SurfaceScan
from hilbrace.units import DEG

Array = np.ndarray

POINT_ERROR = 0.006
"""What a point is trusted to: the scan, and the model of a stranger with its bones [m]."""
WORTH = 800.0
"""As many independent points is a scan worth: the model's errors at neighbouring points are alike."""
SIDEWAYS = 0.05
"""Weight of the distance within the surface against that along its normal."""
LAST_SIDEWAYS = 1e-3
"""The same in the last round, which ends where the skin has stopped sliding."""
LANDMARK_ERROR = 0.008
"""What a landmark is trusted to [m]."""
SPREAD_DEG: dict[str, float] = dict(zip(ANGLES, (20.0, 10.0, 15.0, 25.0, 2.0, 3.0, 15.0, 8.0), strict=True))
"""Spread of each angle among standing people [deg]; knees hardly leave the sagittal plane."""
FROZEN_DEG = 1e-4
RIDGE = 1.0
"""Least resistance to a step, so that there is one where no point touches the model."""
LARGEST_TURN = 0.3
FAR = 0.04
"""Distance beyond which a point belongs to something else [m]."""
BEYOND = 0.015
"""What a point counts at most for the misfit that lies beyond the model's upper end [m]."""
FOOT_SEEN = 0.4
"""Part of the foot that a scan must show before its angles are fitted [-]."""
_NEAR_FOOT = 0.012


@dataclass(frozen=True)
class LimbFit:
    """A limb's shape and pose in a scan.

    Attributes:
        limb: The limb.
        shape: Shape coefficients of the model.
        pose: Place and angles.
        foot: True where the scan shows the foot, so that the ankle's angles were fitted.
        misfit: Mean distance of the scan's points from the model, each counted to `FAR` at most [m].
        held: Angles that are known, by name [rad].
    """

    limb: Limb
    shape: Float[Array, " coefficient"]
    pose: Pose
    foot: bool = False
    misfit: float = np.inf
    held: tuple[tuple[str, float], ...] = ()

    @property
    def angles_deg(self) -> dict[str, float]:
        """Joint angles by name [deg]."""
        return {
            name: float(angle / DEG)
            for name, angle in zip(self.limb.angle_names, self.pose.angles, strict=True)
        }


@dataclass(frozen=True)
class Marks:
    """Landmarks: points of the scan, and what they are points of.

    Attributes:
        places: Points in the scan [m].
        vertex: Vertices of the limb that they mark.
    """

    places: Float[Array, "mark 3"]
    vertex: Int[Array, " mark"]


def held_at(fit: LimbFit, known: dict[str, float]) -> LimbFit:
    """A start in which angles are held at what is known.

    Args:
        fit: The start.
        known: Angles by name [rad].
    """
    names = fit.limb.angle_names
    angles = [known.get(name, angle) for name, angle in zip(names, fit.pose.angles, strict=True)]
    pose = replace(fit.pose, angles=np.array(angles))
    return replace(fit, pose=pose, held=tuple(sorted(known.items())))


def fit_pose(
    start: LimbFit,
    scan: SurfaceScan,
    count: int,
    steps: int,
    shaped: int | None = None,
    marks: Marks | None = None,
    sideways: float = SIDEWAYS,
) -> LimbFit:
    """Gauss-Newton steps from a start.

    Args:
        start: Where to begin.
        scan: The scan.
        count: Points of the scan to use, evenly chosen.
        steps: Most steps.
        shaped: Shape coefficients to fit, the leading ones; all if left out.
        marks: Landmarks.
        sideways: Weight of the distance within the surface: it steadies the first steps, but as the nearest
            places go along with the model it also keeps the skin from sliding to where it belongs.
    """
    chosen = np.unique(np.linspace(0, len(scan.points) - 1, count).astype(np.int64))
    points, normals = scan.points[chosen], scan.normals[chosen]
    fit = start
    shaped = len(start.shape) if shaped is None else shaped
    for _ in range(steps):
        posed = pose_limb(fit.limb, fit.shape, fit.pose)
        foot = foot_seen(fit.limb, posed, scan)
        contact = _contact(fit.limb, posed, points, normals, scan.oriented)
        change, short = _step(fit, posed, contact, foot, shaped, marks, sideways)
        fit = replace(_moved(fit, change), foot=foot, misfit=contact.misfit)
        if short:
            break
    return fit


def foot_seen(limb: Limb, posed: PosedLimb, scan: SurfaceScan) -> bool:
    """Does the scan show the foot?"""
    feet = limb.weights[:, 3::3].sum(axis=1) > 0.5
    places = posed.vertices[feet]
    sample = scan.points[:: max(1, len(scan.points) // 20000)]
    low, high = places.min(axis=0) - FAR, places.max(axis=0) + FAR
    near = sample[((sample > low) & (sample < high)).all(axis=1)]
    if len(near) < 10:
        return False
    gap = cKDTree(near).query(places)[0]
    return bool((gap < _NEAR_FOOT).mean() > FOOT_SEEN)


@dataclass(frozen=True)
class _Contact:
    """Nearest places of the model to points of the scan, and what each is worth."""

    near: Nearest
    gap: Float[Array, "point 3"]
    weight: Float[Array, " point"]
    misfit: float


def _contact(
    limb: Limb,
    posed: PosedLimb,
    points: Float[Array, "point 3"],
    normals: Float[Array, "point 3"],
    oriented: bool,
) -> _Contact:
    near = nearest(points, posed.vertices, limb.triangles)
    width = max(0.003, 1.5 * float(np.median(near.distance)))
    facing = (near.normal * normals).sum(axis=1)
    weight = 1.0 / (1.0 + (near.distance / width) ** 2)
    weight *= (facing if oriented else np.abs(facing)) > 0.3
    weight *= (near.distance < FAR) & ~near.beyond
    misfit = float(np.minimum(near.distance, np.where(near.beyond, BEYOND, FAR)).mean())
    return _Contact(near, near.place - points, weight, misfit)


def _step(
    fit: LimbFit,
    posed: PosedLimb,
    contact: _Contact,
    foot: bool,
    shaped: int,
    marks: Marks | None,
    sideways: float,
) -> tuple[Float[Array, " parameter"], bool]:
    """One regularised least-squares step, and whether it is so short that no other is needed."""
    turns = posed.turn_slope
    shifts = np.broadcast_to(np.eye(3)[:, None], turns.shape)
    slopes = np.concatenate([posed.shape_slope[:shaped], turns, shifts, posed.angle_slope])
    at = np.einsum("pk,npki->npi", contact.near.share, slopes[:, contact.near.corner])
    along = np.einsum("pi,npi->np", contact.near.normal, at)
    worth = contact.weight * WORTH / max(1.0, contact.weight.sum()) / POINT_ERROR**2
    ahead = (contact.near.normal * contact.gap).sum(axis=1)
    normal = (along * worth) @ along.T
    pull = (along * worth) @ ahead
    flat = at.reshape(len(slopes), -1)
    worth_flat = sideways * np.repeat(worth, 3)
    normal += (flat * worth_flat) @ flat.T
    pull += (flat * worth_flat) @ contact.gap.ravel()
    if marks is not None:
        marked = slopes[:, marks.vertex].reshape(len(slopes), -1)
        off = (posed.vertices[marks.vertex] - marks.places).ravel()
        normal += LANDMARK_ERROR**-2.0 * marked @ marked.T
        pull += LANDMARK_ERROR**-2.0 * marked @ off
    held, value = _prior(fit, foot, shaped)
    normal += np.diag(held)
    pull += held * value
    change = -np.linalg.solve(normal + RIDGE * np.eye(len(normal)), pull)
    turned = np.abs(np.concatenate([change[shaped : shaped + 3], change[shaped + 6 :]])).max()
    change *= min(1.0, LARGEST_TURN / max(float(turned), 1e-12))
    full = np.concatenate([change[:shaped], np.zeros(len(fit.shape) - shaped), change[shaped:]])
    return full, bool(np.abs(change).max() < 1e-4)


def _prior(
    fit: LimbFit, foot: bool, shaped: int
) -> tuple[Float[Array, " parameter"], Float[Array, " parameter"]]:
    """Weight of each parameter's distance from the ordinary, and that distance."""
    limb = fit.limb
    alone = len(limb.sides) == 1
    spread = []
    known = dict(fit.held)
    usual = np.array([known.get(name, 0.0) for name in limb.angle_names])
    for name in limb.angle_names:
        angle = name[:-2]
        # The pelvis of a single leg is not seen, nor is a foot outside the scan.
        frozen = (alone and angle.startswith("hip")) or (
            not foot and angle in ("ankle_angle", "subtalar_angle")
        )
        spread.append(FROZEN_DEG if frozen or name in known else SPREAD_DEG[angle])
    held = np.concatenate([limb.model.spread[:shaped] ** -2.0, np.zeros(6), (np.array(spread) * DEG) ** -2.0])
    return held, np.concatenate([fit.shape[:shaped], np.zeros(6), fit.pose.angles - usual])


def _moved(fit: LimbFit, change: Float[Array, " parameter"]) -> LimbFit:
    count = len(fit.shape)
    turn = Rotation.from_rotvec(change[count : count + 3]).as_matrix()
    pose = Pose(
        rotation=turn @ fit.pose.rotation,
        translation=fit.pose.translation + change[count + 3 : count + 6],
        angles=fit.pose.angles + change[count + 6 :],
    )
    return replace(fit, shape=fit.shape + change[:count], pose=pose)
