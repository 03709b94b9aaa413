"""The sheet under a brace from a file: limb or ground, and the way from it to the brace's outer face.

The shells follow the brace as it is: from each point of the limb the way to the outer face is measured on the
brace, and carried over its windows from what lies around them.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, KDTree

from fabrication.draft import neighbour_mean
from fabrication.foreign_brace import Mesh
from fabrication.foreign_limb import tube_ends
from fabrication.halving import refined
from fabrication.limb import section
from fabrication.sheet import Sheet, prolonged, rim_of
from fabrication.sleeve_axis import OPEN_MM
from hilbrace.config import MoldSettings
from hilbrace.errors import GeometryError
from hilbrace.pattern.offset import area_ratio

Array = np.ndarray

MARGIN_MM = 10.0
"""Ground left and right of a coupon."""
EVEN = 0.05
"""Range of thickness, over its median, that is not worth a word [-]."""
THINNEST, THICKEST = 0.4, 2.5
"""Thickness over its median beyond which a place is no wall of the brace but something on it [-]."""
FLUSH = 0.12
"""How far the brace may stand out of its outer face, over its thickness [-]."""
FLAT = 0.25
"""Thickness over width up to which a brace is a flat coupon [-]."""
_FACING = 0.5
_OPPOSITE = 0.9
_GROUND = 0.1
"""Least share of a coupon's surface that is its ground [-]."""
_GROUND_MM = 0.05
_FEW = 3
"""Places with another thickness than the rest that are no speck."""
_TOUCH_MM = 0.02
_NEAREST = 8
_ROUNDS = 4
_SMOOTHINGS = 30
_LONGEST = 1.6
"""Longest edge of the sheet, in resolutions: halved edges are between this and half of it [-]."""
FOLDED_MM2 = 1.0
"""Folds smaller than this in sum are needles in the limb's mesh."""
_UPRIGHT_MM = 5.0
"""Length at both ends over which the way to the outer face turns across the axis."""
_SECTIONS = 41


@dataclass(frozen=True)
class Laid:
    """A brace laid on its sheet.

    Attributes:
        sheet: Limb or ground with foot and gutter.
        line: Its centreline.
        up: Unit direction up while casting.
        thickness_mm: Median thickness.
        repairs: What was mended.
    """

    sheet: Sheet
    line: Float[Array, "point 3"]
    up: Float[Array, "3"]
    thickness_mm: float
    repairs: tuple[str, ...]


def on_limb(brace: Mesh, limb: Mesh, up: Float[Array, "3"], settings: MoldSettings, where: str) -> Laid:
    """A sleeve on its limb.

    Args:
        brace: The brace [mm].
        limb: A tube through it, outward, about as long [mm].
        up: Unit axis.
        settings: Resolution, foot and gutter.
        where: The brace's file.

    Raises:
        GeometryError: The limb does not lie under the brace, or the brace's thickness is no thickness.
    """
    normals = np.asarray(igl.per_vertex_normals(limb.vertices, limb.triangles))
    points, way, triangles = refined(
        limb.vertices, normals, limb.triangles, _LONGEST * settings.resolution_mm
    )
    way = _smooth(points, way, triangles)
    height = points @ up
    upright = np.clip(1 - np.minimum(height - height.min(), height.max() - height) / _UPRIGHT_MM, 0, 1)
    way = way - (upright * (way @ up))[:, None] * up
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    outer = outer_face(brace, limb)
    reach, repairs = measured(points, way, outer, where)
    _check_unfolded(points, reach[:, None] * way, triangles, where)
    sheet = _bare(points, reach[:, None] * way, triangles)
    loops = tube_ends(Mesh(points, triangles), up)
    for end, loop, length in zip((-1, 1), loops, (settings.foot_mm, settings.gutter_mm), strict=True):
        sheet = prolonged(sheet, np.append(loop, loop[0]), end * up, length, end)
    check_flush(brace, sheet, float(np.median(reach)), where)
    levels = np.linspace(height.min(), height.max(), _SECTIONS + 2)[1:-1]
    line = np.array([section(limb.vertices, limb.triangles, limb.vertices @ up - level) for level in levels])
    return Laid(sheet, line, up, float(np.median(reach)), repairs)


def _smooth(
    points: Float[Array, "vertex 3"], way: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, "vertex 3"]:
    """Normals averaged over their neighbourhood: a limb's mesh may be rough, the outer face must not fold."""
    mean = neighbour_mean(points, triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2))
    for _ in range(_SMOOTHINGS):
        way = way + mean @ way
        way /= np.linalg.norm(way, axis=1, keepdims=True)
    return way


