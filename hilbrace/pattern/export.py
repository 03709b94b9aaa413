"""Surfaces as files for slicers, viewers and molds; the bytes depend on the surface alone."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import InputError
from hilbrace.run.records import write_atomic

Array = np.ndarray
Vertices = Float[Array, "vertex 3"]
Triangles = Int[Array, "triangle 3"]
Fields = Mapping[str, Float[Array, " vertex"]]

RUBBER_RGB = (0.16, 0.42, 0.60)
"""Colour of the brace in viewers [-]."""


def write_surface(path: Path, vertices: Vertices, triangles: Triangles, fields: Fields | None = None) -> None:
    """Write a surface in the format that the file's suffix names.

    Args:
        path: File ending in ``.stl``, ``.ply`` or ``.glb``.
        vertices: Positions [mm].
        triangles: Vertex indices, outward.
        fields: Values at the vertices by name; only a PLY file takes them.

    Raises:
        InputError: Another suffix.
    """
    writers = {
        ".stl": stl_bytes,
        ".ply": lambda points, corners: ply_bytes(points, corners, fields),
        ".glb": glb_bytes,
    }
    if path.suffix not in writers:
        raise InputError(
            f"cannot write '{path.suffix}' files", where=str(path), hint=f"use one of {', '.join(writers)}"
        )
    write_atomic(path, writers[path.suffix](vertices, triangles))


def stl_bytes(vertices: Vertices, triangles: Triangles) -> bytes:
    """Binary STL in mm."""
    corners = vertices[triangles].astype("<f4")
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(
        len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]
    )
    facets["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    facets["corners"] = corners
    return b"hilbrace, millimetres".ljust(80) + struct.pack("<I", len(triangles)) + facets.tobytes()


def ply_bytes(vertices: Vertices, triangles: Triangles, fields: Fields | None = None) -> bytes:
    """Binary little-endian PLY in mm, double precision.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices, outward.
        fields: Values at the vertices by name, each a ``float`` property. MeshLab lists them as attributes of
            the vertices and colours a mesh by the one named ``quality``.

    Raises:
        InputError: A field has another number of values than there are vertices.
    """
    fields = fields or {}
    for name, value in fields.items():
        if len(value) != len(vertices):
            raise InputError(
                f"'{name}' has {len(value)} values for {len(vertices)} vertices",
                where="PLY file",
                hint="give one value for each vertex",
            )
    names = "".join(f"property float {name}\n" for name in fields)
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment hilbrace, millimetres\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n{names}"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    kinds = [("place", "<f8", 3), *((name, "<f4") for name in fields)]
    points = np.zeros(len(vertices), dtype=kinds)
    points["place"] = vertices
    for name, value in fields.items():
        points[name] = value
    faces = np.zeros(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    return header.encode("ascii") + points.tobytes() + faces.tobytes()


def glb_bytes(vertices: Vertices, triangles: Triangles) -> bytes:
    """Binary glTF 2.0: coordinates in mm under a node that scales them to metres, as the format asks."""
    positions = vertices.astype("<f4")
    data = positions.tobytes() + triangles.astype("<u4").tobytes()
    colour = [*RUBBER_RGB, 1.0]
    document = {
        "asset": {"version": "2.0", "generator": "hilbrace"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "brace", "mesh": 0, "scale": [0.001, 0.001, 0.001]}],
        "meshes": [
            {"name": "brace", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}
        ],
        "materials": [
            {
                "name": "rubber",
                "pbrMetallicRoughness": {
                    "baseColorFactor": colour,
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.7,
                },
            }
        ],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": positions.nbytes, "target": 34962},
            {"buffer": 0, "byteOffset": positions.nbytes, "byteLength": 12 * len(triangles), "target": 34963},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(vertices),
                "type": "VEC3",
                "min": positions.min(axis=0).tolist(),
                "max": positions.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5125, "count": 3 * len(triangles), "type": "SCALAR"},
        ],
    }
    text = json.dumps(document, sort_keys=True, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(data)
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, total),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(data), b"BIN\0"),
            data,
        ]
    )
