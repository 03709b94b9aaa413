"""The braced part of the skin: an annulus around the limb, between two planes or as it is painted."""

from __future__ import annotations

import igl
import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

from hilbrace.domain.edges import Edge
from hilbrace.domain.isoline import compact, cut_by_levels, cut_by_plane, mesh_edges
from hilbrace.domain.landmarks import leaves_skin
from hilbrace.domain.limb import Limb, Surface
from hilbrace.domain.loops import open_loops, turns_about
from hilbrace.domain.paint import smoothed_paint
from hilbrace.errors import GeometryError

Array = np.ndarray

_SNAP = 0.1
"""Vertices nearer to a cutting plane than this share of an edge move onto it [-]."""

_SNAP_PAINT = 0.2
"""The same along the edges of the mesh at the border of paint [-]."""

_ROUND = {"knee": 1.8, "ankle": 2.6}
"""Cross-sections that a brace ends at are less elongated than this; those of foot or toes more [-]."""

_MARGIN = 3.0
"""Skin kept beyond the planes while the mesh is refined, in edge lengths [-]."""

_LONGEST = 3
"""Most rounds of subdivision."""


def cut_region(skin: Surface, limb: Limb, edges: tuple[Edge, Edge], edge_mm: float) -> Surface:
    """Cut the braced region out of the skin of a whole body.

    Coarse skin is first refined by Loop subdivision (Loop 1987), at most three times, until its edges are
    about as short as ``edge_mm``.

    Args:
        skin: Skin in limb axes [mm].
        limb: Axes of the limb.
        edges: Upper and lower edge.
        edge_mm: Edge length that the region will be meshed with [mm].

    Returns:
        The component around the joint: two planar loops around the limb, Euler characteristic 0.

    Raises:
        GeometryError: There is no skin, it is torn, or the region is not a sleeve around the joint.
    """
    fine = _refined(_crop(skin, limb, edges), edge_mm)
    snap = _SNAP * median_edge(fine)
    for edge in edges:
        fine = Surface(*cut_by_plane(fine.vertices, fine.triangles, edge.normal, edge.offset, snap))
    region = _around_joint(fine)
    _check_manifold(region)
    _check_annulus(region, limb, edges)
    return region


def cut_painted(skin: Surface, limb: Limb, painted: Bool[Array, " vertex"], edge_mm: float) -> Surface:
    """Cut the painted region out of the skin of a whole body.

    The border of the paint is smoothed over about one edge of the skin, so that it does not follow the
    zigzag of the vertices that happened to be painted.

    Args:
        skin: Skin in limb axes [mm].
        limb: Axes of the limb.
        painted: Its painted vertices.
        edge_mm: Edge length that the region will be meshed with [mm].

    Returns:
        The painted component around the joint: two loops around the limb, and one around each window.

    Raises:
        GeometryError: The skin is torn, or the painted part is no sleeve around the joint.
    """
    levels = 0.5 - smoothed_paint(skin, painted, median_edge(skin_near(skin, painted)))
    near = np.any((painted | (levels < 0.45))[skin.triangles], axis=1)
    vertices, triangles = compact(skin.vertices, skin.triangles, near)
    kept = np.unique(skin.triangles[near])
    patch, carried = _subdivided(Surface(vertices, triangles), levels[kept], edge_mm)
    region = Surface(*cut_by_levels(patch.vertices, patch.triangles, carried, _SNAP_PAINT))
    region = _around_joint(region)
    _check_manifold(region)
    _check_painted(region, limb)
    return region


def median_edge(surface: Surface) -> float:
    """Median length of the edges of a mesh [mm]."""
    edges, _ = mesh_edges(surface.triangles)
    return float(np.median(np.linalg.norm(np.diff(surface.vertices[edges], axis=1), axis=-1)))


def skin_near(skin: Surface, inside: Bool[Array, " vertex"]) -> Surface:
    """Triangles with a corner inside."""
    return Surface(*compact(skin.vertices, skin.triangles, np.any(inside[skin.triangles], axis=1)))


def _crop(skin: Surface, limb: Limb, edges: tuple[Edge, Edge]) -> Surface:
    """Whole triangles in and near the region, to make the exact cut on less."""
    depth = np.max([skin.vertices @ edge.normal - edge.offset for edge in edges], axis=0)
    # Slanted planes meet again far from the limb.
    depth = np.where(limb.distance(skin.vertices) < _REACH, depth, np.inf)
    if not (depth < 0.0).any():
        raise _empty()
    core = _around_joint(skin_near(skin, depth < 0.0))
    return _around_joint(skin_near(skin, depth < _MARGIN * median_edge(core)))


