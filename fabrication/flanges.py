"""Places on the flanges for what holds the shells together, aligns them and pries them apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from contourpy import LineType, contour_generator
from jaxtyping import Float
from manifold3d import CrossSection, FillRule
from scipy.ndimage import map_coordinates
from scipy.spatial import KDTree

from fabrication.bodies import mesh_of
from fabrication.ends import border_loops, inside
from fabrication.fixtures.place import Place
from fabrication.mold import Casting
from fabrication.offsets import Surroundings, surroundings
from fabrication.parting import Parting
from fabrication.seams import Seam
from fabrication.shells import flange_thickness
from hilbrace.config.mold import MoldSettings

Array = np.ndarray

FROM_END_MM = 9.0
"""Bolts stay this far from the ends of the shells: room for washer and nut [mm]."""

SHORTEST_MM = 25.0
"""Flanges shorter than this between those margins get one bolt [mm]."""

BOLT_ROOM_MM, KEY_ROOM_MM = 16.0, 10.0
"""Bolts stand this far from each other, where two stretches of a flange meet; keys and slots from bolts and
from each other [mm]."""

STEP_MM = 1.0
"""Spacing of the points on the line along the middle of a flange [mm]."""

SPACING_MM = 2.5
"""Spacing of the points that stand for the limb [mm]."""

LID_INSET_MM = 5.0
"""How far inside the border of a lid its keys lie [mm]."""

CAVITY_CLEAR_MM = 4.5
"""How far the keys of a lid stay from what is cast: their radius and a wall [mm]."""


@dataclass(frozen=True)
class FlangePlaces:
    """Places on the faces where shells meet.

    Attributes:
        bolts: In the middle of the flanges, the largest distance between two along a flange as configured.
        keys: Between bolts, likewise.
        jacks: On the free edges of the flanges.
        clamps: Where a lid, which has no flanges, is clamped to the core.
    """

    bolts: tuple[Place, ...]
    keys: tuple[Place, ...]
    jacks: tuple[Place, ...]
    clamps: tuple[Place, ...] = ()


def flange_places(casting: Casting, parting: Parting, settings: MoldSettings) -> FlangePlaces:
    """Choose places for bolts, keys and jack slots along the flanges.

    Along each flange bolts stand evenly, from one end to the other. Between them there are keys and jack
    slots by turns, so that a cut for the printer's bed finds room between a bolt and its neighbour.

    Args:
        casting: What shall be cast.
        parting: How the mold parts.
        settings: Section ``mold``: wall, flanges and the distance between bolts.
    """
    if casting.flat:
        return _lid_places(casting, parting, settings)
    around = surroundings(parting.land, SPACING_MM)
    bolts, keys, jacks = [], [], []
    for seam in parting.seams:
        chart = _Chart.of(seam, around, parting, flange_thickness(settings))
        middle = chart.lines(settings.wall_mm + 0.5 * settings.flange_mm, FROM_END_MM)
        edge = chart.lines(settings.wall_mm + settings.flange_mm, 0.0)
        for line in middle:
            bolted, between = _spread(_length(line), settings.bolt_spacing_mm)
            bolts += [chart.place(_at(line, way)) for way in bolted]
            keys += [chart.place(_at(line, way)) for way in between[::2]]
            if edge:
                jacks += [chart.place(_nearest(edge, chart, _at(line, way))) for way in between[1::2]]
    bolts = _apart(bolts, (), BOLT_ROOM_MM)
    keys = _apart(keys, bolts, KEY_ROOM_MM)
    return FlangePlaces(bolts, keys, _apart(jacks, (*bolts, *keys), KEY_ROOM_MM))


@dataclass(frozen=True)
class _Chart:
    """A seam with what is known at each place of its grid."""

    seam: Seam
    parting: Parting
    distance: Float[Array, "row column"]
    normals: Float[Array, "row column 3"]
    thickness: float

    @classmethod
    def of(cls, seam: Seam, around: Surroundings, parting: Parting, thickness_mm: float) -> _Chart:
        distance = around.distance(seam.points.reshape(-1, 3)).reshape(seam.points.shape[:2])
        return cls(seam, parting, distance, seam.normals(), thickness_mm)

    def lines(self, level_mm: float, margin_mm: float) -> list[Float[Array, "point 2"]]:
        """Lines at a distance from the limb, inside the ends, in rows and columns of the grid."""
        found = contour_generator(z=self.distance, line_type=LineType.Separate).lines(level_mm)
        runs = []
        for line in found:
            line = _resampled(np.asarray(line)[:, ::-1], self.points(np.asarray(line)[:, ::-1]))
            kept = inside(self.parting.ends, self.points(line), margin_mm)
            for run in _runs(kept):
                runs.append(line[run])
        return [run for run in runs if len(run) > 2]

    def points(self, at: Float[Array, "point 2"]) -> Float[Array, "point 3"]:
        """Points of the sheet at places of its grid [mm]."""
        return _interpolated(self.seam.points, at)

    def place(self, at: Float[Array, "2"]) -> Place:
        """A place on the flange."""
        direction = _interpolated(self.normals, at[None])[0]
        direction /= np.linalg.norm(direction)
        names, pulls = self.parting.names, self.parting.pulls
        first, second = self.seam.first, self.seam.second
        slant = max(_angle_deg(direction, pulls[first]), _angle_deg(direction, pulls[second]))
        return Place(
            point=self.points(at[None])[0],
            direction=direction,
            outward=self._outward(at, direction),
            pieces=(names[first], names[second]),
            thickness=self.thickness,
            slant_deg=slant,
        )

    def _outward(self, at: Float[Array, "2"], direction: Float[Array, "3"]) -> Float[Array, "3"]:
        """Direction in the sheet in which the distance from the limb grows fastest."""
        steps = 0.5 * np.eye(2)
        rise, ways = np.zeros(2), np.zeros((2, 3))
        for i, step in enumerate(steps):
            pair = np.stack([at - step, at + step])
            low, high = _interpolated(self.distance[..., None], pair)[:, 0]
            before, after = self.points(pair)
            rise[i], ways[i] = high - low, after - before
        outward = np.linalg.lstsq(ways, rise, rcond=None)[0]
        outward -= (outward @ direction) * direction
        return outward / np.linalg.norm(outward)


def _apart(places: list[Place], taken: tuple[Place, ...], room_mm: float) -> tuple[Place, ...]:
    """Places that keep a distance from those taken and from each other, the first of two kept."""
    kept: list[Place] = []
    for place in places:
        others = (*taken, *kept)
        if all(np.linalg.norm(place.point - other.point) >= room_mm for other in others):
            kept.append(place)
    return tuple(kept)


def _spread(length_mm: float, spacing_mm: float) -> tuple[list[float], list[float]]:
    """Ways along a flange at which bolts stand, and at which something stands between them [mm]."""
    if length_mm < SHORTEST_MM:
        return [0.5 * length_mm], []
    gaps = int(np.ceil(length_mm / spacing_mm))
    bolts = np.linspace(0.0, length_mm, gaps + 1)
    if gaps == 1 and length_mm > 1.5 * SHORTEST_MM:
        return bolts.tolist(), [0.36 * length_mm, 0.68 * length_mm]
    return bolts.tolist(), (0.5 * (bolts[1:] + bolts[:-1])).tolist()


def _resampled(line: Float[Array, "point 2"], points: Float[Array, "point xyz"]) -> Float[Array, "even 2"]:
    """A line of the grid with points at even distances in space."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    even = np.linspace(0.0, way[-1], max(int(np.ceil(way[-1] / STEP_MM)), 1) + 1)
    return np.stack([np.interp(even, way, line[:, i]) for i in (0, 1)], axis=1)


