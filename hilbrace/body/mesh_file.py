"""A person's surface from a mesh file: read, turned into OpenSim axes and metres, and checked.

What is wrong with a file is said in the file's own axes and unit, so that it can be found in the program that
made the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from trimesh.exchange.stl import HeaderError

from hilbrace.body.fit import enclosed_volume
from hilbrace.config import BodySettings
from hilbrace.errors import ConfigError, GeometryError, InputError
from hilbrace.units import MESH_TO_M, MM_PER_M

Array = np.ndarray

SUFFIXES = (".ply", ".obj", ".stl")
LONGEST, SHORTEST = 2.5, 0.12
"""Lengths between which a body or a part of a leg lies [m]."""
END = 0.25
"""Part of the height at either end in which an open border is the end of the scan and no hole [-]."""
ISLAND = 0.05
"""Part of the area below which a loose part is no limb [-]."""

_UNREADABLE = (ValueError, IndexError, KeyError, TypeError, OSError, ImportError, HeaderError)
"""What the reader raises on files that are no meshes; it looks for a guesser of encodings, too."""
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class MeshFrame:
    """How a mesh file's coordinates become OpenSim's.

    Attributes:
        rotation: Rows are the forward, upward and rightward directions in the file.
        metres: Metres per unit of the file.
        unit: Name of the unit.
    """

    rotation: Float[Array, "3 3"]
    metres: float
    unit: str

    def inwards(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Points of the file in OpenSim axes [m]."""
        return points @ self.rotation.T * self.metres

    def outwards(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Points in OpenSim axes [m] as the file has them."""
        return points @ self.rotation / self.metres

    def named(self, point: Float[Array, " 3"]) -> str:
        """A point in OpenSim axes [m] in words, as the file has it."""
        x, y, z = self.outwards(point)
        return f"({x:.4g}, {y:.4g}, {z:.4g}) {self.unit}"


@dataclass(frozen=True)
class MeshSurface:
    """A checked surface in OpenSim axes [m], outward.

    Attributes:
        vertices: Positions [m].
        triangles: Vertex indices.
        closed: True without any border.
        frame: Where it came from.
        where: The file.
    """

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    closed: bool
    frame: MeshFrame
    where: str


def read_mesh(settings: BodySettings) -> MeshSurface:
    """Read and check the mesh that the configuration names.

    Raises:
        ConfigError: No file is named, or up and forward are one axis.
        InputError: The file cannot be read or is no mesh of this size.
        GeometryError: The surface is not manifold, has holes, or consists of loose parts.
    """
    if settings.model_file is None:
        raise ConfigError(
            "no mesh is named",
            where="body.model_file",
            hint="name a PLY, OBJ or STL file for body.model = 'mesh'",
        )
    where = str(settings.model_file)
    frame = mesh_frame(settings)
    points, triangles = load_triangles(settings.model_file)
    vertices = frame.inwards(points)
    _check_size(vertices, frame, where)
    triangles = _oriented(vertices, _whole(triangles), frame, where)
    _check_parts(vertices, triangles, frame, where)
    closed = _check_borders(vertices, triangles, frame, where)
    used, flat = np.unique(triangles, return_inverse=True)
    return MeshSurface(
        np.ascontiguousarray(vertices[used]), np.ascontiguousarray(flat.reshape(-1, 3)), closed, frame, where
    )


def mesh_frame(settings: BodySettings) -> MeshFrame:
    """Axes and unit of the mesh file.

    Raises:
        ConfigError: Up and forward are one axis.
    """
    up, forward = (_direction(name) for name in (settings.mesh_up, settings.mesh_forward))
    if abs(up @ forward) > 0.5:
        raise ConfigError(
            f"up ({settings.mesh_up}) and forward ({settings.mesh_forward}) are one axis",
            where="body.mesh_up, body.mesh_forward",
            hint="name the two axes of the file that point to the head and to the toes",
        )
    rotation = np.stack([forward, up, np.cross(forward, up)])
    return MeshFrame(rotation, MESH_TO_M[settings.mesh_units], settings.mesh_units)


def load_triangles(path: Path) -> tuple[Float[Array, "vertex 3"], Int[Array, "triangle 3"]]:
    """Vertices, equal ones joined, and triangles of a PLY, OBJ or STL file as it has them.

    Raises:
        InputError: There is no such file, or it holds no triangle mesh.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"cannot read '{path.suffix}' as a mesh",
            where=str(path),
            hint=f"use one of {', '.join(SUFFIXES)}",
        )
    if not path.is_file():
        raise InputError("no such file", where=str(path), hint="check body.model_file")
    try:
        loaded = trimesh.load(path, process=False, force="mesh", skip_materials=True)
    except _UNREADABLE as fault:
        raise InputError(
            f"no readable mesh: {fault}",
            where=str(path),
            hint="export the surface again as binary PLY or STL",
        ) from fault
    faces = getattr(loaded, "faces", np.zeros((0, 3)))
    if not isinstance(loaded, trimesh.Trimesh) or not len(faces):
        raise InputError("holds no triangles", where=str(path), hint="a cloud of points must be meshed first")
    points = np.asarray(loaded.vertices, dtype=np.float64)
    faces = np.asarray(faces, dtype=np.int64)
    if faces.min() < 0 or faces.max() >= len(points) or not np.isfinite(points[faces]).all():
        raise InputError(
            "triangles name points that are missing or not finite",
            where=str(path),
            hint="export the surface again",
        )
    points, joined = np.unique(points, axis=0, return_inverse=True)
    return points, joined.reshape(-1)[faces]


