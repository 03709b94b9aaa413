"""Points where the camera's rays meet the projector's.

A projector pixel is first moved onto the epipolar line of the camera's pixel, by the shortest way; then both
rays meet exactly. This uses the axis that tells the depth whatever way the projector stands to the camera,
and the length of the way is a check of the calibration (Hartley & Zisserman 2004, section 12.5, with the
camera's pixel taken as exact).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hilbrace.errors import InputError
from hilbrace.scan.calibration import Calibration, Lens
from hilbrace.scan.decode import Decoded

Array = np.ndarray

MOST_OFF_LINE = 2.5
"""Distance from the epipolar line beyond which a pixel is left out [px of the projector]."""
STALE = 1.5
"""Median distance from which the calibration cannot be of this pair as it stands [px of the projector]."""


@dataclass(frozen=True)
class RangePicture:
    """The surface as one view sees it, in the camera's frame: z along the view, y down.

    Attributes:
        points: Point of each pixel [mm]; not a number where unknown.
        error: Its standard deviation along the ray that the pictures' noise causes [mm].
        colours: Its colour.
        off_line_px: Median distance of the projector's pixels from their epipolar lines [px].
        left_out: Decoded pixels that were too far from their lines.
    """

    points: Float[Array, "row column 3"]
    error: Float[Array, "row column"]
    colours: UInt8[Array, "row column 3"]
    off_line_px: float
    left_out: int

    @property
    def valid(self) -> Bool[Array, "row column"]:
        """Pixels with a point."""
        return np.isfinite(self.points[..., 2])


def triangulate(decoded: Decoded, calibration: Calibration, where: str) -> RangePicture:
    """Points of a decoded view.

    Args:
        decoded: Projector pixels of the view.
        calibration: Camera and projector.
        where: Name of the view, for errors.

    Raises:
        InputError: The pictures have another size than those of the calibration, or do not fit it.
    """
    height, width = decoded.column.shape
    if (width, height) != calibration.camera.size:
        raise InputError(
            f"pictures of {width} x {height} pixels, the calibration is for"
            f" {calibration.camera.size[0]} x {calibration.camera.size[1]}",
            where=where,
            hint="use the camera as it was calibrated, or calibrate again",
        )
    row, column = np.nonzero(decoded.valid)
    ray = _directions(calibration.camera, np.stack([column, row], axis=1).astype(float))
    lit_by = np.stack([decoded.column[row, column], decoded.row[row, column]], axis=1).astype(float)
    beam = _directions(calibration.projector, lit_by)
    turned = ray @ calibration.rotation.T
    beam, off = _onto_lines(beam, turned, calibration.translation)
    off_px = np.abs(off) * calibration.projector.matrix[0, 0]
    middle = float(np.median(off_px)) if len(off_px) else 0.0
    if middle > STALE:
        raise InputError(
            f"the decoded pixels miss their epipolar lines by {middle:.1f} px (median): the calibration is"
            " not of this pair as it stands",
            where=where,
            hint="camera or projector moved, zoomed or was exchanged since the calibration; calibrate again",
        )
    depth = _depth(beam, turned, calibration.translation)
    good = (off_px <= MOST_OFF_LINE) & (depth > 0.0) & np.isfinite(depth)
    points = np.full((height, width, 3), np.nan, dtype=np.float32)
    points[row[good], column[good]] = ray[good] * depth[good, None]
    error = np.full((height, width), np.nan, dtype=np.float32)
    noise_px = decoded.error[row, column]
    slope = _depth_slope(beam, turned, calibration.translation, depth)
    error[row[good], column[good]] = (slope * noise_px / calibration.projector.matrix[0, 0])[good]
    return RangePicture(points, error, decoded.colours, middle, int((~good).sum()))


def _directions(lens: Lens, pixels: Float[Array, "point 2"]) -> Float[Array, "point 3"]:
    """Directions of pixels with z = 1."""
    if not len(pixels):
        return np.zeros((0, 3))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-9)
    flat = cv2.undistortPoints(pixels[:, None, :], lens.matrix, lens.distortion, criteria=criteria)
    return np.concatenate([flat.reshape(-1, 2), np.ones((len(pixels), 1))], axis=1)


def _onto_lines(
    beam: Float[Array, "point 3"], turned: Float[Array, "point 3"], translation: Float[Array, " 3"]
) -> tuple[Float[Array, "point 3"], Float[Array, " point"]]:
    """Beams moved onto their epipolar lines, and how far; in the projector's plane z = 1."""
    line = np.cross(translation, turned)
    length = np.hypot(line[:, 0], line[:, 1])
    off = np.einsum("ij,ij->i", line, beam) / length
    moved = beam.copy()
    moved[:, :2] -= (off / length)[:, None] * line[:, :2]
    return moved, off


def _depth(
    beam: Float[Array, "point 3"], turned: Float[Array, "point 3"], translation: Float[Array, " 3"]
) -> Float[Array, " point"]:
    """Depth t at which t R ray + translation lies on the beam."""
    across = np.cross(beam, turned)
    return -np.einsum("ij,ij->i", across, np.cross(beam, translation)) / np.einsum("ij,ij->i", across, across)


def _depth_slope(
    beam: Float[Array, "point 3"],
    turned: Float[Array, "point 3"],
    translation: Float[Array, " 3"],
    depth: Float[Array, " point"],
) -> Float[Array, " point"]:
    """Change of the depth per change of the beam along its line, in the plane z = 1."""
    point = depth[:, None] * turned + translation
    change = (turned[:, :2] - beam[:, :2] * turned[:, 2:]) / point[:, 2:]
    return 1.0 / np.linalg.norm(change, axis=1)