def flat_normal(brace: Mesh) -> Float[Array, "3"] | None:
    """Unit direction in which a flat coupon is thick, away from its ground; ``None`` of what is not flat.

    The ground is the larger of its two plane faces; of two alike, the one across an axis of the file, and the
    lower one.
    """
    p = brace.vertices[brace.triangles]
    area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(area, axis=1)
    unit = area / np.maximum(size, 1e-12)[:, None]
    code, number = np.unique(np.round(unit, 2) + 0.0, axis=0, return_inverse=True)
    weight = np.bincount(number.ravel(), size, minlength=len(code))
    first = int(np.argmax(weight))
    behind = np.flatnonzero(code @ code[first] < -_OPPOSITE)
    sides = [first, *behind[np.argsort(-weight[behind])][:1]]
    best, score = None, (0.0, 0.0, 0.0)
    for side in sides:
        own = number.ravel() == side
        down = area[own].sum(axis=0)
        down /= np.linalg.norm(down)
        level = brace.vertices @ down
        on_plane = np.abs(p @ down - level.max()).max(axis=1) < _GROUND_MM
        share = round(float(size[on_plane].sum() / size.sum()), 1)
        axis = int(np.argmax(np.abs(down)))
        found = (share, round(float(np.abs(down[axis])), 4), -float(np.sign(down[axis])))
        if share >= _GROUND and found > score and _is_thin(brace, down):
            best, score = -down, found
    return best


def _is_thin(brace: Mesh, normal: Float[Array, "3"]) -> bool:
    """Whether a body is much thinner along a direction than wide across it."""
    height = brace.vertices @ normal
    across = brace.vertices - np.outer(height, normal)
    width = (across - across.mean(axis=0)) @ np.linalg.svd(across - across.mean(axis=0), full_matrices=False)[
        2
    ].T
    return bool(np.ptp(height) <= FLAT * np.sort(np.ptp(width, axis=0))[1])


def on_ground(brace: Mesh, normal: Float[Array, "3"], settings: MoldSettings, where: str) -> Laid:
    """A flat coupon on its ground.

    Args:
        brace: The coupon [mm].
        normal: Unit direction in which it is thick.
        settings: Resolution, foot and gutter.
        where: The brace's file.

    Raises:
        GeometryError: The brace's thickness is no thickness.
    """
    up = _long_side(brace, normal)
    right = np.cross(up, normal)
    x, y, z = (brace.vertices @ axis for axis in (right, up, normal))
    step = 2 * settings.resolution_mm
    columns = np.concatenate(
        [
            np.linspace(x.min() - MARGIN_MM, x.min(), 5)[:-1],
            np.linspace(x.min(), x.max(), 1 + int(np.ceil(np.ptp(x) / step))),
            np.linspace(x.max(), x.max() + MARGIN_MM, 5)[1:],
        ]
    )
    rows = np.linspace(y.min(), y.max() - OPEN_MM, 1 + int(np.ceil(np.ptp(y) / step)))
    grid = np.stack(np.meshgrid(columns, rows, indexing="ij"), axis=-1).reshape(-1, 2)
    points = grid @ np.stack([right, up]) + z.min() * normal
    count = len(rows)
    i, j = np.meshgrid(np.arange(len(columns) - 1), np.arange(count - 1), indexing="ij")
    a = i * count + j
    triangles = np.stack(
        [np.stack([a, a + count, a + count + 1], -1), np.stack([a, a + count + 1, a + 1], -1)], axis=2
    ).reshape(-1, 3)
    way = np.broadcast_to(normal, points.shape)
    outer = outer_face(brace, Mesh(points, triangles))
    reach, repairs = measured(points, way, outer, where)
    sheet = _bare(points, reach[:, None] * way, triangles)
    rim = rim_of(triangles)
    first, last = 0, (len(columns) - 1) * count
    sheet = prolonged(sheet, rim.walk(first, last), -up, settings.foot_mm, -1)
    inside = (columns[:-1] >= x.min() - 1e-9) & (columns[1:] <= x.max() + 1e-9)
    line = rim.walk(last + count - 1, first + count - 1)
    sheet = prolonged(sheet, line, up, settings.gutter_mm, np.where(inside[::-1], 1, 2))
    check_flush(brace, sheet, float(np.median(reach)), where)
    middle = (x.min() + x.max()) / 2 * right + z.min() * normal
    ends = np.array([y.min(), y.max()])[:, None] * up + middle
    return Laid(sheet, ends, up, float(np.median(reach)), repairs)


def _long_side(brace: Mesh, normal: Float[Array, "3"]) -> Float[Array, "3"]:
    """Unit direction of the longer side of the smallest rectangle around a coupon."""
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)])
    flat = brace.vertices @ axes.T
    corners = flat[ConvexHull(flat).vertices]
    sides = np.roll(corners, -1, axis=0) - corners
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    along, across = (np.ptp(corners @ turned.T, axis=0) for turned in (sides, sides[:, ::-1] * [-1, 1]))
    best = int(np.argmin(np.round(along * across, 6)))
    side = sides[best] if along[best] >= across[best] else sides[best, ::-1] * [-1, 1]
    up = side @ axes
    return up * np.sign(up[np.argmax(np.abs(up))])


