"""The process that opens C3D files: where ezc3d crashes or hangs, it takes only this process along.

It is started as a script and imports nothing of hilbrace. Each line on standard input is the path of a file
(as a JSON text); each answer is a length (8 bytes) and an ``.npz`` archive. The first answer, which is
empty, says that the imports are done.
"""

from __future__ import annotations

import io
import json
import os
import struct
import sys
from typing import Any, BinaryIO

try:
    import resource
except ImportError:  # a system without limits
    resource = None

OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "MODELED_MARKERS")
"""Parameters of POINT that list trajectories which a model computed."""

LENGTH = struct.Struct("<Q")


def limit_memory(size: int) -> None:
    """Let this process take no more than so much address space [bytes]."""
    if resource is not None:
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def private_output() -> BinaryIO:
    """The standard output for answers alone; what libraries print goes nowhere."""
    answers = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    return answers


def read(ezc3d: Any, path: str) -> dict[str, Any]:
    """Arrays and texts of one file, as ezc3d gives them, frames first."""
    content = ezc3d.c3d(path, extract_forceplat_data=True)
    parameters, data = content["parameters"], content["data"]
    points = {key: entry["value"] for key, entry in parameters["POINT"].items() if "value" in entry}
    found: dict[str, Any] = {
        "points": data["points"][:3].transpose(2, 1, 0),
        "residuals": data["meta_points"]["residuals"][0].T,
        "point_rate": float(content["header"]["points"]["frame_rate"]),
        "first_frame": int(content["header"]["points"]["first_frame"]),
        "analog_rate": float(content["header"]["analogs"]["frame_rate"]),
        "labels": gather(points, "LABELS"),
        "outputs": [name for group in OUTPUTS for name in gather(points, group)],
        "units": str((list(points.get("UNITS", [])) or [""])[0]),
        "plates": len(data["platform"]),
        **measurements(parameters.get("PROCESSING", {})),
    }
    for k, plate in enumerate(data["platform"]):
        for key in ("force", "moment", "center_of_pressure", "Tz", "corners"):
            found[f"plate{k}_{key}"] = plate[key].T
        for key in ("unit_force", "unit_moment", "unit_position"):
            found[f"plate{k}_{key}"] = str(plate[key])
    return found


def measurements(group: dict[str, Any]) -> dict[str, Any]:
    """Names and values of the single numbers in a group."""
    numbers = {}
    for name, entry in group.items():
        value = entry.get("value") if isinstance(entry, dict) else None
        if value is not None and len(value) == 1 and not isinstance(value[0], str):
            numbers[name] = float(value[0])
    return {"measured": list(numbers), "measurements": list(numbers.values())}


def gather(points: dict[str, Any], key: str) -> list[str]:
    """Texts of a parameter that goes on in ``KEY2``, ``KEY3``, ... beyond 255 entries."""
    texts: list[str] = []
    suffix = 1
    while (name := key if suffix == 1 else f"{key}{suffix}") in points:
        texts += [str(text) for text in points[name]]
        suffix += 1
    return texts


def main() -> None:
    """Answer until the input ends."""
    answers = private_output()
    limit_memory(int(sys.argv[1]))
    import ezc3d
    import numpy as np

    answers.write(LENGTH.pack(0))
    answers.flush()
    for line in sys.stdin:
        stream = io.BytesIO()
        try:
            np.savez(stream, **read(ezc3d, json.loads(line)))
        except Exception as fault:  # noqa: BLE001 - whatever a foreign reader raises is the answer
            stream = io.BytesIO()
            np.savez(stream, fault=f"{type(fault).__name__}: {fault}"[:300])
        content = stream.getvalue()
        answers.write(LENGTH.pack(len(content)))
        answers.write(content)
        answers.flush()


if __name__ == "__main__":
    main()
