"""The braced part of the skin: an annulus between two planes across the thigh and the shank."""

from __future__ import annotations

import igl
import numpy as np
from jaxtyping import Float, Int

from hilbrace.domain.isoline import compact, cut_by_plane, mesh_edges
from hilbrace.domain.limb import Limb, Surface
from hilbrace.errors import GeometryError

Array = np.ndarray

_SNAP = 0.1
"""Vertices nearer to a cutting plane than this share of an edge move onto it [-]."""

_ROUND = 1.8
"""Cross-sections of thigh and shank are less elongated than this, those of the foot more [-]."""

_MARGIN = 3.0
"""Skin kept beyond the planes while the mesh is refined, in edge lengths [-]."""


def cut_region(skin: Surface, limb: Limb, above: float, below: float, edge_mm: float) -> Surface:
    """Cut the braced region out of the skin of a whole body.

    The planes are perpendicular to the lines knee - hip and knee - ankle. Coarse skin is first refined by
    Loop subdivision (Loop 1987), at most three times, until its edges are about as short as ``edge_mm``.

    Args:
        skin: Skin in limb axes [mm].
        limb: Axes of the leg.
        above: Upper edge, fraction of the thigh above the knee [-].
        below: Lower edge, fraction of the shank below the knee [-].
        edge_mm: Edge length that the region will be meshed with [mm].

    Returns:
        The component around the joint: two planar loops, Euler characteristic 0.

    Raises:
        GeometryError: There is no skin, it is torn, or the region is not a sleeve around the joint.
    """
    planes = _planes(limb, above, below)
    fine = _refine(_crop(skin, planes), edge_mm)
    snap = _SNAP * _median_edge(fine)
    for normal, offset in planes:
        fine = Surface(*cut_by_plane(fine.vertices, fine.triangles, normal, offset, snap))
    region = _around_joint(fine)
    _check_manifold(region)
    _check_annulus(region, limb, planes)
    return region


def loops_of(surface: Surface) -> tuple[Int[Array, " upper"], Int[Array, " lower"]]:
    """Vertices of the upper and the lower loop of a sleeve, each in order around.

    Raises:
        GeometryError: The surface has more or fewer than two loops.
    """
    loops = [np.asarray(loop, np.int64) for loop in igl.boundary_loop_all(surface.triangles)]
    if len(loops) != 2:
        raise GeometryError(
            f"a sleeve has 2 edges, this surface has {len(loops)}",
            where="design domain",
            hint="change domain.above, domain.below or domain.triangles a little",
        )
    upper, lower = sorted(loops, key=lambda loop: -surface.vertices[loop, 1].mean())
    return upper, lower


Plane = tuple[Float[Array, " xyz"], float]


def _planes(limb: Limb, above: float, below: float) -> tuple[Plane, Plane]:
    thigh, shank = np.linalg.norm(limb.hip), np.linalg.norm(limb.ankle)
    return (limb.hip / thigh, above * float(thigh)), (limb.ankle / shank, below * float(shank))


def _median_edge(surface: Surface) -> float:
    edges, _ = mesh_edges(surface.triangles)
    return float(np.median(np.linalg.norm(np.diff(surface.vertices[edges], axis=1), axis=-1)))


def _crop(skin: Surface, planes: tuple[Plane, Plane]) -> Surface:
    """Whole triangles in and near the region, to make the exact cut on less."""
    inside = np.ones(len(skin.vertices), bool)
    for normal, offset in planes:
        inside &= skin.vertices @ normal < offset
    if not inside.any():
        raise _empty()
    core = Surface(*compact(skin.vertices, skin.triangles, np.any(inside[skin.triangles], axis=1)))
    margin = _MARGIN * _median_edge(core)
    near = np.ones(len(skin.vertices), bool)
    for normal, offset in planes:
        near &= skin.vertices @ normal < offset + margin
    return _around_joint(
        Surface(*compact(skin.vertices, skin.triangles, np.any(near[skin.triangles], axis=1)))
    )


def _refine(surface: Surface, edge_mm: float) -> Surface:
    ratio = _median_edge(surface) / edge_mm
    if ratio <= 1.0:
        return surface
    times = min(int(np.ceil(np.log2(ratio))), 3)
    _check_manifold(surface)
    vertices, triangles = igl.loop(np.ascontiguousarray(surface.vertices), surface.triangles, times)
    return Surface(np.asarray(vertices), np.asarray(triangles, np.int64))


def _around_joint(surface: Surface) -> Surface:
    """The connected piece with the vertex nearest to the joint centre."""
    if not len(surface.triangles):
        raise _empty()
    piece = np.asarray(igl.facet_components(surface.triangles)[1]).ravel()
    nearest = np.argmin(np.linalg.norm(surface.vertices, axis=1))
    home = piece[np.argmax((surface.triangles == nearest).any(axis=1))]
    return Surface(*compact(surface.vertices, surface.triangles, piece == home))


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


def _check_annulus(region: Surface, limb: Limb, planes: tuple[Plane, Plane]) -> None:
    if (region.vertices[:, 2] < limb.other_knee[2]).any():
        raise GeometryError(
            "the region runs over the crotch into the other leg",
            where="domain.above",
            hint="lower domain.above",
        )
    loops = [region.vertices[np.asarray(loop)] for loop in igl.boundary_loop_all(region.triangles)]
    edges = [[loop for loop in loops if np.abs(loop @ n - d).max() < 1e-6] for n, d in planes]
    holes = len(loops) - sum(len(found) for found in edges)
    if holes:
        raise GeometryError(
            f"the skin has {holes} hole(s) or open end(s) in the braced region",
            where="domain.above, domain.below",
            hint="fill the holes of the scan, or move the edges so that they lie on the skin",
        )
    for found, key, part in ((edges[0], "domain.above", "crotch"), (edges[1], "domain.below", "foot")):
        if len(found) != 1 or _elongation(found[0]) > _ROUND:
            raise GeometryError(
                f"the edge of the region is no ring around the limb: it reaches the {part}",
                where=key,
                hint=f"lower {key}, or check the joint centres",
            )
        if abs(_turns_about_axis(found[0], limb)) != 1:
            raise GeometryError(
                "the skin does not go around the limb's axis",
                where=key,
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


def _turns_about_axis(loop: Float[Array, "point 3"], limb: Limb) -> int:
    azimuth = limb.azimuth(loop)
    step = np.diff(azimuth, append=azimuth[:1])
    return round(float(np.sum((step + np.pi) % (2.0 * np.pi) - np.pi) / (2.0 * np.pi)))