def outer_face(brace: Mesh, limb: Mesh) -> Mesh:
    """Triangles of a brace that look away from what it lies on."""
    p = brace.vertices[brace.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(normal, axis=1)
    near = np.asarray(igl.point_mesh_squared_distance(p.mean(axis=1), limb.vertices, limb.triangles)[1])
    q = limb.vertices[limb.triangles[near]]
    out = np.cross(q[:, 1] - q[:, 0], q[:, 2] - q[:, 0])
    facing = np.einsum("tx,tx->t", normal, out) / np.maximum(size * np.linalg.norm(out, axis=1), 1e-12)
    return Mesh(brace.vertices, brace.triangles[(facing > _FACING) & (size > 0)])


def measured(
    points: Float[Array, "vertex 3"], way: Float[Array, "vertex 3"], outer: Mesh, where: str
) -> tuple[Float[Array, " vertex"], tuple[str, ...]]:
    """How far the outer face is from points along given ways, and what is to be said about it.

    Points under windows take the mean of the nearest ones that are not.

    Args:
        points: Points of limb or ground [mm].
        way: Unit directions outward.
        outer: The brace's outer face [mm].
        where: The brace's file.

    Raises:
        GeometryError: Nothing lies over the points, or the brace is far from even.
    """
    reach, covered = (
        _along(points, way, outer) if len(outer.triangles) else (points[:, 0], points[:, 0] > np.inf)
    )
    if covered.mean() < 0.02:
        raise GeometryError(
            "the brace does not lie on its limb: no part of it is found over the limb's surface",
            where=where,
            hint="give both in one unit and place",
        )
    known = reach[covered]
    middle = float(np.median(known))
    ordered = np.sort(known)
    low, high = ordered[min(_FEW, len(known)) - 1], ordered[-min(_FEW, len(known))]
    if low < THINNEST * middle or high > THICKEST * middle:
        raise GeometryError(
            f"the thickness of the brace is not even: {low:.1f} to {high:.1f} mm where most of it has "
            f"{middle:.1f} mm",
            where=where,
            hint="give the limb that it lies on, or even it out",
        )
    away, near = KDTree(points[covered]).query(points[~covered], k=min(_NEAREST, int(covered.sum())))
    weight = 1.0 / np.reshape(away, (len(away), -1)) ** 2
    values = known[np.reshape(near, (len(away), -1))]
    out = reach.copy()
    out[~covered] = (weight * values).sum(axis=1) / weight.sum(axis=1)
    low, high = np.percentile(known, [0.5, 99.5])
    if high - low <= EVEN * middle:
        return out, ()
    said = f"the brace is {low:.2f} to {high:.2f} mm thick; the shells follow its outer face"
    return out, (said,)


def _along(
    points: Float[Array, "vertex 3"], way: Float[Array, "vertex 3"], outer: Mesh
) -> tuple[Float[Array, " vertex"], Bool[Array, " vertex"]]:
    """Distances to a surface along ways, by steps to the nearest triangle's plane, and where they hit."""
    reach = np.zeros(len(points))
    if not len(outer.triangles):
        return reach, reach > 0
    corners = outer.vertices[outer.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    squared, _, foot = igl.point_mesh_squared_distance(points, outer.vertices, outer.triangles)
    reach = np.full(len(points), float(np.median(np.sqrt(squared))))
    for _ in range(_ROUNDS):
        goal = points + reach[:, None] * way
        squared, face, foot = igl.point_mesh_squared_distance(goal, outer.vertices, outer.triangles)
        own = normal[np.asarray(face)]
        slope = np.maximum(np.einsum("vx,vx->v", way, own), 0.2)
        reach = reach + np.einsum("vx,vx->v", np.asarray(foot) - goal, own) / slope
    return reach, np.sqrt(np.asarray(squared)) < _TOUCH_MM


def check_flush(brace: Mesh, sheet: Sheet, thickness_mm: float, where: str) -> None:
    """Refuse a brace that stands out of the outer face: the shells would cut off what does.

    Raises:
        GeometryError: With the place that stands out most.
    """
    _, near, foot = igl.point_mesh_squared_distance(brace.vertices, sheet.outer, sheet.triangles)
    p = sheet.outer[sheet.triangles[np.asarray(near)]]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out = np.einsum("vx,vx->v", brace.vertices - np.asarray(foot), normal)
    out[sheet.beyond[np.asarray(near)] != 0] = 0.0
    if out.max() > FLUSH * thickness_mm:
        place = ", ".join(f"{x:.0f}" for x in brace.vertices[np.argmax(out)])
        raise GeometryError(
            f"the thickness of the brace is not even: it stands {out.max():.1f} mm out of its outer face "
            f"near ({place})",
            where=where,
            hint="take off what stands out (buckles, studs, letters) and glue it on after casting",
        )


def _check_unfolded(
    points: Float[Array, "vertex 3"],
    vector: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    where: str,
) -> None:
    folded = area_ratio(points, triangles, vector) <= 0
    p = points[triangles[folded]]
    size = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    if size.sum() > FOLDED_MM2:
        place = ", ".join(f"{x:.0f}" for x in p[np.argmax(size)].mean(axis=0))
        raise GeometryError(
            f"the shells' inner face folds over the limb: {len(size)} triangles, the largest near ({place})",
            where=where,
            hint="smooth the limb where it bends inwards more sharply than the brace is thick",
        )


def _bare(
    points: Float[Array, "vertex 3"], vector: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Sheet:
    none = np.zeros(len(triangles), dtype=np.int64)
    return Sheet(points, vector, triangles, none > 0, none)