def _runs(kept: Array) -> list[slice]:
    """Stretches of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    return [slice(start, stop) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def _length(line: Float[Array, "point 2"]) -> float:
    return STEP_MM * (len(line) - 1)


def _at(line: Float[Array, "point 2"], way_mm: float) -> Float[Array, "2"]:
    index = np.arange(len(line)) * STEP_MM
    return np.array([np.interp(way_mm, index, line[:, i]) for i in (0, 1)])


def _nearest(edges: list[Array], chart: _Chart, at: Float[Array, "2"]) -> Float[Array, "2"]:
    """Place on the flange's free edge nearest to a place in its middle."""
    every = np.concatenate(edges)
    return every[KDTree(chart.points(every)).query(chart.points(at[None])[0])[1]]


def _interpolated(values: Float[Array, "row column part"], at: Float[Array, "point 2"]) -> Array:
    parts = [map_coordinates(values[..., i], at.T, order=1, mode="nearest") for i in range(values.shape[-1])]
    return np.stack(parts, axis=-1)


def _angle_deg(direction: Float[Array, "3"], pull: Float[Array, "3"]) -> float:
    """Angle between a line and a pull [deg]."""
    return float(np.degrees(np.arccos(np.clip(abs(direction @ pull), 0.0, 1.0))))


def _lid_places(casting: Casting, parting: Parting, settings: MoldSettings) -> FlangePlaces:
    """Keys and jack slots along the border of a lid, clear of what is cast; clamps over them."""
    pull = parting.pulls[0]
    side = np.linalg.svd(np.outer(pull, pull))[0][:, 1]
    axes = np.stack([side, np.cross(pull, side)])
    outer = casting.outer
    level = float((outer @ pull).mean())
    loops = [outer[loop] @ axes.T for loop in border_loops(casting.triangles)]
    whole = CrossSection([loop.tolist() for loop in loops], FillRule.EvenOdd)
    line = max((np.asarray(p) for p in whole.offset(-LID_INSET_MM).to_polygons()), key=len)
    edge = KDTree(np.concatenate(loops))
    cast = mesh_of(casting.brace)[0]
    filled = outer[np.unique(casting.triangles[casting.beyond == 1])]
    clear = KDTree(np.concatenate([cast, filled]) @ axes.T)
    line = _resampled(np.concatenate([line, line[:1]]), np.concatenate([line, line[:1]]))
    free = clear.query(line)[0] > CAVITY_CLEAR_MM
    keys, jacks = [], []
    for run in _runs(free):
        stretch = line[run]
        if _length(stretch) < SHORTEST_MM:
            continue
        bolts, between = _spread(_length(stretch) - 10.0, settings.bolt_spacing_mm)
        for way, kind in [*((5.0 + way, keys) for way in bolts), *((5.0 + way, jacks) for way in between)]:
            at = _at(stretch, way)
            border = edge.data[edge.query(at)[1]]
            outward = (border - at) @ axes / max(float(np.linalg.norm(border - at)), 1e-9)
            where = at if kind is keys else border
            point = where @ axes + level * pull
            kind.append(Place(point, pull, outward, ("core", parting.names[0]), settings.wall_mm))
    return FlangePlaces((), tuple(keys), tuple(jacks), tuple(keys))
