"""A picture that shows whether a view was decoded well: seen, lit from, expected error, shape."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hilbrace.run.records import write_atomic
from hilbrace.scan.decode import Decoded
from hilbrace.scan.point_cloud import SmoothView
from hilbrace.scan.triangulate import RangePicture

Array = np.ndarray

WORST_MM = 0.5
"""Expected error that is drawn in the last colour [mm]."""
STRIPE_PX = 64
"""Columns of the projector after which the colours of the columns repeat."""


def write_view_picture(decoded: Decoded, view: RangePicture, smooth: SmoothView, path: Path) -> None:
    """Write four pictures in one: white light, projector columns and masks, expected error, shape."""
    valid = smooth.valid
    hue = np.where(decoded.valid, np.mod(decoded.column, STRIPE_PX) / STRIPE_PX, 0.0)
    columns = _coloured(hue, cv2.COLORMAP_HSV)
    columns[~decoded.valid] = 0
    columns[decoded.lit & ~decoded.valid] = (90, 90, 90)
    columns[decoded.saturated] = (255, 255, 255)
    error = _coloured(np.nan_to_num(view.error) / WORST_MM, cv2.COLORMAP_VIRIDIS)
    error[~valid] = 0
    light = np.array([0.3, -0.5, -0.8]) / np.linalg.norm([0.3, -0.5, -0.8])
    with np.errstate(invalid="ignore"):
        shade = 0.15 + 0.85 * np.clip(smooth.normals @ light, 0.0, 1.0)
    shape = np.repeat(np.where(valid, 255.0 * shade, 0.0).astype(np.uint8)[..., None], 3, axis=2)
    panels = [
        _named(np.ascontiguousarray(decoded.colours[..., ::-1]), "white light"),
        _named(columns, f"projector column, colours repeat after {STRIPE_PX}; grey lost, white over-exposed"),
        _named(error, f"expected error, 0 to {WORST_MM:g} mm"),
        _named(shape, "shape"),
    ]
    sheet = np.vstack([np.hstack(panels[:2]), np.hstack(panels[2:])])
    write_atomic(path, cv2.imencode(".png", sheet)[1].tobytes())


def _coloured(part: Float[Array, "row column"], palette: int) -> UInt8[Array, "row column 3"]:
    grey = np.clip(255.0 * part, 0.0, 255.0).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(grey, palette), dtype=np.uint8)


def _named(panel: UInt8[Array, "row column 3"], name: str) -> UInt8[Array, "row column 3"]:
    size = max(0.4, panel.shape[1] / 1600)
    place = (round(14 * size), round(28 * size))
    cv2.putText(panel, name, place, cv2.FONT_HERSHEY_SIMPLEX, size, (255, 255, 255), 1, cv2.LINE_AA)
    return panel
