"""A brace from a file of unknown make: what is wrong with it is mended and named, or refused and named.

Nothing that would leave a rib out of the mold passes: open surfaces, bodies apart, surfaces that run through
each other, and walls that the printer cannot make room for end in an error that says where.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import igl
import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold, OpType
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from fabrication.bodies import body_of, mesh_of
from fabrication.printers import Printer
from fabrication.thickness import thinnest_wall
from hilbrace.body.mesh_file import load_triangles
from hilbrace.errors import GeometryError, InputError

Array = np.ndarray

UNITS = {"mm": 1.0, "cm": 10.0, "in": 25.4, "m": 1000.0}
"""Millimetres per unit of a file."""
LENGTHS_MM = (25.0, 900.0)
"""Longest sides that braces and coupons have."""
WALLS_MM = (1.1, 8.0)
"""Twice the volume over the surface of braces, somewhat less than their thickness, for telling units other
than millimetres; in these any thinner one is believed, too."""
JOIN_MM = 0.01
"""Vertices at open edges that are nearer to each other than this are one."""
HOLE_MM = 8.0
"""Holes up to this length around are closed."""
PROBE_MM = 1e-3
"""How far beside a face it is looked whether another part of the brace is there."""


class Mesh(NamedTuple):
    """A surface.

    Attributes:
        vertices: Positions.
        triangles: Vertex indices.
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]


@dataclass(frozen=True)
class ForeignBrace:
    """A sound brace.

    Attributes:
        body: Its body [mm].
        mesh: Its surface [mm].
        factor: Millimetres per unit of the file.
        repairs: What was mended, a sentence each.
    """

    body: Manifold
    mesh: Mesh
    factor: float
    repairs: tuple[str, ...]


def read_brace(path: Path, printer: Printer, units: str | None = None) -> ForeignBrace:
    """Read, mend and check a brace.

    Args:
        path: STL, PLY or OBJ file.
        printer: What its mold is printed on.
        units: Unit of the file, a key of `UNITS`; told from its size if left out.

    Raises:
        InputError: The file is missing or no mesh, or its unit cannot be told.
        GeometryError: The brace is not closed, touches itself, consists of several bodies, or is thinner than
            the printer can make room for.
    """
    where = str(path)
    mesh, repairs = _sewn(Mesh(*load_triangles(path)), where)
    mesh, mended = _outward(mesh, where)
    repairs += mended
    factor, told = _unit(mesh, units, where)
    mesh = Mesh(mesh.vertices * factor, mesh.triangles)
    body, united = _one_body(mesh, where)
    mesh = Mesh(*mesh_of(body))
    check_apart(mesh, where)
    thinnest = thinnest_wall(body, 2 * printer.min_wall_mm)
    if thinnest < printer.min_wall_mm:
        raise GeometryError(
            f"the brace is only {thinnest:.2f} mm thick somewhere, and {printer.title} prints no wall or gap "
            f"below {printer.min_wall_mm:g} mm",
            where=where,
            hint="make its ribs wider, or print finer with mold.process = 'sla'; check the unit of the file",
        )
    return ForeignBrace(body, mesh, factor, (*repairs, *told, *united))


def _sewn(mesh: Mesh, where: str) -> tuple[Mesh, list[str]]:
    """A surface without open edges."""
    repairs = []
    points, triangles = mesh
    whole = distinct(triangles)
    if len(whole) < len(triangles):
        repairs.append(f"{len(triangles) - len(whole)} triangles without area or given twice were left out")
    edges = open_edges(whole)
    if len(edges):
        size = np.ptp(points, axis=0).max()
        points, whole, joined = _joined(points, whole, min(JOIN_MM, 1e-4 * size))
        if joined:
            repairs.append(
                f"{joined} vertices along open edges were joined with others as good as at their place"
            )
        edges = open_edges(whole)
    if len(edges):
        points, whole, filled = _filled(points, whole, edges, where)
        repairs.append(f"{filled} small holes were closed")
    used, numbers = np.unique(whole, return_inverse=True)
    return Mesh(points[used], numbers.reshape(-1, 3)), repairs


