"""Several views brought together by rigid moves.

Iterated closest points with the distance to the tangent plane (Chen & Medioni 1992), pairs trimmed by
distance and normal. Each view is laid on those before it, then every view on all others, the first one
staying. The start is the turn of the limb as stated, with the middles of the limb on each other; without one,
where the view is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from hilbrace.errors import GeometryError
from hilbrace.scan.point_cloud import PointCloud, joined

Array = np.ndarray

VIEW_POINTS, GROUND_POINTS = 4_000, 40_000
"""Points of the moving view and of the resting ones that are used."""
SLICES = 12
"""Level slices of a limb whose middles are found."""
STEPS = 60
SWEEPS = 3
FIRST_REACH, LAST_REACH = 30.0, 2.0
"""Farthest pairs at the start and at the end [mm]."""
MOST_APART = 0.8
"""Cosine between normals from which a pair counts [-]."""
STILL = 1e-3
"""Move at which the search ends [mm]."""
LEAST_OVERLAP = 0.1
"""Part of a view that must lie on the others [-]."""
LARGEST_MISFIT = 1.0
"""Root mean square distance of overlapping surfaces beyond which a merge is refused [mm]."""


@dataclass(frozen=True)
class Move:
    """A rigid move x -> R x + t.

    Attributes:
        rotation: R.
        shift: t [mm].
        misfit_mm: Root mean square distance of the overlapping surfaces after it [mm]; 0 for the first view.
        overlap: Part of the view that lies on the others [-]; 1 for the first.
    """

    rotation: Float[Array, "3 3"]
    shift: Float[Array, " 3"]
    misfit_mm: float = 0.0
    overlap: float = 1.0


def merge_views(
    clouds: Sequence[PointCloud], names: Sequence[str], turns: Sequence[float] | None
) -> list[Move]:
    """Moves that lay all views on the first.

    Args:
        clouds: The views, each in its own camera's upright axes [mm].
        names: Their names, for errors.
        turns: Turn of the limb about the vertical in each view against the first [deg], counter-clockwise
            from above; without them the views start where they are.

    Raises:
        GeometryError: A view does not overlap those before it, or does not fit them.
    """
    thin = [cloud.thinned(GROUND_POINTS) for cloud in clouds]
    moves = [Move(np.eye(3), np.zeros(3))]
    for number in range(1, len(thin)):
        ground = joined(
            [cloud.moved(m.rotation, m.shift) for cloud, m in zip(thin[:number], moves, strict=True)]
        )
        start = moves[-1]
        if turns:
            turn = turns[number] - turns[number - 1]
            start = _start(thin[number - 1], start, thin[number], turn)
        moves.append(_laid_on(thin[number], ground, start, FIRST_REACH))
        _check(moves[-1], names[number], turns is not None)
    for _ in range(SWEEPS if len(thin) > 2 else 0):
        for number in range(1, len(thin)):
            others = [
                cloud.moved(m.rotation, m.shift)
                for k, (cloud, m) in enumerate(zip(thin, moves, strict=True))
                if k != number
            ]
            moves[number] = _laid_on(thin[number], joined(others), moves[number], 2.0 * LAST_REACH)
    return moves


def _laid_on(view: PointCloud, ground: PointCloud, start: Move, reach: float) -> Move:
    """The view laid on resting points, nearest pairs first far, then near."""
    ground = ground.thinned(GROUND_POINTS)
    tree = KDTree(ground.points)
    view = view.thinned(VIEW_POINTS)
    rotation, shift = start.rotation, start.shift
    misfit, overlap = 0.0, 0.0
    for step in range(STEPS):
        points, normals = view.points @ rotation.T + shift, view.normals @ rotation.T
        far = max(LAST_REACH, reach * 0.85**step)
        found = tree.query(points, distance_upper_bound=far)
        distance, nearest = np.asarray(found[0]), np.asarray(found[1])
        hit = np.isfinite(distance)
        hit[hit] = np.einsum("ij,ij->i", normals[hit], ground.normals[nearest[hit]]) > MOST_APART
        if hit.sum() < 50:
            return Move(rotation, shift, float("inf"), float(hit.mean()))
        goal = ground.normals[nearest[hit]].astype(float)
        gap = np.einsum("ij,ij->i", goal, ground.points[nearest[hit]] - points[hit])
        misfit, overlap = float(np.sqrt(np.mean(gap**2))), float(hit.mean())
        turn, move = _small_move(points[hit], goal, gap)
        rotation, shift = turn @ rotation, turn @ shift + move
        if far == LAST_REACH and np.abs(turn @ points[hit][0] + move - points[hit][0]).max() < STILL:
            break
    return Move(rotation, shift, misfit, overlap)


def _small_move(
    points: Float[Array, "pair 3"], normals: Float[Array, "pair 3"], gap: Float[Array, " pair"]
) -> tuple[Float[Array, "3 3"], Float[Array, " 3"]]:
    """The rigid move that closes gaps along normals best, pairs weighed down the farther they are apart."""
    middle = points.mean(axis=0)
    rows = np.concatenate([np.cross(points - middle, normals), normals], axis=1)
    spread = 1.4826 * np.median(np.abs(gap)) + 1e-6
    weight = 1.0 / (1.0 + (gap / (2.0 * spread)) ** 2)
    normal = rows.T @ (weight[:, None] * rows)
    scale = np.diag([1e-6 * np.trace(normal[:3, :3])] * 3 + [1e-6 * np.trace(normal[3:, 3:])] * 3)
    small = np.linalg.solve(normal + scale, rows.T @ (weight * gap))
    turn = Rotation.from_rotvec(small[:3]).as_matrix()
    return turn, middle + small[3:] - turn @ middle


def _start(before: PointCloud, move: Move, view: PointCloud, turn: float) -> Move:
    """The view turned back by its turn since the view before, with the middles of the limb on each other."""
    rotation = Rotation.from_euler("y", -turn, degrees=True).as_matrix()
    shift = limb_middle(before) - rotation @ limb_middle(view)
    return Move(move.rotation @ rotation, move.rotation @ shift + move.shift)


def limb_middle(cloud: PointCloud) -> Float[Array, " 3"]:
    """Middle of a limb that is seen from one side [mm]: median over level slices of the circle through each.

    Its height is that of the camera.
    """
    points = cloud.points.astype(float)
    edges = np.quantile(points[:, 1], np.linspace(0.1, 0.9, SLICES + 1))
    centres = [
        _circle_centre(points[(points[:, 1] >= low) & (points[:, 1] <= high)][:, [0, 2]])
        for low, high in pairwise(edges)
    ]
    x, z = np.median(centres, axis=0)
    return np.array([x, 0.0, z])


def _circle_centre(points: Float[Array, "point 2"]) -> Float[Array, " 2"]:
    """Centre of the circle through points of an arc, fitted to the squares of the radii (Kasa 1976)."""
    middle = points.mean(axis=0)
    flat = points - middle
    rows = np.concatenate([2.0 * flat, np.ones((len(flat), 1))], axis=1)
    return np.linalg.lstsq(rows, (flat**2).sum(axis=1), rcond=None)[0][:2] + middle


def _check(move: Move, name: str, turned: bool) -> None:
    if move.overlap >= LEAST_OVERLAP and move.misfit_mm <= LARGEST_MISFIT:
        return
    fit = f", where they are {move.misfit_mm:.1f} mm apart" if np.isfinite(move.misfit_mm) else ""
    raise GeometryError(
        f"the view lies on those before it with {100 * move.overlap:.0f} % of its points{fit}",
        where=name,
        hint="take neighbouring views no more than 45 degrees apart, leave out the background with --depth"
        + (
            ", and check the angles of --turn and their sign"
            if turned
            else ", and tell their angles by --turn"
        ),
    )
