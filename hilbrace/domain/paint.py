"""Painted skin: vertices chosen in MeshLab or any other program, as a list or as colours.

A list is a text file with the numbers of the vertices, counted from 0, separated by spaces, commas or lines;
lines that start with ``#`` are notes. In a PLY file with vertex colours, what has a colour is painted, and
what is white, grey or black is not.
"""

from __future__ import annotations

from pathlib import Path

import igl
import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy import sparse
from scipy.sparse.linalg import splu

from hilbrace.domain.limb import Surface
from hilbrace.errors import InputError

Array = np.ndarray

COLOURFUL = 64
"""Least difference between the channels of a colour that counts as paint, of 255."""


def read_paint(path: Path, vertices: int, key: str) -> Bool[Array, " vertex"]:
    """Which vertices of the body's skin a file paints.

    Args:
        path: Vertex list (``.txt``) or painted mesh (``.ply``).
        vertices: Number of vertices of the skin.
        key: Configuration key that names the file.

    Raises:
        InputError: The file cannot be read, belongs to another skin, or paints nothing.
    """
    if path.suffix.lower() not in (".txt", ".ply"):
        raise InputError(
            f"paint is a list (.txt) or a painted mesh (.ply), not '{path.suffix}'",
            where=f"{key} = {path}",
            hint="save the mesh as PLY with vertex colours, or the vertex numbers as text",
        )
    if not path.is_file():
        raise InputError("no such file", where=f"{key} = {path}", hint="check the path")
    painted = (
        _listed(path, vertices, key) if path.suffix.lower() == ".txt" else _coloured(path, vertices, key)
    )
    if not painted.any():
        raise InputError(
            "nothing is painted",
            where=f"{key} = {path}",
            hint="paint with a bright colour, or list at least one vertex",
        )
    return painted


def smoothed_paint(
    skin: Surface, painted: Bool[Array, " vertex"], reach_mm: float
) -> Float[Array, " vertex"]:
    """Paint that has run into the skin around it [-], by implicit diffusion over a distance.

    Args:
        skin: The skin [mm].
        painted: Its painted vertices.
        reach_mm: Diffusion length [mm].
    """
    laplacian = sparse.csc_array(igl.cotmatrix(skin.vertices, skin.triangles))
    mass = sparse.csc_array(igl.massmatrix(skin.vertices, skin.triangles, igl.MASSMATRIX_TYPE_VORONOI))
    matrix = sparse.csc_matrix(mass - reach_mm**2 * laplacian)
    return np.asarray(splu(matrix).solve(mass @ painted.astype(float)))


def _listed(path: Path, vertices: int, key: str) -> Bool[Array, " vertex"]:
    painted = np.zeros(vertices, bool)
    lines = path.read_text("utf-8", errors="replace").splitlines()
    for number, line in enumerate(lines, 1):
        for word in line.partition("#")[0].replace(",", " ").replace(";", " ").split():
            if not word.isdecimal() or int(word) >= vertices:
                raise InputError(
                    f"'{word}' is no vertex of the skin, which has vertices 0 to {vertices - 1}",
                    where=f"{key} = {path}, line {number}",
                    hint="list vertices of this body's skin, counted from 0",
                )
            painted[int(word)] = True
    return painted


def _coloured(path: Path, vertices: int, key: str) -> Bool[Array, " vertex"]:
    try:
        mesh = trimesh.load(path, process=False)
    except (ValueError, IndexError, KeyError, TypeError, UnicodeDecodeError) as fault:
        raise InputError(
            f"no readable PLY: {fault}", where=f"{key} = {path}", hint="save the painted mesh anew"
        ) from None
    visual = getattr(mesh, "visual", None)
    if visual is None or visual.kind != "vertex":
        raise InputError(
            "the mesh has no vertex colours",
            where=f"{key} = {path}",
            hint="in MeshLab choose 'Per Vertex Color' and export with Vert: Color ticked",
        )
    colour = np.asarray(visual.vertex_colors)[:, :3].astype(int)
    if len(colour) != vertices:
        raise InputError(
            f"the painted mesh has {len(colour)} vertices, the body's skin {vertices}",
            where=f"{key} = {path}",
            hint="paint on the skin of this body as it was exported, without adding or merging vertices",
        )
    return np.ptp(colour, axis=1) >= COLOURFUL