_REACH = 400.0
"""Skin further than this from the limb's axis is that of another part of the body [mm]."""


def _refined(surface: Surface, edge_mm: float) -> Surface:
    return _subdivided(surface, np.zeros(len(surface.vertices)), edge_mm)[0]


def _subdivided(
    surface: Surface, values: Float[Array, " vertex"], edge_mm: float
) -> tuple[Surface, Float[Array, " new"]]:
    """A mesh refined until its edges are about as short as wanted, with values of its vertices."""
    ratio = median_edge(surface) / edge_mm
    times = min(int(np.ceil(np.log2(ratio))), _LONGEST) if ratio > 1.0 else 0
    if times:
        _check_manifold(surface)
    vertices, triangles = surface.vertices, surface.triangles
    for _ in range(times):
        matrix, triangles = igl.loop_matrix(triangles, len(vertices))
        matrix, triangles = sparse.csr_array(matrix), np.asarray(triangles, np.int64)
        vertices, values = matrix @ vertices, matrix @ values
    return Surface(vertices, triangles), values


def _around_joint(surface: Surface) -> Surface:
    """The connected piece that lies beside the joint centre, on the lateral side.

    The other leg is on the medial side, where the skin of heavy legs can be nearer to this joint than
    their own.
    """
    if not len(surface.triangles):
        raise _empty()
    piece = np.asarray(igl.facet_components(surface.triangles)[1]).ravel()
    beside = leaves_skin(surface, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    target = np.array([0.0, 0.0, beside or 0.0])
    nearest = np.argmin(np.linalg.norm(surface.vertices[surface.triangles].mean(axis=1) - target, axis=1))
    return Surface(*compact(surface.vertices, surface.triangles, piece == piece[nearest]))


def _empty() -> GeometryError:
    return GeometryError(
        "there is no skin in the braced region",
        where="domain.above, domain.below",
        hint="check that skin and joint centres share one frame, in metres",
    )


def _check_manifold(surface: Surface) -> None:
    _, edge_of = mesh_edges(surface.triangles)
    rising = surface.triangles < np.roll(surface.triangles, -1, axis=1)
    crowded = int((np.bincount(edge_of.ravel()) > 2).sum())
    twice = edge_of.size - len(np.unique(2 * edge_of.ravel() + rising.ravel()))
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
    loops = [region.vertices[loop] for loop in open_loops(region)]
    on_edge = [[loop for loop in loops if np.abs(loop @ e.normal - e.offset).max() < 1e-6] for e in edges]
    holes = len(loops) - sum(len(found) for found in on_edge)
    for edge in edges:
        short = edge.offset - float((region.vertices @ edge.normal).max())
        if short > 1e-6:
            raise GeometryError(
                f"the skin ends {short:.0f} mm before the edge of the region",
                where=edge.key,
                hint="move the edge so that it lies on the skin, or scan more of the leg",
            )
        on_plane = [np.abs(loop @ edge.normal - edge.offset) < 1e-6 for loop in loops]
        if any(part.any() and not part.all() for part in on_plane):
            raise GeometryError(
                "the edge of the region runs into the other edge, or off the skin",
                where=edge.key,
                hint=f"move {edge.key} further from the joint, or onto the scanned skin",
            )
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
        raise _handles("repair the mesh (close tunnels, remove inner surfaces) and read it again")


def _check_painted(region: Surface, limb: Limb) -> None:
    loops = [region.vertices[loop] for loop in open_loops(region)]
    ends = sum(abs(turns_about(loop, limb)) == 1 for loop in loops)
    if ends != 2:
        raise GeometryError(
            f"the painted skin is no sleeve: {ends} of its {len(loops)} edges go around the {limb.name}",
            where="domain.painted",
            hint="paint a band all the way around the limb, with the joint in it, that ends above and below",
        )
    if (region.vertices[:, 2] < limb.other[2]).any():
        raise GeometryError(
            "the painted skin runs into the other leg", where="domain.painted", hint="paint one leg only"
        )
    if igl.euler_characteristic(region.triangles) != 2 - len(loops):
        raise _handles("repair the mesh (close tunnels, remove inner surfaces), and paint it anew")


def _handles(hint: str) -> GeometryError:
    return GeometryError(
        "the skin of the region has handles, it is no plain sleeve",
        where="skin of the braced region",
        hint=hint,
    )


def _elongation(loop: Float[Array, "point 3"]) -> float:
    """Length over width of a loop."""
    spread = np.linalg.svd(loop - loop.mean(axis=0), compute_uv=False)
    return float(spread[0] / spread[1])
