"""The brace in motion as one binary glTF 2.0 file: opens in browsers, Blender and slicers' viewers.

Each frame is a morph target of the rest shape; the animation blends from one to the next at the recording's
speed. The skin's dual-quaternion motion cannot be written as glTF's own skinning, which is linear.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import InputError
from hilbrace.run.records import write_atomic

Array = np.ndarray

RUBBER_RGB = (0.16, 0.42, 0.60)
"""Colour of the brace [-]."""
TO_FRONT = (0.0, -float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5)))
"""Quaternion that turns OpenSim's forward x onto glTF's forward z."""

_FLOAT, _UNSIGNED = 5126, 5125
_VERTICES, _INDICES = 34962, 34963


@dataclass
class _Binary:
    """The binary part of a file under construction: views and accessors into one buffer."""

    data: bytearray = field(default_factory=bytearray)
    views: list[dict[str, int]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def add(self, values: Array, kind: str, target: int | None = None, bounds: bool = False) -> int:
        """Append an array of one or three columns and return the number of its accessor."""
        raw = np.ascontiguousarray(values, dtype="<u4" if values.dtype.kind in "iu" else "<f4")
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": raw.nbytes}
        if target is not None:
            view["target"] = target
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": _UNSIGNED if raw.dtype.kind == "u" else _FLOAT,
            "count": len(raw),
            "type": kind,
        }
        if bounds:
            rows = raw.reshape(len(raw), -1)
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.data += raw.tobytes()
        self.views.append(view)
        self.accessors.append(accessor)
        return len(self.accessors) - 1


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
    binary = _Binary()
    normal = vertex_normals(rest, triangles)
    primitive = {
        "attributes": {
            "POSITION": binary.add(rest, "VEC3", _VERTICES, bounds=True),
            "NORMAL": binary.add(normal, "VEC3", _VERTICES),
        },
        "indices": binary.add(triangles.reshape(-1), "SCALAR", _INDICES),
        "material": 0,
        "targets": [
            {
                "POSITION": binary.add(points - rest, "VEC3", _VERTICES, bounds=True),
                "NORMAL": binary.add(vertex_normals(points, triangles) - normal, "VEC3", _VERTICES),
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
    return _container(document, bytes(binary.data))


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


def _container(document: dict[str, Any], data: bytes) -> bytes:
    """JSON and binary chunk of a ``.glb`` file, each filled up to four bytes."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
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
