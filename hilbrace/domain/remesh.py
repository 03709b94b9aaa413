"""Even triangles: the region meshed anew at a wanted number of triangles (Mmg)."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import mmgpy
import numpy as np

from hilbrace.domain.isoline import mesh_edges
from hilbrace.domain.limb import Surface
from hilbrace.domain.loops import loop_length, open_loops
from hilbrace.errors import GeometryError

TOLERANCE = 0.03
"""Largest deviation from the wanted number of triangles [-]."""

GOOD_ANGLE_DEG = 20.0
"""Smallest angle that a mesh should have [deg]."""

_ATTEMPTS = 12

_GOLDEN = 0.6180339887
"""Spreads the further attempts evenly over nearby edge lengths (golden section)."""

_HAUSDORFF = 0.4
"""How far Mmg may leave the surface, in edges: less costs angles, more loses the shape [-]."""

_FIRST_GUESS = 0.97
"""Mmg's mean edge over the wanted size, so that the first mesh is near the wanted count [-]."""


@dataclass(frozen=True)
class MeshQuality:
    """How even a mesh is.

    Attributes:
        triangles: Number of triangles.
        min_angle_deg: Smallest angle of a triangle [deg].
        edge_mean_mm: Mean edge length [mm].
        edge_variation: Standard deviation of the edge lengths over their mean [-].
    """

    triangles: int
    min_angle_deg: float
    edge_mean_mm: float
    edge_variation: float


def mesh_quality(surface: Surface) -> MeshQuality:
    """Count, smallest angle and evenness of a mesh."""
    edges, _ = mesh_edges(surface.triangles)
    length = np.linalg.norm(np.diff(surface.vertices[edges], axis=1), axis=-1)
    angle = np.asarray(igl.internal_angles(np.ascontiguousarray(surface.vertices), surface.triangles))
    return MeshQuality(
        triangles=len(surface.triangles),
        min_angle_deg=float(np.degrees(angle.min())),
        edge_mean_mm=float(length.mean()),
        edge_variation=float(length.std() / length.mean()),
    )


def edge_for(area_mm2: float, triangles: int) -> float:
    """Edge of equilateral triangles that cover an area [mm]."""
    return float(np.sqrt(4.0 * area_mm2 / (np.sqrt(3.0) * triangles)))


def surface_area(surface: Surface) -> float:
    """Area of a mesh [mm^2]."""
    return float(np.sum(igl.doublearea(np.ascontiguousarray(surface.vertices), surface.triangles)) / 2.0)


def remesh(region: Surface, triangles: int) -> Surface:
    """Mesh a region anew with even triangles; its edges stay where they are and as long as they are.

    The edge length is corrected until the count is within `TOLERANCE` of the wanted one and no angle is
    below `GOOD_ANGLE_DEG`; where both cannot be had, the count decides and the best angles win.

    Args:
        region: Surface with open edges [mm].
        triangles: Wanted number of triangles.

    Raises:
        GeometryError: The wanted number cannot be met.
    """
    size = _FIRST_GUESS * edge_for(surface_area(region), triangles)
    best: Surface | None = None
    best_angle = -1.0
    for attempt in range(_ATTEMPTS):
        other = 0.0 if best is None else (attempt * _GOLDEN) % 1.0 - 0.5
        mesh = _keep_lengths(_mmg(region, size * (1.0 + TOLERANCE * other)), region)
        error = len(mesh.triangles) / triangles - 1.0
        angle = mesh_quality(mesh).min_angle_deg
        if abs(error) <= TOLERANCE and angle > best_angle:
            best, best_angle = mesh, angle
        if best_angle >= GOOD_ANGLE_DEG:
            break
        if best is None:
            # Shorter and shorter steps: over regular meshes the count answers far more than squared.
            size *= float((1.0 + error) ** (1.0 / (2.0 + attempt)))
    if best is None:
        raise GeometryError(
            f"no mesh of {triangles} triangles was found for {surface_area(region) / 100:.0f} cm^2 of skin",
            where="domain.triangles",
            hint="ask for some triangles more or less",
        )
    return best


def _keep_lengths(mesh: Surface, region: Surface) -> Surface:
    """Widen each loop about its centre until it is as long as the finer one that it was cut from.

    The corners of the new loop lie on the old one, so that its sides are chords: a third of a millimetre on
    the circumference of a coarsely meshed thigh, made up for by moves of a tenth of a millimetre.
    """
    old = open_loops(region)
    centres = np.array([region.vertices[loop].mean(axis=0) for loop in old])
    vertices = mesh.vertices.copy()
    for loop in open_loops(mesh):
        middle = mesh.vertices[loop].mean(axis=0)
        same = old[int(np.argmin(np.linalg.norm(centres - middle, axis=1)))]
        scale = loop_length(region, same) / loop_length(mesh, loop)
        vertices[loop] = middle + scale * (mesh.vertices[loop] - middle)
    return Surface(vertices, mesh.triangles)


def _mmg(region: Surface, size: float) -> Surface:
    """One run of Mmg at one edge length; no crease inside is taken for a ridge."""
    mesh = mmgpy.MmgMeshS(np.ascontiguousarray(region.vertices), region.triangles.astype(np.int32))
    mesh.remesh(hsiz=float(size), hausd=_HAUSDORFF * float(size), ar=180.0, verbose=-1)
    triangles = np.array(mesh.get_triangles(), np.int64)
    return Surface(np.array(mesh.get_vertices(), float), triangles)
