"""Camera and projector as two pinholes with distortion, how they stand to each other, and a file for it."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.run.records import write_atomic

Array = np.ndarray

MEND = "write the file anew with 'hilbrace scan calibrate'"

HEAD = """# Camera and projector as 'hilbrace scan calibrate' found them. A point x of the camera's frame
# [mm], z along its view, y down, is rotation x + translation_mm in the projector's. Focal lengths and
# principal points in pixels, middles of pixels at whole numbers; distortion k1, k2, p1, p2, k3 as OpenCV has
# them; errors are root mean squares in pixels.
"""


@dataclass(frozen=True)
class Lens:
    """A pinhole with OpenCV's distortion; a projector is one whose light runs backwards.

    Attributes:
        size: Width and height [px].
        matrix: Focal lengths and principal point [px].
        distortion: k1, k2, p1, p2, k3 [-].
        rms_px: Root mean square distance of the calibration's corners from where the lens has them [px].
    """

    size: tuple[int, int]
    matrix: Float[Array, "3 3"]
    distortion: Float[Array, " coefficient"]
    rms_px: float


@dataclass(frozen=True)
class Pose:
    """One pose of the board in a calibration.

    Attributes:
        folder: Name of its folder.
        corners: Corners that were used.
        camera_px: Root mean square error in the camera [px].
        projector_px: Root mean square error in the projector [px].
    """

    folder: str
    corners: int
    camera_px: float
    projector_px: float


@dataclass(frozen=True)
class Calibration:
    """A calibrated pair; a point x of the camera's frame [mm] is R x + t in the projector's.

    Attributes:
        camera: The camera.
        projector: The projector.
        rotation: R.
        translation: t [mm].
        board: The board's description.
        poses: The poses that were used.
        rms_px: Root mean square error over both, poses and pair adjusted together [px].
    """

    camera: Lens
    projector: Lens
    rotation: Float[Array, "3 3"]
    translation: Float[Array, " 3"]
    board: str
    poses: tuple[Pose, ...]
    rms_px: float

    @property
    def base_mm(self) -> float:
        """Distance of camera and projector [mm]."""
        return float(np.linalg.norm(self.translation))


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write a calibration as TOML, one matrix a line."""
    poses = [
        {**vars(pose), "camera_px": round(pose.camera_px, 4), "projector_px": round(pose.projector_px, 4)}
        for pose in calibration.poses
    ]
    parts = [
        HEAD + _lines({"board": calibration.board, "rms_px": round(calibration.rms_px, 4)}),
        "[camera]\n" + _lines(_lens_table(calibration.camera)),
        "[projector]\n" + _lines(_lens_table(calibration.projector)),
        "[pair]\n"
        + _lines(
            {
                "rotation": calibration.rotation.tolist(),
                "translation_mm": calibration.translation.tolist(),
                "base_mm": round(calibration.base_mm, 2),
            }
        ),
        *("[[pose]]\n" + _lines(pose) for pose in poses),
    ]
    write_atomic(path, "\n".join(parts).encode())


def _lines(table: dict[str, Any]) -> str:
    """Keys and values, a line each; text, numbers and lists read alike in JSON and TOML."""
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())


def read_calibration(path: Path) -> Calibration:
    """Read what `save_calibration` wrote.

    Raises:
        InputError: There is no such file, or it is no calibration.
    """
    if not path.is_file():
        raise InputError(
            "no such calibration: this pair of camera and projector is not calibrated",
            where=str(path),
            hint="photograph a board in ten poses and run 'hilbrace scan calibrate' first",
        )
    try:
        content = tomllib.loads(path.read_text("utf-8"))
        calibration = _from_tables(content)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, KeyError, TypeError, ValueError) as fault:
        raise InputError(
            f"not a calibration: {type(fault).__name__} {fault}", where=str(path), hint=MEND
        ) from fault
    _check(calibration, str(path))
    return calibration


def _lens_table(lens: Lens) -> dict[str, Any]:
    return {
        "size": list(lens.size),
        "matrix": lens.matrix.tolist(),
        "distortion": lens.distortion.tolist(),
        "rms_px": round(lens.rms_px, 4),
    }


def _lens(table: dict[str, Any]) -> Lens:
    width, height = (int(side) for side in table["size"])
    return Lens(
        (width, height),
        np.array(table["matrix"], dtype=float).reshape(3, 3),
        np.array(table["distortion"], dtype=float).reshape(5),
        float(table["rms_px"]),
    )


def _from_tables(content: dict[str, Any]) -> Calibration:
    return Calibration(
        camera=_lens(content["camera"]),
        projector=_lens(content["projector"]),
        rotation=np.array(content["pair"]["rotation"], dtype=float).reshape(3, 3),
        translation=np.array(content["pair"]["translation_mm"], dtype=float).reshape(3),
        board=str(content["board"]),
        poses=tuple(
            Pose(str(p["folder"]), int(p["corners"]), float(p["camera_px"]), float(p["projector_px"]))
            for p in content.get("pose", [])
        ),
        rms_px=float(content["rms_px"]),
    )


def _check(calibration: Calibration, where: str) -> None:
    rotation = calibration.rotation
    turned = np.isfinite(rotation).all() and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    faults = {
        "pair.rotation is no rotation": not turned or np.linalg.det(rotation) < 0.0,
        "pair.translation_mm is no place beside the camera": not 1.0 < calibration.base_mm < 1e5,
    }
    for name, lens in (("camera", calibration.camera), ("projector", calibration.projector)):
        matrix = lens.matrix
        focal = np.array([matrix[0, 0], matrix[1, 1]])
        usual = np.isfinite(matrix).all() and (focal > 0.1 * max(lens.size)).all()
        faults[f"{name}.matrix is no lens for {lens.size[0]} x {lens.size[1]} pixels"] = (
            not usual or abs(matrix[2, 2] - 1.0) > 1e-9 or not np.isfinite(lens.distortion).all()
        )
    for what, wrong in faults.items():
        if wrong:
            raise InputError(what, where=where, hint=MEND)
