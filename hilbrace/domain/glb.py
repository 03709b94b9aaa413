"""Parts of a binary glTF 2.0 file (.glb): the buffer with its views and accessors, and the container."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray

VERTICES, INDICES = 34962, 34963
"""Targets of buffer views."""
_FLOAT, _UNSIGNED = 5126, 5125


@dataclass
class BinaryPart:
    """The binary part of a file under construction: views and accessors into one buffer."""

    data: bytearray = field(default_factory=bytearray)
    views: list[dict[str, int]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def add(
        self,
        values: Float[Array, "..."] | Int[Array, "..."],
        kind: str,
        target: int | None = None,
        bounds: bool = False,
    ) -> int:
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


def container(document: dict[str, Any], data: bytes) -> bytes:
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
