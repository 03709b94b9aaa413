"""The border between struts and holes as line segments: nearest points, and the width of what it bounds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from hilbrace.pattern.clip import ZeroLine
from hilbrace.pattern.refine import RefinedSkin
from hilbrace.pattern.zone import EVERYWHERE, Zone

Array = np.ndarray

_NEIGHBOURS = 64
_NEAR_FACING = 0.6
_FACING = 0.9
"""Cosine of the angle to both normals up to which two places of the border face each other."""


@dataclass(frozen=True)
class Border:
    """Every line that bounds the struts: around the holes, and the brace's own edges.

    Attributes:
        start: Beginnings of the segments [mm].
        end: Ends; the solid lies on the left seen from outside [mm].
        inward: Unit normals in the skin, from the middle of the segment into the solid [-].
        hole: Hole that each segment bounds; numbers from ``holes`` on stand for the outside of the brace.
        holes: How many holes the pattern has.
    """

    start: Float[Array, "segment 3"]
    end: Float[Array, "segment 3"]
    inward: Float[Array, "segment 3"]
    hole: Int[Array, " segment"]
    holes: int

    @cached_property
    def middle(self) -> Float[Array, "segment 3"]:
        """Middles of the segments [mm]."""
        return (self.start + self.end) / 2

    @property
    def outside(self) -> Bool[Array, " segment"]:
        """Segments on the brace's own edges."""
        return self.hole >= self.holes

    @cached_property
    def tree(self) -> KDTree:
        """Search tree of the middles."""
        return KDTree(self.middle)

    def nearest(
        self, points: Float[Array, "point 3"]
    ) -> tuple[Float[Array, " point"], Int[Array, " point"], Float[Array, "point 3"]]:
        """Nearest place on the border.

        Returns:
            Distances [mm], segments, and the places themselves [mm].
        """
        count = min(4, len(self.start))
        near = np.asarray(self.tree.query(points, k=count, workers=-1)[1]).reshape(len(points), count)
        foot = _foot(points[:, None], self.start[near], self.end[near])
        distance = np.linalg.norm(points[:, None] - foot, axis=2)
        best = distance.argmin(axis=1)
        rows = np.arange(len(points))
        return distance[rows, best], near[rows, best], foot[rows, best]


def hole_numbers(skin: RefinedSkin, line: ZeroLine) -> Int[Array, " vertex"]:
    """Number of the hole that each vertex lies in, -1 in the solid."""
    empty = line.depth < 0
    within = skin.edges[empty[skin.edges].all(axis=1)]
    count = len(skin.vertices)
    graph = coo_array((np.ones(len(within), dtype=bool), within.T), shape=(count, count))
    _, component = connected_components(graph, directed=False)
    number = np.full(count, -1)
    number[empty] = np.unique(component[empty], return_inverse=True)[1]
    return number


def border(skin: RefinedSkin, line: ZeroLine, hole: Int[Array, " vertex"]) -> Border:
    """Collect the border of a zero line and of the loops.

    Args:
        skin: The refined skin.
        line: Its zero line.
        hole: Hole of each vertex, from `hole_numbers`.
    """
    ends = line.points[line.segments]
    loops = skin.vertices[skin.loop_edges]
    holes = int(hole.max(initial=-1)) + 1
    face = np.concatenate(
        [skin.normals[skin.triangles[line.triangle, 0]], skin.normals[skin.loop_edges[:, 0]]]
    )
    start = np.concatenate([ends[:, 0], loops[:, 0]])
    end = np.concatenate([ends[:, 1], loops[:, 1]])
    inward = np.cross(face, end - start)
    length = np.linalg.norm(inward, axis=1)
    keep = length > 1e-9
    return Border(
        start=start[keep],
        end=end[keep],
        inward=inward[keep] / length[keep, None],
        hole=np.concatenate([hole[line.outer[line.segments[:, 0]]], holes + skin.loop])[keep],
        holes=holes,
    )


def strut_widths(edge: Border, reach_mm: float, zone: Zone = EVERYWHERE) -> Float[Array, " segment"]:
    """Width of the strut at each segment of the border [mm]: to the nearest place that faces it.

    Args:
        edge: The border.
        reach_mm: Widths are looked for up to this one; wider places are given it.
        zone: Where widths are wanted; elsewhere they are given ``reach_mm`` too.
    """
    return _facing_distance(edge, edge.inward, reach_mm, zone)


def slit_widths(edge: Border, reach_mm: float, zone: Zone = EVERYWHERE) -> Float[Array, " segment"]:
    """Width of the hole at each segment of the border [mm], as `strut_widths` on the other side."""
    width = _facing_distance(edge, -edge.inward, reach_mm, zone)
    return np.where(edge.outside, reach_mm, width)


def _facing_distance(edge: Border, normal: Float[Array, "segment 3"], reach_mm: float, zone: Zone) -> Array:
    asked = np.flatnonzero(zone.holds(edge.middle))
    width = np.full(len(edge.middle), reach_mm)
    if not len(asked):
        return width
    count = min(_NEIGHBOURS, len(edge.middle))
    _, near = edge.tree.query(edge.middle[asked], k=count, distance_upper_bound=reach_mm, workers=-1)
    place, column = np.nonzero(near < len(width))
    place, other = asked[place], np.asarray(near)[place, column]
    away = edge.middle[other] - edge.middle[place]
    ahead = np.einsum("px,px->p", away, normal[place])
    likely = ahead > _NEAR_FACING * np.sqrt(np.einsum("px,px->p", away, away))
    place, other = place[likely], other[likely]
    away = _foot(edge.middle[place], edge.start[other], edge.end[other]) - edge.middle[place]
    distance = np.linalg.norm(away, axis=1)
    facing = np.einsum("px,px->p", away, normal[place]) > _FACING * distance
    facing &= np.einsum("px,px->p", away, normal[other]) < -_FACING * distance
    facing &= distance > 0
    np.minimum.at(width, place[facing], distance[facing])
    return width


def _foot(point: Array, start: Array, end: Array) -> Array:
    along = end - start
    ahead = np.einsum("...x,...x->...", point - start, along)
    t = ahead / np.maximum(np.einsum("...x,...x->...", along, along), 1e-30)
    return start + np.clip(t, 0, 1)[..., None] * along