def distinct(triangles: Int[Array, "triangle 3"]) -> Int[Array, "kept 3"]:
    """Triangles with three different corners, each once."""
    a, b, c = triangles.T
    kept = triangles[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    return kept[np.sort(first)]


def open_edges(triangles: Int[Array, "triangle 3"]) -> Int[Array, "edge 2"]:
    """Directed edges of one triangle only."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    code = edges.min(axis=1) * (int(triangles.max(initial=0)) + 1) + edges.max(axis=1)
    _, first, times = np.unique(code, return_index=True, return_counts=True)
    return edges[np.sort(first[times == 1])]


def _joined(
    points: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], reach: float
) -> tuple[Array, Array, int]:
    """Vertices of open edges that nearly coincide made one."""
    loose = np.unique(open_edges(triangles))
    pairs = KDTree(points[loose]).query_pairs(reach, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), loose[pairs].T), shape=(len(points),) * 2)
    group = connected_components(graph, directed=False)[1]
    _, first = np.unique(group, return_index=True)
    joined = len(points) - len(first)
    return points, distinct(first[group][triangles]), joined


def _filled(
    points: Array, triangles: Array, edges: Int[Array, "edge 2"], where: str
) -> tuple[Array, Array, int]:
    """Small holes closed by fans about their middle."""
    after = dict(edges.tolist())
    left, holes = set(after), 0
    while left:
        start = min(left)
        loop = [start]
        while (following := after.get(loop[-1])) not in (None, start) and len(loop) <= len(after):
            loop.append(following)
        around = float(np.linalg.norm(points[loop] - np.roll(points[loop], 1, axis=0), axis=1).sum())
        if after.get(loop[-1]) != start or around > HOLE_MM:
            raise GeometryError(
                f"the brace is not closed: {len(edges)} open edges, one near {_place(points[start])}, a hole "
                f"{around:.0f} around",
                where=where,
                hint="close its holes in a mesh editor",
            )
        left -= set(loop)
        ring = np.array(loop)
        fan = np.stack([np.roll(ring, -1), ring, np.full(len(ring), len(points))], axis=1)
        points = np.concatenate([points, points[ring].mean(axis=0, keepdims=True)])
        triangles = np.concatenate([triangles, fan])
        holes += 1
    return points, triangles, holes


def _outward(mesh: Mesh, where: str) -> tuple[Mesh, list[str]]:
    """All triangles of each part outward."""
    points, triangles = mesh
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, times = np.unique(edges, axis=0, return_counts=True)
    crowded = unique[times > 2]
    if len(crowded):
        raise GeometryError(
            f"the brace touches itself: {len(crowded)} edges belong to more than two triangles, one near "
            f"{_place(points[crowded[0]].mean(axis=0))}",
            where=where,
            hint="unite its parts in a mesh editor so that they overlap, or move them apart",
        )
    turned = np.asarray(igl.bfs_orient(np.ascontiguousarray(triangles))[0]).astype(np.int64)
    for part in parts_of(turned):
        if _volume(points, turned[part]) < 0:
            turned[part] = turned[part][:, ::-1]
    wrong = int((_parity(turned) != _parity(triangles)).sum())
    return Mesh(points, turned), [f"{wrong} triangles that faced inwards were turned"] if wrong else []


def _parity(triangles: Int[Array, "triangle 3"]) -> Array:
    """Whether corners ascend around a triangle: tells the two windings of one triangle apart."""
    a, b, c = triangles.T
    return ((a < b).astype(int) + (b < c) + (c < a)) == 2


def parts_of(triangles: Int[Array, "triangle 3"]) -> list[Int[Array, " own"]]:
    """Triangles of each connected part, the first triangle's part first."""
    a, b, c = triangles.T
    rows, columns = np.concatenate([a, b]), np.concatenate([b, c])
    count = int(triangles.max()) + 1
    graph = coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(count, count))
    label = connected_components(graph, directed=False)[1][a]
    return [np.flatnonzero(label == one) for one in dict.fromkeys(label.tolist())]


