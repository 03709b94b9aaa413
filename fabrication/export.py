"""Files of a mold: binary STL per piece, one 3MF, and the exploded assembly as GLB."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fabrication.bodies import mesh_of
from fabrication.exploded import exploded
from fabrication.mold import Mold
from fabrication.printable import Printable
from hilbrace.pattern.export import stl_bytes
from hilbrace.run.records import write_atomic
from hilbrace.units import MM_PER_M

GLB_TOLERANCE_MM = 0.05
"""How far the assembly for viewers may lie from the mold [mm]."""


def write_stl_files(folder: Path, pieces: Sequence[Printable]) -> list[Path]:
    """Write each piece as binary STL in mm, as it stands on the printer's bed.

    Args:
        folder: Folder of the files, which exists.
        pieces: What to print.

    Returns:
        The files, in the order of the pieces.
    """
    files = []
    for piece in pieces:
        files.append(folder / f"{piece.piece.name}.stl")
        write_atomic(files[-1], stl_bytes(piece.vertices, piece.triangles))
    return files


def write_glb(path: Path, mold: Mold) -> None:
    """Write the mold drawn apart, pieces by name and colour, and the casting in its place.

    Args:
        path: The ``.glb`` file.
        mold: The mold.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    scene = trimesh.Scene()
    bodies = [(piece.name, piece.solid, piece.colour) for piece in mold.pieces]
    ways = exploded(mold)
    for name, solid, colour in bodies:
        vertices, triangles = mesh_of(solid.simplify(GLB_TOLERANCE_MM))
        material = PBRMaterial(
            name=name, baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=0.7
        )
        mesh = trimesh.Trimesh(vertices / MM_PER_M, triangles, process=False)
        mesh.visual = TextureVisuals(material=material)
        place = np.eye(4)
        place[:3, 3] = ways[name] / MM_PER_M
        scene.add_geometry(mesh, node_name=name, geom_name=name, transform=place)
    write_atomic(path, export_glb(scene))
