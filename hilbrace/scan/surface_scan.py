"""A scan of a limb from a file: read, in metres, thinned, with what is missing in it.

The scan keeps its own axes. Meshes bring their normals; a cloud of points gets them from its neighbourhoods.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from hilbrace.body.mesh_file import LONGEST, SHORTEST, SUFFIXES, load_triangles
from hilbrace.errors import InputError
from hilbrace.units import MESH_TO_M, MM_PER_M

Array = np.ndarray

GRID = 0.002
"""Points nearer to each other than this are thinned to their mean [m]."""
NEIGHBOURS = 12
STRAY = 5.0
"""A point of a cloud this many times farther from its neighbours than is usual is dropped."""
ISLAND = 0.02
"""Part of the area below which a loose part is dropped [-]."""
LEAST_HOLE = 0.015
"""Width below which a hole is not worth telling [m]."""
LEAST_POINTS = 500
_SLICE, _LINK = 0.01, 0.015
_LEVELS = np.linspace(0.12, 0.6, 9)


@dataclass(frozen=True)
class Hole:
    """A border of the surface.

    Attributes:
        centre: Its middle, in the scan's axes [m].
        width: Its largest extent [m].
        end: True where it is the open end of the limb.
    """

    centre: Float[Array, "3"]
    width: float
    end: bool


@dataclass(frozen=True)
class SurfaceScan:
    """A scan ready to be fitted.

    Attributes:
        where: The file.
        unit: Unit of the file.
        points: Thinned points [m].
        normals: Unit normals there; of a cloud, of arbitrary sign.
        oriented: True where the normals point outward.
        vertices: Vertices of the mesh as they are [m]; of a cloud, the thinned points.
        triangles: Triangles of the mesh; none of a cloud.
        holes: Borders of the mesh, widest first.
        dropped: Loose parts or stray points that were left out.
    """

    where: str
    unit: str
    points: Float[Array, "point 3"]
    normals: Float[Array, "point 3"]
    oriented: bool
    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    holes: tuple[Hole, ...]
    dropped: int

    @property
    def gaps(self) -> tuple[Hole, ...]:
        """Holes that are no open end."""
        return tuple(hole for hole in self.holes if not hole.end)


def read_scan(path: Path, unit: str | None = None) -> SurfaceScan:
    """Read a PLY, OBJ or STL scan, a mesh or (PLY) a cloud of points.

    Args:
        path: The file.
        unit: ``m``, ``cm``, ``mm`` or ``inch``; metres or millimetres by its size if left out.

    Raises:
        InputError: There is no such file, it holds no surface or too few points, or its size is no limb's in
            that unit.
    """
    raw, triangles = _load(path)
    unit = _checked_unit(float(np.ptp(raw, axis=0).max()), unit, str(path))
    vertices = raw * MESH_TO_M[unit]
    if len(triangles):
        return _of_mesh(vertices, triangles, unit, str(path))
    return _of_cloud(vertices, unit, str(path))


def legs_seen(points: Float[Array, "point 3"], up: Float[Array, "3"]) -> int:
    """How many legs stand side by side in the lower part of a scan: 1 or 2.

    Args:
        points: Points of the scan [m].
        up: Upward direction in the scan.
    """
    height = points @ up
    low, span = height.min(), np.ptp(height)
    counts = []
    for level in _LEVELS:
        inside = points[np.abs(height - low - level * span) < _SLICE / 2.0]
        counts.append(_limbs_across(inside - np.outer(inside @ up, up)))
    return 2 if sum(count == 2 for count in counts) > len(counts) // 2 else 1


def thinned(points: Float[Array, "point 3"], grid: float) -> Float[Array, "cell 3"]:
    """Means of the points in the cells of a grid, in the order of the cells.

    Args:
        points: Points [m].
        grid: Width of the cells [m].
    """
    cell = np.floor((points - points.min(axis=0)) / grid).astype(np.int64)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    _, place, count = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.bincount(place, points[:, axis], len(count)) for axis in range(3)]
    return np.stack(sums, axis=1) / count[:, None]


def _load(path: Path) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    if path.suffix.lower() == ".ply" and path.is_file():
        try:
            loaded = trimesh.load(path, process=False)
        except (ValueError, IndexError, KeyError, TypeError, OSError) as fault:
            raise InputError(
                f"no readable scan: {fault}", where=str(path), hint="export it again as binary PLY"
            ) from fault
        if isinstance(loaded, trimesh.PointCloud):
            points = np.asarray(loaded.vertices, dtype=np.float64)
            points = points[np.isfinite(points).all(axis=1)]
            _check_count(points, str(path))
            return points, np.zeros((0, 3), dtype=np.int64)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"cannot read '{path.suffix}' as a scan",
            where=str(path),
            hint=f"use one of {', '.join(SUFFIXES)}",
        )
    points, triangles = load_triangles(path)
    _check_count(points, str(path))
    return points, triangles


def _check_count(points: Float[Array, "point 3"], where: str) -> None:
    if len(points) < LEAST_POINTS:
        raise InputError(
            f"the scan has {len(points)} points", where=where, hint="export the whole scan, not its outline"
        )


def _checked_unit(longest: float, unit: str | None, where: str) -> str:
    """The unit to take a file in.

    Raises:
        InputError: The size is no limb's in that unit, or in metres and millimetres where none is named.
    """
    fitting = {name: longest * metres for name, metres in MESH_TO_M.items()}
    fitting = {name: size for name, size in fitting.items() if SHORTEST <= size <= LONGEST}
    named = " or ".join(f"--units {name} ({size:.2f} m)" for name, size in fitting.items())
    if unit is not None:
        if unit in fitting:
            return unit
        raise InputError(
            f"the scan is {longest * MESH_TO_M[unit]:.3g} m long in {unit}",
            where=where,
            hint=f"a limb would be right with {named}" if named else "check the file: no unit fits a limb",
        )
    for name in ("mm", "m"):
        if name in fitting:
            return name
    raise InputError(
        f"the scan is {longest:.3g} units long, no limb in millimetres or metres",
        where=where,
        hint=f"name its unit: {named}" if named else "check the file: no unit fits a limb",
    )


def _of_mesh(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], unit: str, where: str
) -> SurfaceScan:
    triangles, dropped = _without_islands(vertices, triangles)
    triangles = outward(vertices, triangles)
    used, flat = np.unique(triangles, return_inverse=True)
    vertices, triangles = vertices[used], np.ascontiguousarray(flat.reshape(-1, 3))
    areas = np.linalg.norm(_area_normals(vertices, triangles), axis=1)
    triangles = triangles[areas > 0.0]
    points, normals = _spread(vertices, triangles)
    return SurfaceScan(
        where=where,
        unit=unit,
        points=points,
        normals=normals,
        oriented=True,
        vertices=vertices,
        triangles=triangles,
        holes=_holes(vertices, triangles),
        dropped=dropped,
    )


def _of_cloud(points: Float[Array, "point 3"], unit: str, where: str) -> SurfaceScan:
    points = thinned(points, GRID)
    _check_count(points, where)
    distance, neighbour = cKDTree(points).query(points, NEIGHBOURS)
    apart = distance[:, 1:].mean(axis=1)
    kept = apart < STRAY * np.median(apart)
    around = points[neighbour] - points[neighbour].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", around, around))
    return SurfaceScan(
        where=where,
        unit=unit,
        points=points[kept],
        normals=axes[kept, :, 0],
        oriented=False,
        vertices=points[kept],
        triangles=np.zeros((0, 3), dtype=np.int64),
        holes=(),
        dropped=int((~kept).sum()),
    )


def _spread(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> tuple[Float[Array, "point 3"], Float[Array, "point 3"]]:
    """Points evenly over the surface, however it is meshed, with the normals of its triangles."""
    cross = _area_normals(vertices, triangles)
    twice = np.linalg.norm(cross, axis=1)
    pieces = np.maximum(1, np.ceil(twice / 2.0 / GRID**2)).astype(np.int64)
    own = np.repeat(np.arange(len(triangles)), pieces)
    number = np.arange(len(own)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    # The R2 sequence (Roberts 2018) covers each triangle evenly and is the same on every run.
    first, second = (0.5 + np.outer([0.7548776662466927, 0.5698402909980532], number)) % 1.0
    folded = first + second > 1.0
    first, second = np.where(folded, 1.0 - first, first), np.where(folded, 1.0 - second, second)
    a, b, c = (vertices[triangles[own, corner]] for corner in range(3))
    points = a + first[:, None] * (b - a) + second[:, None] * (c - a)
    return points, (cross / twice[:, None])[own]


def outward(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Int[Array, "triangle 3"]:
    """Triangles facing outward, whichever way the scanner's program wound them.

    The few that look against their neighbours are turned, each patch the way most of its area looks; then
    all, where the surface seen from its own middle is inside out. That holds for open scans too, as a piece
    of a limb bulges away from its middle.

    Args:
        vertices: Vertices [m].
        triangles: Triangles, wound in any way.
    """
    alike, patch = igl.bfs_orient(np.ascontiguousarray(triangles, dtype=np.int64))
    alike, patch = np.asarray(alike).astype(np.int64), np.asarray(patch)
    now, before = _area_normals(vertices, alike), _area_normals(vertices, triangles)
    kept = np.bincount(patch, (now * before).sum(axis=1) / np.maximum(np.linalg.norm(now, axis=1), 1e-18))
    alike[kept[patch] < 0.0] = alike[kept[patch] < 0.0][:, [0, 2, 1]]
    normals, corners = _area_normals(vertices, alike), vertices[alike].mean(axis=1)
    area = np.linalg.norm(normals, axis=1)
    middle = (corners * area[:, None]).sum(axis=0) / area.sum()
    inside_out = (normals * (corners - middle)).sum() < 0.0
    return np.ascontiguousarray(alike[:, [0, 2, 1]] if inside_out else alike)


def _area_normals(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, "triangle 3"]:
    a, b, c = (vertices[corner] for corner in triangles.T)
    return np.cross(b - a, c - a)


def _without_islands(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> tuple[Int[Array, "kept 3"], int]:
    a, b, c = triangles.T
    rows, columns = np.concatenate([a, b]), np.concatenate([b, c])
    links = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(vertices),) * 2)
    label = connected_components(links, directed=False)[1][a]
    area = np.bincount(label, np.linalg.norm(_area_normals(vertices, triangles), axis=1))
    small = area < ISLAND * area.sum()
    return triangles[~small[label]], int((small & (area > 0.0)).sum())


def _holes(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> tuple[Hole, ...]:
    """Borders of a surface; those around the ends of its long axis are the open ends of the limb."""
    centred = vertices - vertices.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    low, high = along.min(), along.max()
    holes = []
    for loop in igl.boundary_loop_all(np.ascontiguousarray(triangles)):
        width = float(np.linalg.norm(np.ptp(vertices[loop], axis=0)))
        share = (along[loop].mean() - low) / (high - low)
        holes.append(Hole(_middle(vertices[loop]), width, end=bool(share < 0.1 or share > 0.9)))
    return tuple(sorted((hole for hole in holes if hole.width > LEAST_HOLE), key=lambda hole: -hole.width))


def _middle(loop: Float[Array, "vertex 3"]) -> Float[Array, "3"]:
    """Middle of a closed line by its length, however densely it is set with vertices."""
    following = np.roll(loop, -1, axis=0)
    length = np.linalg.norm(following - loop, axis=1)
    return ((loop + following) / 2.0 * length[:, None]).sum(axis=0) / length.sum()


def _limbs_across(points: Float[Array, "point 3"]) -> int:
    """Separate rings of points in a thin slice that are as large as a leg."""
    if len(points) < 20:
        return 0
    points = thinned(points, _LINK / 3.0)
    pairs = cKDTree(points).query_pairs(_LINK, output_type="ndarray")
    links = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    count, label = connected_components(links, directed=False)
    sizes: Bool[Array, " part"] = np.array(
        [
            np.linalg.norm(np.ptp(points[label == part], axis=0)) > 0.05 and (label == part).mean() > 0.2
            for part in range(count)
        ]
    )
    return int(sizes.sum())


def describe_holes(scan: SurfaceScan) -> list[str]:
    """Each hole in words: its width and place in the file's own unit."""
    scale = MESH_TO_M[scan.unit]
    lines = []
    for hole in scan.holes:
        x, y, z = hole.centre / scale
        kind = "open end" if hole.end else "hole"
        place = f"({x:.4g}, {y:.4g}, {z:.4g}) {scan.unit}"
        lines.append(f"{kind}, {hole.width * MM_PER_M:.0f} mm wide, near {place}")
    return lines
