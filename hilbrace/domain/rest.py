"""The sleeve at rest: cut out of the skin, meshed, opened along its seam and flattened."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from hilbrace.body.body import Body
from hilbrace.config import DomainSettings
from hilbrace.domain.edges import find_edges
from hilbrace.domain.fitting import Fit, compress, find_reliefs, relieve
from hilbrace.domain.flatten import FlatMap, flatten, mirrored
from hilbrace.domain.limb import Limb, Surface, find_limb, limb_skin, skin_order
from hilbrace.domain.loops import Loops, loops_of
from hilbrace.domain.paint import read_paint
from hilbrace.domain.region import cut_painted, cut_region
from hilbrace.domain.remesh import edge_for, remesh, surface_area
from hilbrace.domain.seam import Cut, cut_along, find_seam
from hilbrace.domain.windows import find_windows, open_windows
from hilbrace.errors import ConfigError

Array = np.ndarray


_FINER = 0.5
"""Edges that the region is cut with, of those that it is meshed with: coarse skin changes its girth by up to
0.3 % in the first round of subdivision, and by less than 0.1 % from the second on [-]."""

_EDGES = ("above", "below", "upper_edge", "lower_edge")

SEAM_AZIMUTH_DEG = {"knee": 180.0, "ankle": 0.0}
"""Where the seam runs if nothing else is asked for: hidden behind the knee, and clear of the open heel."""


@dataclass(frozen=True)
class RestDomain:
    """The sleeve at rest, in the brace's rest frame [mm]; fields as in `Domain`."""

    joint: str
    surface: Surface
    worn: Float[Array, "vertex 3"]
    loops: Loops
    cut: Cut
    flat: FlatMap


def rest_domain(body: Body, settings: DomainSettings) -> RestDomain:
    """The sleeve at rest: region, mesh, seam and flat map, without any motion.

    Raises:
        ConfigError: The settings name what the joint does not have.
        GeometryError: The region is no sleeve, or cannot be meshed or flattened.
    """
    limb = find_limb(body, settings.joint, settings.side)
    fit = mesh_sleeve(body, limb, settings)
    surface = fit.rest
    loops = loops_of(surface, limb)
    azimuth = settings.seam_azimuth_deg
    azimuth = SEAM_AZIMUTH_DEG[limb.name] if azimuth is None else azimuth
    path = find_seam(surface, limb, loops, azimuth)
    cut = cut_along(surface, path)
    flat = flatten(surface.vertices, cut, _pins(surface, limb, loops, cut, azimuth), settings.flatten)
    loops = _rightwards(loops, surface)
    upper, lower = _from_seam(loops.upper, int(path[-1])), _from_seam(loops.lower, int(path[0]))
    loops = Loops(upper, lower, loops.windows)
    return _back(RestDomain(limb.joint, surface, fit.worn, loops, cut, flat), limb)


def mesh_sleeve(body: Body, limb: Limb, settings: DomainSettings) -> Fit:
    """The braced region with even triangles, at rest and as it is worn, in limb axes [mm].

    Raises:
        ConfigError: The settings name what the joint does not have, or the same thing twice.
        InputError: Paint cannot be read.
        GeometryError: The region is no sleeve, or cannot be shaped or meshed as wanted.
    """
    skin, order = limb_skin(body, limb), skin_order(body, limb)
    region = _region(skin, limb, order, settings)
    region = relieve(region, find_reliefs(region, skin, limb, order, settings.reliefs))
    fit = compress(region, loops_of(region, limb), settings.compression_percent)
    opened = open_windows(region, limb, find_windows(skin, limb, region, settings.windows))
    if settings.compression_percent == 0.0:
        mesh = remesh(opened, settings.triangles)
        return Fit(mesh, mesh.vertices)
    mesh = remesh(Surface(fit.to_rest(opened.vertices), opened.triangles), settings.triangles)
    return Fit(mesh, fit.to_worn(mesh.vertices))


def _region(skin: Surface, limb: Limb, order: Int[Array, " vertex"], settings: DomainSettings) -> Surface:
    """The part of the skin that the settings ask for, more finely meshed than it will be."""
    if settings.painted is None:
        edges = find_edges(skin, limb, settings)
        rough = cut_region(skin, limb, edges, np.inf)
        return cut_region(skin, limb, edges, _FINER * edge_for(surface_area(rough), settings.triangles))
    given = [key for key in _EDGES if getattr(settings, key) is not None]
    if given:
        raise ConfigError(
            f"both domain.painted and domain.{given[0]} say where the brace ends",
            where="domain.painted",
            hint="leave one of them out",
        )
    painted = read_paint(settings.painted, len(order), "domain.painted")[order]
    rough = cut_painted(skin, limb, painted, np.inf)
    return cut_painted(skin, limb, painted, _FINER * edge_for(surface_area(rough), settings.triangles))


def _pins(surface: Surface, limb: Limb, loops: Loops, cut: Cut, azimuth_deg: float) -> tuple[int, int]:
    """Cut vertices on the lower and upper loop that lie opposite the seam."""
    turn = limb.azimuth(surface.vertices) - np.radians(azimuth_deg)
    opposite = np.cos(turn)
    vertices = [int(loop[np.argmin(opposite[loop])]) for loop in (loops.lower, loops.upper)]
    first, second = (int(np.argmax(cut.weld == vertex)) for vertex in vertices)
    return first, second


def _from_seam(loop: Int[Array, " corner"], first: int) -> Int[Array, " corner"]:
    return np.roll(loop, -int(np.argmax(loop == first)))


def _rightwards(loops: Loops, surface: Surface) -> Loops:
    """Loops that run the way that u grows: to the right, seen from outside with the proximal end up.

    Along the edges of its triangles, the sleeve lies to the left of each loop: above its lower edge, below
    its upper one. Windows run as the lower edge does.
    """
    step = np.stack([surface.triangles, np.roll(surface.triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    along = {tuple(pair) for pair in step.tolist()}

    def turned(loop: Int[Array, " corner"], forward: bool) -> Int[Array, " corner"]:
        follows = (int(loop[0]), int(loop[1])) in along
        return loop if follows == forward else loop[::-1]

    windows = tuple(turned(window, True) for window in loops.windows)
    return Loops(turned(loops.upper, False), turned(loops.lower, True), windows)


def _back(rest: RestDomain, limb: Limb) -> RestDomain:
    """A sleeve from limb axes into the rest frame; a left one is mirrored with everything on it."""
    surface = Surface(limb.rest_frame(rest.surface.vertices), limb.winding(rest.surface.triangles))
    worn = limb.rest_frame(rest.worn)
    if limb.side == "right":
        return replace(rest, surface=surface, worn=worn)
    cut = Cut(limb.winding(rest.cut.triangles), rest.cut.weld, np.ascontiguousarray(rest.cut.pairs[:, ::-1]))
    upper, lower, *windows = (
        np.roll(loop[::-1], 1) for loop in (rest.loops.upper, rest.loops.lower, *rest.loops.windows)
    )
    return RestDomain(
        rest.joint, surface, worn, Loops(upper, lower, tuple(windows)), cut, mirrored(rest.flat)
    )
