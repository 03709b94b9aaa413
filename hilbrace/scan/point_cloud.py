"""Clouds of points with normals, colours and expected errors, made from a view and written as PLY."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hilbrace.run.records import write_atomic
from hilbrace.scan.triangulate import RangePicture

Array = np.ndarray

SMOOTHING_PX = 5
"""Side of the square over which points are averaged for normals and for the mesh [px]."""
JUMP_MM = 8.0
"""Step in depth between pixels two apart beyond which they lie on different surfaces [mm]."""
FEWEST_NEIGHBOURS = 4
"""Of eight pixels two apart, how many must lie on the same surface."""
FLATTEST = 0.1
"""Cosine between view and normal below which a surface is seen too flat to be trusted [-]."""

UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""From the camera's axes (y down, z away) to those of the files: y up, z towards the camera."""

_RECORD = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [("error_mm", "<f4")]
)
_TYPES = {"<f4": "float", "|u1": "uchar"}


@dataclass(frozen=True)
class PointCloud:
    """Points of a surface [mm].

    Attributes:
        points: Positions [mm].
        normals: Unit normals towards the side that was seen.
        colours: Red, green and blue.
        error: Standard deviation of each point along its ray [mm].
    """

    points: Float[Array, "point 3"]
    normals: Float[Array, "point 3"]
    colours: UInt8[Array, "point 3"]
    error: Float[Array, " point"]

    def moved(self, rotation: Float[Array, "3 3"], shift: Float[Array, " 3"]) -> PointCloud:
        """The cloud after x -> R x + shift."""
        return PointCloud(
            (self.points @ rotation.T + shift).astype(np.float32),
            (self.normals @ rotation.T).astype(np.float32),
            self.colours,
            self.error,
        )

    def thinned(self, most: int) -> PointCloud:
        """Every n-th point, so that no more than ``most`` are left."""
        step = max(1, -(-len(self.points) // most))
        return PointCloud(self.points[::step], self.normals[::step], self.colours[::step], self.error[::step])


@dataclass(frozen=True)
class SmoothView:
    """A view averaged over small squares, on its pixels, in the camera's frame.

    Attributes:
        points: Mean of the points around [mm]; not a number where unknown.
        normals: Unit normals towards the camera.
        cosine: Cosine between the normal and the direction to the camera [-].
        error: Expected error of single points [mm].
        valid: Pixels whose own point counts.
    """

    points: Float[Array, "row column 3"]
    normals: Float[Array, "row column 3"]
    cosine: Float[Array, "row column"]
    error: Float[Array, "row column"]
    valid: Bool[Array, "row column"]


def smooth_view(view: RangePicture, depth_mm: tuple[float, float] = (0.0, np.inf)) -> SmoothView:
    """Normals and means of a view; pixels beside edges, and surfaces seen too flat, are left out.

    Args:
        view: The view.
        depth_mm: Nearest and farthest depth that counts [mm].
    """
    depth = view.points[..., 2]
    with np.errstate(invalid="ignore"):
        inside = (depth >= depth_mm[0]) & (depth <= depth_mm[1])
    inside &= _on_a_surface(np.where(inside, depth, np.float32(np.nan)))
    points = _mean(view.points, inside)
    down, right = np.full_like(points, np.nan), np.full_like(points, np.nan)
    down[2:-2] = points[4:] - points[:-4]
    right[:, 2:-2] = points[:, 4:] - points[:, :-4]
    normals = np.cross(down, right)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        cosine = -np.einsum("ijk,ijk->ij", normals, points) / np.linalg.norm(points, axis=-1)
        normals = np.where((cosine < 0.0)[..., None], -normals, normals)
        valid = inside & (np.abs(cosine) >= FLATTEST)
    return SmoothView(points, normals, np.abs(cosine), view.error, valid)


def view_cloud(view: RangePicture, smooth: SmoothView) -> PointCloud:
    """The trusted points of a view in the axes of the files; points as measured, normals smoothed."""
    valid = smooth.valid
    cloud = PointCloud(view.points[valid], smooth.normals[valid], view.colours[valid], view.error[valid])
    return cloud.moved(UPRIGHT, np.zeros(3))


def joined(clouds: Sequence[PointCloud]) -> PointCloud:
    """All points of several clouds."""
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]),
        np.concatenate([cloud.normals for cloud in clouds]),
        np.concatenate([cloud.colours for cloud in clouds]),
        np.concatenate([cloud.error for cloud in clouds]),
    )


def write_cloud(cloud: PointCloud, path: Path) -> None:
    """Write a cloud as binary PLY [mm]: positions, normals, colours and ``error_mm``."""
    rows = np.empty(len(cloud.points), dtype=_RECORD)
    for name, values in zip("xyz", cloud.points.T, strict=True):
        rows[name] = values
    for name, values in zip(("nx", "ny", "nz"), cloud.normals.T, strict=True):
        rows[name] = values
    for name, values in zip(("red", "green", "blue"), cloud.colours.T, strict=True):
        rows[name] = values
    rows["error_mm"] = cloud.error
    head = ["ply", "format binary_little_endian 1.0", "comment unit mm, y up, z towards the first camera"]
    head.append(f"element vertex {len(rows)}")
    head += [f"property {_TYPES[_RECORD[name].str]} {name}" for name in _RECORD.names or ()]
    write_atomic(path, ("\n".join([*head, "end_header"]) + "\n").encode() + rows.tobytes())


def _on_a_surface(depth: Float[Array, "row column"]) -> Bool[Array, "row column"]:
    """Pixels with enough neighbours at nearly the same depth."""
    padded = np.pad(depth, 2, constant_values=np.nan)
    height, width = depth.shape
    count = np.zeros(depth.shape, dtype=np.uint8)
    with np.errstate(invalid="ignore"):
        for dy in (0, 2, 4):
            for dx in (0, 2, 4):
                if (dy, dx) != (2, 2):
                    count += np.abs(padded[dy : dy + height, dx : dx + width] - depth) < JUMP_MM
    return count >= FEWEST_NEIGHBOURS


def _mean(
    points: Float[Array, "row column 3"], inside: Bool[Array, "row column"]
) -> Float[Array, "row column 3"]:
    """Mean over the known points of the square around each pixel that lie at nearly its depth."""
    size = (SMOOTHING_PX, SMOOTHING_PX)
    weight = inside.astype(np.float32)
    filled = np.where(inside[..., None], points, np.float32(0.0))
    total = cv2.boxFilter(weight, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    summed = cv2.boxFilter(filled, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.asarray(summed, dtype=np.float32) / np.asarray(total, dtype=np.float32)[..., None]
        # At the border of the known the mean leans inwards: it slides along the surface to the pixel's ray.
        near = np.abs(mean[..., 2] - points[..., 2]) < JUMP_MM
    return np.where((inside & near)[..., None], mean, np.float32(np.nan))
