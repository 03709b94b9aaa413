"""Triangulation against projections of known points, whatever way the projector stands."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hilbrace.errors import InputError
from hilbrace.scan.calibration import Calibration, Lens
from hilbrace.scan.decode import Decoded
from hilbrace.scan.triangulate import triangulate

SIZE = (90, 70)
CAMERA = Lens(
    SIZE, np.array([[110.0, 0, 44], [0, 112, 36], [0, 0, 1]]), np.array([-0.1, 0.05, 1e-3, -1e-3, 0]), 0.0
)
PROJECTOR = Lens(
    (128, 72),
    np.array([[150.0, 0, 60], [0, 150, 40], [0, 0, 1]]),
    np.array([-0.05, 0.02, -5e-4, 5e-4, 0]),
    0.0,
)


def pair(centre, turn):
    rotation = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    return Calibration(CAMERA, PROJECTOR, rotation, -rotation @ np.array(centre), "", (), 0.0)


def seen_by(calibration, points):
    """What a perfect decoder tells of points, one per pixel."""
    pixels, _ = cv2.projectPoints(
        points.reshape(-1, 3),
        cv2.Rodrigues(calibration.rotation)[0],
        calibration.translation,
        calibration.projector.matrix,
        calibration.projector.distortion,
    )
    column, row = (pixels[:, 0, k].reshape(points.shape[:2]).astype(np.float32) for k in (0, 1))
    lit = np.ones(column.shape, dtype=bool)
    return Decoded(
        column=column,
        row=row,
        error=np.full(column.shape, 0.1, dtype=np.float32),
        colours=np.zeros((*column.shape, 3), dtype=np.uint8),
        even=np.zeros(column.shape, dtype=np.float32),
        lit=lit,
        saturated=~lit,
        noise=1.0,
        contrast=100.0,
        agreement=1.0,
    )


def bumpy_surface():
    """Points on the camera's rays at known depths."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
    rays = cv2.undistortPoints(pixels, CAMERA.matrix, CAMERA.distortion, criteria=stop).reshape(
        SIZE[1], SIZE[0], 2
    )
    depth = 600 + 20 * np.sin(x / 9) + 15 * np.cos(y / 7)
    return np.concatenate([rays, np.ones((SIZE[1], SIZE[0], 1))], axis=-1) * depth[..., None]


@pytest.mark.parametrize(
    ("centre", "turn"),
    [
        ((-160, 0, 0), (0, -14, 0)),
        ((0, 150, 10), (-14, 0, 2)),
        ((100, -90, -20), (8, 9, 5)),
        ((-150, 0, 0), (0, 0, 0)),
    ],
)
def test_points_are_found_whatever_way_the_projector_stands(centre, turn):
    calibration, points = pair(centre, turn), bumpy_surface()
    view = triangulate(seen_by(calibration, points), calibration, "view")
    assert view.valid.all()
    np.testing.assert_allclose(view.points, points, atol=0.02)
    assert view.off_line_px < 1e-3


def test_noise_makes_the_error_that_is_expected():
    calibration, points = pair((-160, 0, 0), (0, -14, 0)), bumpy_surface()
    clean = seen_by(calibration, points)
    random = np.random.default_rng(0)
    noisy = dataclasses.replace(
        clean,
        column=(clean.column + random.normal(0, 0.1, clean.column.shape)).astype(np.float32),
        row=(clean.row + random.normal(0, 0.1, clean.row.shape)).astype(np.float32),
    )
    view = triangulate(noisy, calibration, "view")
    depth_error = view.points[..., 2] - points[..., 2]
    assert depth_error.std() == pytest.approx(float(view.error.mean()), rel=0.1)


def test_pixels_off_their_lines_are_left_out():
    calibration, points = pair((-160, 0, 0), (0, -14, 0)), bumpy_surface()
    clean = seen_by(calibration, points)
    row = clean.row.copy()
    row[10:13, 20:25] += 9.0
    view = triangulate(dataclasses.replace(clean, row=row), calibration, "view")
    assert view.left_out == 15
    assert not view.valid[10:13, 20:25].any()


def test_a_calibration_of_another_pair_is_refused():
    points = bumpy_surface()
    moved = pair((-160, 0, 0), (3, -14, 0))
    with pytest.raises(InputError, match="not of this pair") as fault:
        triangulate(seen_by(pair((-160, 0, 0), (0, -14, 0)), points), moved, "leg_front")
    assert fault.value.where == "leg_front"
    assert "calibrate again" in fault.value.hint


def test_pictures_of_another_size_are_refused():
    calibration = pair((-160, 0, 0), (0, -14, 0))
    decoded = seen_by(calibration, bumpy_surface()[:-2])
    with pytest.raises(InputError, match="90 x 68 pixels, the calibration is for 90 x 70"):
        triangulate(decoded, calibration, "view")


def test_nothing_decoded_gives_nothing():
    calibration = pair((-160, 0, 0), (0, -14, 0))
    decoded = seen_by(calibration, bumpy_surface())
    empty = dataclasses.replace(decoded, column=np.full_like(decoded.column, np.nan))
    assert not triangulate(empty, calibration, "view").valid.any()