def _volume(points: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> float:
    a, b, c = np.moveaxis(points[triangles] - points[triangles[0, 0]], 1, 0)
    return float(np.einsum("tx,tx->", a, np.cross(b, c)) / 6)


def _unit(mesh: Mesh, units: str | None, where: str) -> tuple[float, list[str]]:
    """Millimetres per unit of the file, and a sentence if it was told from its size."""
    if units is not None:
        return UNITS[units], []
    size = float(np.ptp(mesh.vertices, axis=0).max())
    p = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2
    wall = 2 * _volume(mesh.vertices, mesh.triangles) / float(area)
    fits = [
        unit
        for unit, factor in UNITS.items()
        if LENGTHS_MM[0] <= factor * size <= LENGTHS_MM[1]
        and (WALLS_MM[0] if factor > 1 else 0.0) <= factor * wall <= WALLS_MM[1]
    ]
    if fits[:1] == ["mm"]:
        return 1.0, []
    if len(fits) == 1:
        return UNITS[fits[0]], [
            f"the file was read in {fits[0]}: {size:.3g} long, which makes {UNITS[fits[0]] * size:.0f} mm"
        ]
    said = f"could be {' or '.join(fits)}" if fits else "fits no unit"
    raise InputError(
        f"the unit of the brace cannot be told: {size:.3g} long and about {wall:.2g} thick {said}",
        where=where,
        hint=f"say it with --units {'|'.join(UNITS)}",
    )


def _one_body(mesh: Mesh, where: str) -> tuple[Manifold, list[str]]:
    """One body; parts that overlap are united."""
    parts = parts_of(mesh.triangles)
    bodies = [body_of(*_compact(mesh.vertices, mesh.triangles[part]), where) for part in parts]
    if len(bodies) == 1:
        return bodies[0], []
    for part in parts:
        check_apart(Mesh(*_compact(mesh.vertices, mesh.triangles[part])), where)
    united = Manifold.batch_boolean(bodies, OpType.Add)
    apart = sorted((piece.volume() for piece in united.decompose()), reverse=True)
    if len(apart) > 1:
        sizes = ", ".join(f"{volume / 1000:.3g}" for volume in apart[:4])
        raise GeometryError(
            f"the file holds {len(apart)} bodies apart from each other ({sizes} ml)",
            where=where,
            hint="join them in a mesh editor, delete what is no brace, or cast each by itself",
        )
    return united, [f"{len(parts)} bodies that overlap were made one"]


def _compact(points: Array, triangles: Array) -> tuple[Array, Array]:
    used, numbers = np.unique(triangles, return_inverse=True)
    return points[used], numbers.reshape(-1, 3)


def check_apart(
    mesh: Mesh, where: str, what: str = "brace", allowed_mm2: float = 0.0, faces: int | None = None
) -> None:
    """Refuse a surface that runs through itself or touches itself.

    Just inside each face the winding number of a sound surface is 1, just outside it is 0.

    Args:
        mesh: The surface [mm].
        where: What shows it.
        what: What the surface is called.
        allowed_mm2: Area of such faces that is passed over.
        faces: Faces to look at, spread over all; all if left out.

    Raises:
        GeometryError: Some face has more of the brace in front of it, or lies inside of it.
    """
    p = mesh.vertices[mesh.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    double = np.linalg.norm(normal, axis=1)
    longest = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(axis=1)
    seen = np.flatnonzero(double > 30 * PROBE_MM * longest)
    seen = seen[:: max(1, len(seen) // faces)] if faces else seen
    step = PROBE_MM * normal[seen] / double[seen, None]
    middle = p[seen].mean(axis=1)
    probes = np.concatenate([middle - step, middle + step])
    found = np.asarray(igl.fast_winding_number(mesh.vertices, mesh.triangles, probes))
    wrong = np.abs(found.reshape(2, -1) - [[1.0], [0.0]]).max(axis=0) > 0.5
    if double[seen[wrong]].sum() / 2 > allowed_mm2:
        raise GeometryError(
            f"the {what} touches itself or runs through itself, near {_place(middle[wrong][0])}",
            where=where,
            hint="unite its parts in a mesh editor, or move them apart by more than the thinnest wall",
        )


def _place(point: Float[Array, "3"]) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in point) + ")"
