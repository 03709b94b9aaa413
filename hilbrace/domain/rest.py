"""The sleeve at rest: cut out of the skin, meshed, opened along its seam and flattened."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from hilbrace.body.body import Body
from hilbrace.config import DomainSettings
from hilbrace.domain.flatten import FlatMap, flatten, mirrored
from hilbrace.domain.limb import Limb, Surface, find_limb, limb_skin
from hilbrace.domain.region import cut_region, loops_of
from hilbrace.domain.remesh import edge_for, remesh, surface_area
from hilbrace.domain.seam import Cut, cut_along, find_seam

Array = np.ndarray


@dataclass(frozen=True)
class RestDomain:
    """The sleeve at rest, in the brace's rest frame [mm]; fields as in `Domain`."""

    joint: str
    surface: Surface
    upper_loop: Int[Array, " upper"]
    lower_loop: Int[Array, " lower"]
    cut: Cut
    flat: FlatMap


def rest_domain(body: Body, settings: DomainSettings) -> RestDomain:
    """The sleeve at rest: region, mesh, seam and flat map, without any motion.

    Raises:
        GeometryError: The region is no sleeve, or cannot be meshed or flattened.
    """
    limb = find_limb(body, settings.side)
    surface = mesh_sleeve(limb_skin(body, limb), limb, settings)
    upper, lower = loops_of(surface)
    path = find_seam(surface, limb, upper, lower, settings.seam_azimuth_deg)
    cut = cut_along(surface, path)
    pins = _pins(surface, limb, upper, lower, cut, settings)
    flat = flatten(surface.vertices, cut, pins, settings.flatten)
    upper, lower = _in_order(upper, int(path[-1]), surface), _in_order(lower, int(path[0]), surface)
    return _back(RestDomain(limb.joint, surface, upper, lower, cut, flat), limb)


def mesh_sleeve(skin: Surface, limb: Limb, settings: DomainSettings) -> Surface:
    """The braced region with even triangles, in limb axes [mm].

    Raises:
        GeometryError: The region is no sleeve, or cannot be meshed as wanted.
    """
    rough = cut_region(skin, limb, settings.above, settings.below, np.inf)
    edge = edge_for(surface_area(rough), settings.triangles)
    region = cut_region(skin, limb, settings.above, settings.below, edge)
    return remesh(region, settings.triangles)


def _pins(
    surface: Surface,
    limb: Limb,
    upper: Int[Array, " upper"],
    lower: Int[Array, " lower"],
    cut: Cut,
    settings: DomainSettings,
) -> tuple[int, int]:
    """Cut vertices on the lower and upper loop that lie opposite the seam."""
    turn = limb.azimuth(surface.vertices) - np.radians(settings.seam_azimuth_deg)
    opposite = np.cos(turn)
    vertices = [int(loop[np.argmin(opposite[loop])]) for loop in (lower, upper)]
    first, second = (int(np.argmax(cut.weld == vertex)) for vertex in vertices)
    return first, second


def _in_order(loop: Int[Array, " corner"], first: int, surface: Surface) -> Int[Array, " corner"]:
    """A loop that starts at the seam and runs the way that u grows, against the azimuth of a right leg."""
    place = int(np.argmax(loop == first))
    turned = np.roll(loop, -place)
    x, _, z = surface.vertices[turned].T
    area = float((x * np.roll(z, -1) - np.roll(x, -1) * z).sum())
    return turned if area < 0.0 else np.roll(turned[::-1], 1)


def _back(rest: RestDomain, limb: Limb) -> RestDomain:
    """A sleeve from limb axes into the rest frame; a left one is mirrored with everything on it."""
    surface = Surface(limb.rest_frame(rest.surface.vertices), limb.winding(rest.surface.triangles))
    if limb.side == "right":
        return RestDomain(rest.joint, surface, rest.upper_loop, rest.lower_loop, rest.cut, rest.flat)
    cut = Cut(limb.winding(rest.cut.triangles), rest.cut.weld, np.ascontiguousarray(rest.cut.pairs[:, ::-1]))
    upper, lower = (np.roll(loop[::-1], 1) for loop in (rest.upper_loop, rest.lower_loop))
    return RestDomain(rest.joint, surface, upper, lower, cut, mirrored(rest.flat))
