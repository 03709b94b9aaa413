"""The braced part of the skin: an annulus between two edges around the limb, with windows inside."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.domain.isoline import compact, cut_by_levels, cut_by_plane, mesh_edges
from hilbrace.domain.landmarks import leaves_skin
from hilbrace.domain.limb import Limb, Surface
from hilbrace.domain.windows import Window
from hilbrace.errors import GeometryError

Array = np.ndarray

_SNAP = 0.1
"""Vertices nearer to a cutting plane than this share of an edge move onto it [-]."""

_SNAP_WINDOW = 0.2
"""The same along the edges of a window [-]."""

_ROUND = {"knee": 1.8, "ankle": 2.3}
"""Cross-sections that a brace ends at are less elongated than this; those of the foot or toes more [-]."""

_MARGIN = 3.0
"""Skin kept beyond the planes while the mesh is refined, in edge lengths [-]."""

PRESETS = {"knee": (0.40, 0.38), "ankle": (0.42, 0.42)}
"""Upper and lower edge where none are asked for: fractions of the segments above and below the joint [-]."""


@dataclass(frozen=True)
class Edge:
    """A plane that the sleeve ends at.

    Attributes:
        key: Configuration key that asks for it.
        normal: Unit normal, away from the joint, in limb axes [-].
        offset: Distance of the plane from the joint along the normal [mm].
        beyond: What lies beyond, for messages.
    """

    key: str
    normal: Float[Array, " xyz"]
    offset: float
    beyond: str


@dataclass(frozen=True)
class Loops:
    """The open edges of a sleeve, each in order around.

    Attributes:
        upper: Vertices of the proximal edge.
        lower: Vertices of the distal edge.
        windows: Vertices of the edge of each window.
    """

    upper: Int[Array, " upper"]
    lower: Int[Array, " lower"]
    windows: tuple[Int[Array, " window"], ...]


def edges_at(limb: Limb, above: float | None, below: float | None) -> tuple[Edge, Edge]:
    """Edges across both segments at fractions of their lengths, the joint's preset where None.

    Args:
        limb: Axes of the limb.
        above: Upper edge, fraction of the segment above the joint [-].
        below: Lower edge, fraction of the segment below the joint [-].
    """
    high, low = (
        preset if wanted is None else wanted
        for preset, wanted in zip(PRESETS[limb.name], (above, below), strict=True)
    )
    over, under = {"knee": ("crotch", "foot"), "ankle": ("knee", "toes")}[limb.name]
    return (
        Edge("domain.above", limb.proximal, high * float(limb.upper @ limb.proximal), over),
        Edge("domain.below", limb.distal, low * float(limb.lower @ limb.distal), under),
    )


def cut_region(
    skin: Surface, limb: Limb, edges: tuple[Edge, Edge], windows: tuple[Window, ...], edge_mm: float
) -> Surface:
    """Cut the braced region out of the skin of a whole body.

    Coarse skin is first refined by Loop subdivision (Loop 1987), at most three times, until its edges are
    about as short as ``edge_mm``.

    Args:
        skin: Skin in limb axes [mm].
        limb: Axes of the limb.
        edges: Upper and lower edge.
        windows: Windows in the sleeve.
        edge_mm: Edge length that the region will be meshed with [mm].

    Returns:
        The component around the joint: two planar loops around the limb and one around each window.

    Raises:
        GeometryError: There is no skin, it is torn, the region is not a sleeve around the joint, or a window
            does not lie within it.
    """
    fine = _refine(_crop(skin, edges), edge_mm)
    snap = _SNAP * _median_edge(fine)
    for edge in edges:
        fine = Surface(*cut_by_plane(fine.vertices, fine.triangles, edge.normal, edge.offset, snap))
    region = _around_joint(fine)
    _check_manifold(region)
    _check_annulus(region, limb, edges)
    return _open(region, limb, windows)


def loops_of(surface: Surface, limb: Limb) -> Loops:
    """The open edges of a sleeve: those that go around the limb are its ends, all others are windows.

    Raises:
        GeometryError: The surface has more or fewer than two ends.
    """
    loops = [np.asarray(loop, np.int64) for loop in igl.boundary_loop_all(surface.triangles)]
    turns = [turns_about(surface.vertices[loop], limb) for loop in loops]
    ends = [loop for loop, turn in zip(loops, turns, strict=True) if abs(turn) == 1]
    if len(ends) != 2:
        raise GeometryError(
            f"a sleeve has 2 edges around the limb, this surface has {len(ends)}",
            where="design domain",
            hint="change domain.above, domain.below or domain.triangles a little",
        )
    upper, lower = sorted(ends, key=lambda loop: -surface.vertices[loop, 1].mean())
    windows = tuple(loop for loop, turn in zip(loops, turns, strict=True) if abs(turn) != 1)
    return Loops(upper, lower, windows)


def turns_about(loop: Float[Array, "point 3"], limb: Limb) -> int:
    """How often a closed line goes around the axis of the limb."""
    azimuth = limb.azimuth(loop)
    step = np.diff(azimuth, append=azimuth[:1])
    return round(float(np.sum((step + np.pi) % (2.0 * np.pi) - np.pi) / (2.0 * np.pi)))


def _median_edge(surface: Surface) -> float:
    edges, _ = mesh_edges(surface.triangles)
    return float(np.median(np.linalg.norm(np.diff(surface.vertices[edges], axis=1), axis=-1)))


def _crop(skin: Surface, edges: tuple[Edge, Edge]) -> Surface:
    """Whole triangles in and near the region, to make the exact cut on less."""
    depth = np.max([skin.vertices @ edge.normal - edge.offset for edge in edges], axis=0)
    if not (depth < 0.0).any():
        raise _empty()
    core = _around_joint(_kept(skin, depth < 0.0))
    return _around_joint(_kept(skin, depth < _MARGIN * _median_edge(core)))


def _kept(skin: Surface, inside: Bool[Array, " vertex"]) -> Surface:
    """Triangles with a corner inside."""
    return Surface(*compact(skin.vertices, skin.triangles, np.any(inside[skin.triangles], axis=1)))


def _refine(surface: Surface, edge_mm: float) -> Surface:
    ratio = _median_edge(surface) / edge_mm
    if ratio <= 1.0:
        return surface
    times = min(int(np.ceil(np.log2(ratio))), 3)
    _check_manifold(surface)
    vertices, triangles = igl.loop(np.ascontiguousarray(surface.vertices), surface.triangles, times)
    return Surface(np.asarray(vertices), np.asarray(triangles, np.int64))


def _around_joint(surface: Surface) -> Surface:
    """The connected piece that lies beside the joint centre, on the lateral side.

    The other leg is on the medial side, where the skin of heavy legs comes nearer to this joint than their own.
    """
    if not len(surface.triangles):
        raise _empty()
    piece = np.asarray(igl.facet_components(surface.triangles)[1]).ravel()
    beside = leaves_skin(surface, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    target = np.array([0.0, 0.0, beside or 0.0])
    nearest = np.argmin(np.linalg.norm(surface.vertices[surface.triangles].mean(axis=1) - target, axis=1))
    home = piece[nearest]
    return Surface(*compact(surface.vertices, surface.triangles, piece == home))


def _open(region: Surface, limb: Limb, windows: tuple[Window, ...]) -> Surface:
    """The sleeve without what lies in its windows."""
    ends = loops_of(region, limb)
    margin = _median_edge(region)
    taken = np.zeros(len(region.vertices), bool)
    for window in windows:
        levels = window.levels(region.vertices)
        for name, loop in (("upper", ends.upper), ("lower", ends.lower)):
            if (levels[loop] < margin).any():
                raise GeometryError(
                    f"the window at the {window.title} crosses the {name} edge of the sleeve",
                    where=window.key,
                    hint="make the window smaller, or the sleeve longer (domain.above, domain.below)",
                )
        if (taken & (levels < margin)).any():
            raise GeometryError(
                f"the window at the {window.title} runs into another window",
                where=window.key,
                hint="make the windows smaller, or join them into one",
            )
        taken |= levels < margin
    for count, window in enumerate(windows, 1):
        levels = window.levels(region.vertices)
        region = Surface(*cut_by_levels(region.vertices, region.triangles, -levels, _SNAP_WINDOW))
        if igl.euler_characteristic(region.triangles) != -count or len(_pieces(region)) != 1:
            raise GeometryError(
                f"the window at the {window.title} is no single hole in the skin",
                where=window.key,
                hint="make the window smaller or larger: it meets the skin in several places, or nowhere",
            )
    return region


def _pieces(surface: Surface) -> Int[Array, " piece"]:
    return np.unique(np.asarray(igl.facet_components(surface.triangles)[1]))


def _empty() -> GeometryError:
    return GeometryError(
        "there is no skin in the braced region",
        where="domain.above, domain.below",
        hint="check that skin and joint centres share one frame, in metres",
    )


def _check_manifold(surface: Surface) -> None:
    _, edge_of = mesh_edges(surface.triangles)
    directed = np.stack([surface.triangles, np.roll(surface.triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    crowded = int((np.bincount(edge_of.ravel()) > 2).sum())
    twice = len(directed) - len(np.unique(directed, axis=0))
    if crowded or twice:
        raise GeometryError(
            f"the skin is torn: {crowded} edges with more than two triangles, {twice} with opposite winding",
            where="skin of the braced region",
            hint="repair the mesh (merge doubles, make normals consistent) and read it again",
        )


def _check_annulus(region: Surface, limb: Limb, edges: tuple[Edge, Edge]) -> None:
    if (region.vertices[:, 2] < limb.other[2]).any():
        raise GeometryError(
            "the region runs over the crotch into the other leg",
            where=edges[0].key,
            hint=f"lower {edges[0].key}",
        )
    loops = [region.vertices[np.asarray(loop)] for loop in igl.boundary_loop_all(region.triangles)]
    on_edge = [[loop for loop in loops if np.abs(loop @ e.normal - e.offset).max() < 1e-6] for e in edges]
    holes = len(loops) - sum(len(found) for found in on_edge)
    if holes:
        raise GeometryError(
            f"the skin has {holes} hole(s) or open end(s) in the braced region",
            where=f"{edges[0].key}, {edges[1].key}",
            hint="fill the holes of the scan, or move the edges so that they lie on the skin",
        )
    for found, edge in zip(on_edge, edges, strict=True):
        if len(found) != 1 or _elongation(found[0]) > _ROUND[limb.name]:
            raise GeometryError(
                f"the edge of the region is no ring around the limb: it reaches the {edge.beyond}",
                where=edge.key,
                hint=f"lower {edge.key}, or check the joint centres",
            )
        if abs(turns_about(found[0], limb)) != 1:
            raise GeometryError(
                "the skin does not go around the limb's axis",
                where=edge.key,
                hint="check that skin and joint centres share one frame",
            )
    if igl.euler_characteristic(region.triangles) != 0:
        raise GeometryError(
            "the skin of the region has handles, it is no plain sleeve",
            where="skin of the braced region",
            hint="repair the mesh (close tunnels, remove inner surfaces) and read it again",
        )


def _elongation(loop: Float[Array, "point 3"]) -> float:
    """Length over width of a loop."""
    spread = np.linalg.svd(loop - loop.mean(axis=0), compute_uv=False)
    return float(spread[0] / spread[1])
