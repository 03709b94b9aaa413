"""3MF files: all pieces on one plate, each with its name and colour, in millimetres."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lib3mf
import numpy as np
from lib3mf import get_wrapper

from fabrication.printable import Printable
from hilbrace.run.records import write_atomic

GAP_MM = 10.0
"""Distance between neighbours on the plate [mm]."""


def write_3mf(path: Path, title: str, pieces: Sequence[Printable]) -> None:
    """Write the pieces beside each other as they stand on the printer's bed.

    Args:
        path: The ``.3mf`` file.
        title: Title of the model.
        pieces: What to print.
    """
    wrapper: Any = get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    model.GetMetaDataGroup().AddMetaData("", "Title", title, "xs:string", True)
    model.GetMetaDataGroup().AddMetaData("", "Application", "hilbrace", "xs:string", True)
    colours = model.AddBaseMaterialGroup()
    model.SetBuildUUID(_identity(title, "build"))
    left = 0.0
    for piece in pieces:
        mesh = _mesh(model, piece)
        mesh.SetUUID(_identity(title, piece.piece.name))
        red, green, blue = (round(255 * value) for value in piece.piece.colour)
        material = colours.AddMaterial(piece.piece.title, wrapper.RGBAToColor(red, green, blue, 255))
        mesh.SetObjectLevelProperty(colours.GetResourceID(), material)
        left += 0.5 * piece.size[0]
        item = model.AddBuildItem(mesh, wrapper.GetTranslationTransform(left, 0.0, 0.0))
        item.SetPartNumber(piece.piece.name)
        item.SetUUID(_identity(title, piece.piece.name, "item"))
        left += 0.5 * piece.size[0] + GAP_MM
    write_atomic(path, bytes(bytearray(model.QueryWriter("3mf").WriteToBuffer())))


def _identity(*names: str) -> str:
    """The same identifier for the same names, so that one mold gives one file."""
    return str(uuid.uuid5(uuid.NAMESPACE_URL, "/".join(("hilbrace", *names))))


def _mesh(model: Any, piece: Printable) -> Any:
    vertices = np.ascontiguousarray(piece.vertices, dtype="<f4")
    triangles = np.ascontiguousarray(piece.triangles, dtype="<u4")
    mesh = model.AddMeshObject()
    mesh.SetName(piece.piece.name)
    mesh.SetGeometry(
        (lib3mf.Position * len(vertices)).from_buffer_copy(vertices.tobytes()),
        (lib3mf.Triangle * len(triangles)).from_buffer_copy(triangles.tobytes()),
    )
    return mesh
