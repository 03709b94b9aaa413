"""The brace in motion as one binary glTF 2.0 file: opens in browsers, Blender and slicers' viewers.

Each frame is a morph target of the rest shape; the animation blends from one to the next at the recording's
speed. The skin's dual-quaternion motion cannot be written as glTF's own skinning, which is linear.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from hilbrace.domain.glb import INDICES, VERTICES, BinaryPart, container
from hilbrace.errors import InputError
from hilbrace.run.records import write_atomic

Array = np.ndarray

RUBBER_RGB = (0.16, 0.42, 0.60)
"""Colour of the brace [-]."""
TO_FRONT = (0.0, -float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5)))
"""Quaternion that turns OpenSim's forward x onto glTF's forward z."""


def write_animation(
    path: Path,
    rest: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    posed: Float[Array, "frame vertex 3"],
    time: Float[Array, " frame"],
) -> None:
    """Write a moving surface as ``.glb``; the bytes depend on the arguments alone.

    Args:
        path: File to write.
        rest: Vertices at rest [mm], x forward, y up.
        triangles: Vertex indices, outward.
        posed: Vertices in each frame [mm].
        time: Instants of the frames [s], ascending; the file starts at zero.

    Raises:
        InputError: There is no frame, or the instants do not ascend.
    """
    write_atomic(path, animation_bytes(rest, triangles, posed, time))


def animation_bytes(
    rest: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    posed: Float[Array, "frame vertex 3"],
    time: Float[Array, " frame"],
) -> bytes:
    """The bytes that `write_animation` writes.

    Raises:
        InputError: There is no frame, or the instants do not ascend.
    """
    if not len(time) or (np.diff(time) <= 0.0).any():
        raise InputError(
            f"{len(time)} frames whose instants do not ascend",
            where="animation of the brace",
            hint="give at least one frame, each later than the one before",
        )
    binary = BinaryPart()
    normal = vertex_normals(rest, triangles)
    primitive = {
        "attributes": {
            "POSITION": binary.add(rest, "VEC3", VERTICES, bounds=True),
            "NORMAL": binary.add(normal, "VEC3", VERTICES),
        },
        "indices": binary.add(triangles.reshape(-1), "SCALAR", INDICES),
        "material": 0,
        "targets": [
            {
                "POSITION": binary.add(points - rest, "VEC3", VERTICES, bounds=True),
                "NORMAL": binary.add(vertex_normals(points, triangles) - normal, "VEC3", VERTICES),
            }
            for points in posed
        ],
    }
    clock = binary.add(time - time[0], "SCALAR", bounds=True)
    shares = binary.add(np.eye(len(time)).reshape(-1), "SCALAR")
    document = _document(primitive, [f"{instant:.3f} s" for instant in time], clock, shares)
    document |= {
        "buffers": [{"byteLength": len(binary.data)}],
        "bufferViews": binary.views,
        "accessors": binary.accessors,
    }
    return container(document, bytes(binary.data))


def vertex_normals(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, "vertex 3"]:
    """Unit normals of the vertices: the mean of their triangles' normals, weighted by area."""
    a, b, c = (vertices[corner] for corner in triangles.T)
    face = np.cross(b - a, c - a)
    corners = triangles.T.ravel()
    total = np.stack([np.bincount(corners, np.tile(axis, 3), len(vertices)) for axis in face.T], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.tile([0.0, 1.0, 0.0], (len(total), 1)), where=length > 0.0)


def _document(primitive: dict[str, Any], names: list[str], clock: int, shares: int) -> dict[str, Any]:
    first = [1.0] + [0.0] * (len(names) - 1)
    return {
        "asset": {"version": "2.0", "generator": "hilbrace"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "brace", "mesh": 0, "scale": [0.001] * 3, "rotation": list(TO_FRONT)}],
        "meshes": [
            {"name": "brace", "primitives": [primitive], "weights": first, "extras": {"targetNames": names}}
        ],
        "materials": [
            {
                "name": "rubber",
                "doubleSided": True,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [*RUBBER_RGB, 1.0],
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.7,
                },
            }
        ],
        "animations": [
            {
                "name": "motion",
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
                "samplers": [{"input": clock, "output": shares, "interpolation": "LINEAR"}],
            }
        ],
    }