def _direction(name: str) -> Float[Array, " 3"]:
    return np.array(_AXES[name[-1]]) * (-1.0 if name.startswith("-") else 1.0)


def _check_size(vertices: Float[Array, "vertex 3"], frame: MeshFrame, where: str) -> None:
    longest = float(np.ptp(vertices, axis=0).max())
    if SHORTEST <= longest <= LONGEST:
        return
    sizes = {unit: longest / frame.metres * metres for unit, metres in MESH_TO_M.items()}
    fitting = [f"'{unit}' ({size:.3g} m)" for unit, size in sizes.items() if SHORTEST <= size <= LONGEST]
    raise InputError(
        f"the mesh is {longest:.3g} m long when its figures are taken as {frame.unit}",
        where=where,
        hint=f"set body.mesh_units to {' or '.join(fitting)}"
        if fitting
        else "check the file: no unit fits a body",
    )


def _whole(triangles: Int[Array, "triangle 3"]) -> Int[Array, "triangle 3"]:
    """Triangles with three different corners, each once."""
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return triangles[np.sort(first)]


def _oriented(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], frame: MeshFrame, where: str
) -> Int[Array, "triangle 3"]:
    """All triangles facing outward."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    bad = unique[count > 2]
    if len(bad):
        raise GeometryError(
            f"{len(bad)} edges of the surface belong to more than two triangles, one near "
            f"{frame.named(vertices[bad[0]].mean(axis=0))}",
            where=where,
            hint="repair the non-manifold edges in the program that made the mesh",
        )
    turned = triangles.copy()
    turned[:] = igl.bfs_orient(np.ascontiguousarray(triangles))[0]
    directed = turned[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    if len(np.unique(directed, axis=0)) < len(directed):
        raise GeometryError(
            "the surface has one side only, as a Moebius strip has", where=where, hint="repair the mesh"
        )
    label = _part_labels(turned)
    middle = vertices[np.unique(turned)].mean(axis=0)
    for part in np.unique(label):
        own = label == part
        if enclosed_volume(vertices - middle, turned[own])[0] < 0.0:
            turned[own] = turned[own][:, [0, 2, 1]]
    return turned


def _part_labels(triangles: Int[Array, "triangle 3"]) -> Int[Array, " triangle"]:
    """Number of the connected part that each triangle belongs to."""
    a, b, c = triangles.T
    count = int(triangles.max()) + 1
    rows, columns = np.concatenate([a, b]), np.concatenate([b, c])
    links = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)[a]


def _check_parts(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], frame: MeshFrame, where: str
) -> None:
    label = _part_labels(triangles)
    corner = vertices[triangles]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    parts, place = np.unique(label, return_inverse=True)
    share = np.bincount(place, area) / area.sum()
    loose = np.flatnonzero(share < ISLAND)
    if len(loose) or len(parts) > 2:
        part = int(loose[0]) if len(loose) else int(share.argmin())
        raise GeometryError(
            f"the surface consists of {len(parts)} parts, one near "
            f"{frame.named(corner[place == part].mean(axis=(0, 1)))}",
            where=where,
            hint="delete loose parts, and join the rest, in the program that made the mesh",
        )


def _check_borders(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], frame: MeshFrame, where: str
) -> bool:
    """Is the surface closed? Holes elsewhere than at the ends of the limb are refused."""
    loops = igl.boundary_loop_all(np.ascontiguousarray(triangles))
    low, high = vertices[:, 1].min(), vertices[:, 1].max()
    margin = END * (high - low)
    holes = []
    for loop in loops:
        height = float(vertices[loop][:, 1].mean())
        if low + margin < height < high - margin:
            holes.append(vertices[loop])
    if holes:
        widest = max(holes, key=lambda hole: float(np.ptp(hole, axis=0).max()))
        across = np.ptp(widest, axis=0).max() * MM_PER_M
        raise GeometryError(
            f"the surface has {len(holes)} holes, the widest {across:.0f} mm across near "
            f"{frame.named(widest.mean(axis=0))}",
            where=where,
            hint="close the holes in the scanner's program; only the ends of the limb may be open",
        )
    return not len(loops)
