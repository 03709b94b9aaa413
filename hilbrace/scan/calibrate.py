"""Calibration of a camera and a projector from decoded pictures of a board.

Every corner that the camera sees is carried into the projector by the homography of its own neighbourhood,
fitted to the decoded pixels around it (Moreno & Taubin 2012, section 3.3), so that lens distortion of neither
spoils it. With corners in both, the projector is calibrated as a camera is (Zhang 2000), and the pair as two
cameras are, all poses adjusted together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hilbrace.errors import InputError
from hilbrace.scan.board import Board, find_corners
from hilbrace.scan.calibration import Calibration, Lens, Pose
from hilbrace.scan.decode import Decoded

Array = np.ndarray

FEWEST_POSES = 4
FEWEST_CORNERS = 8
FEWEST_PIXELS = 40
"""Decoded pixels around a corner from which its homography is fitted."""
LEAST_SIDE = 0.25
"""Part of the decoded pixels that must lie on either side of a corner, across and down [-]."""
WINDOW = 0.6
"""Half the side of the neighbourhood, in distances to the next corner [-]."""
ODD_CORNER = 5.0
"""Distance from the board's homography, in medians, from which a corner is left out [-]."""
ODD_POSE = 3.0
"""Error of a pose, in medians over all poses, from which it is left out [-]."""
LARGEST_RMS = 1.5
"""Error over all from which a calibration is refused [px]."""
LOOSEST_FOCUS = 0.02
"""Standard deviation of a focal length from which the poses are too alike [-]."""

FLAGS = cv2.CALIB_FIX_K3
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)


@dataclass(frozen=True)
class SeenBoard:
    """Corners of the board in one pose.

    Attributes:
        folder: Name of the pose.
        numbers: Numbers of the corners on the board.
        camera: Their pixels in the camera.
        projector: Their pixels in the projector.
    """

    folder: str
    numbers: Int[Array, " corner"]
    camera: Float[Array, "corner 2"]
    projector: Float[Array, "corner 2"]


def see_board(decoded: Decoded, board: Board, folder: Path) -> SeenBoard:
    """Corners of the board in a decoded capture; those without enough decoded pixels around are left out.

    Raises:
        InputError: Too few corners are found, or too few of them are decoded.
    """
    numbers, corners = _flat(board, *find_corners(board, _full_range(decoded.even)))
    if len(numbers) < FEWEST_CORNERS:
        raise InputError(
            f"{len(numbers)} of the {board.corner_count} corners of {board.text} are in the pictures",
            where=str(folder),
            hint="show the whole board, sharp and evenly lit; is --board the board that was printed?",
        )
    places = [
        _in_projector(decoded, corner, radius) for corner, radius in _neighbourhoods(board, numbers, corners)
    ]
    good = np.array([place is not None for place in places])
    if good.sum() < FEWEST_CORNERS:
        raise InputError(
            f"the projector lights {good.sum()} of the {len(numbers)} corners that the camera sees",
            where=str(folder),
            hint="hold the board into the middle of the beam; its black must reflect a little",
        )
    carried = np.array([place for place in places if place is not None])
    return SeenBoard(folder.name, numbers[good], corners[good], carried)


def calibrate_pair(
    seen: Sequence[SeenBoard], board: Board, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> tuple[Calibration, tuple[str, ...]]:
    """Both lenses and how one stands to the other.

    Args:
        seen: The board in several poses.
        board: The board.
        camera_size: Width and height of the camera's pictures [px].
        projector_size: Width and height of the projector [px].

    Returns:
        The calibration, and the poses that were left out because they do not fit the others.

    Raises:
        InputError: There are too few poses, they are too alike, or they contradict each other.
    """
    _check_number(seen)
    camera, camera_errors = _lens(seen, board, [pose.camera for pose in seen], camera_size, "camera")
    projector, projector_errors = _lens(
        seen, board, [pose.projector for pose in seen], projector_size, "projector"
    )
    odd = _odd(camera_errors) | _odd(projector_errors)
    if odd.any():
        kept = [pose for pose, out in zip(seen, odd, strict=True) if not out]
        calibration, more = calibrate_pair(kept, board, camera_size, projector_size)
        return calibration, (*(pose.folder for pose, out in zip(seen, odd, strict=True) if out), *more)
    return _together(seen, board, camera, projector), ()


def _together(seen: Sequence[SeenBoard], board: Board, camera: Lens, projector: Lens) -> Calibration:
    """Lenses, poses and pair adjusted together."""
    rms, k1, d1, k2, d2, rotation, translation, _, _, _, _, errors = cv2.stereoCalibrateExtended(
        _places(seen, board),
        [pose.camera.astype(np.float32) for pose in seen],
        [pose.projector.astype(np.float32) for pose in seen],
        camera.matrix.copy(),
        camera.distortion.copy(),
        projector.matrix.copy(),
        projector.distortion.copy(),
        camera.size,
        np.eye(3),
        np.zeros(3),
        flags=FLAGS | cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=_STOP,
    )
    if rms > LARGEST_RMS:
        raise InputError(
            f"corners miss by {rms:.1f} px when camera and projector are adjusted together",
            where="calibration",
            hint="did the camera, the projector or its keystone change between the poses?",
        )
    errors = np.asarray(errors).reshape(len(seen), 2)
    counts = np.array([len(pose.numbers) for pose in seen])
    overall = np.sqrt((errors**2 * counts[:, None]).sum(axis=0) / counts.sum())
    poses = tuple(
        Pose(pose.folder, len(pose.numbers), float(one), float(other))
        for pose, (one, other) in zip(seen, errors, strict=True)
    )
    return Calibration(
        camera=replace(camera, matrix=np.asarray(k1), distortion=_five(d1), rms_px=float(overall[0])),
        projector=replace(projector, matrix=np.asarray(k2), distortion=_five(d2), rms_px=float(overall[1])),
        rotation=np.asarray(rotation),
        translation=np.asarray(translation).ravel(),
        board=board.text,
        poses=poses,
        rms_px=float(rms),
    )


def _lens(
    seen: Sequence[SeenBoard],
    board: Board,
    pixels: Sequence[Float[Array, "_ 2"]],
    size: tuple[int, int],
    name: str,
) -> tuple[Lens, Float[Array, " pose"]]:
    """One lens from its own pixels, and the error of each pose [px]."""
    try:
        rms, matrix, distortion, _, _, spread, _, errors = cv2.calibrateCameraExtended(
            _places(seen, board),
            [pixel.astype(np.float32) for pixel in pixels],
            size,
            np.eye(3),
            np.zeros(5),
            flags=FLAGS,
            criteria=_STOP,
        )
    except cv2.error as fault:
        raise InputError(
            f"no {name} fits the poses: {fault.err}",
            where="calibration",
            hint="tilt the board up to 40 degrees to all sides",
        ) from None
    focal = np.array([matrix[0, 0], matrix[1, 1]])
    loose = np.asarray(spread).ravel()[:2] / focal
    if not np.isfinite(loose).all() or loose.max() > LOOSEST_FOCUS:
        raise InputError(
            f"the poses leave the {name}'s focal length open by {100 * loose.max():.0f} %, being too alike",
            where="calibration",
            hint="add poses that are tilted 20 to 40 degrees to all four sides, near and far",
        )
    return Lens(size, np.asarray(matrix), _five(distortion), float(rms)), np.asarray(errors).ravel()


def _five(distortion: object) -> Float[Array, " coefficient"]:
    return np.asarray(distortion, dtype=float).ravel()[:5]


def _places(seen: Sequence[SeenBoard], board: Board) -> list[Float[Array, "_ 3"]]:
    return [board.corner_places(pose.numbers).astype(np.float32) for pose in seen]


def _odd(errors: Float[Array, " pose"]) -> Bool[Array, " pose"]:
    """Poses that are far worse than most."""
    return errors > np.maximum(ODD_POSE * np.median(errors), 0.5)


def _check_number(seen: Sequence[SeenBoard]) -> None:
    if len(seen) < FEWEST_POSES:
        raise InputError(
            f"{len(seen)} usable poses of the board; {FEWEST_POSES} are the least, ten are good",
            where="calibration",
            hint="photograph the board in more poses, tilted to all sides, near and far",
        )


def _full_range(picture: Float[Array, "row column"]) -> UInt8[Array, "row column"]:
    """A picture from black to white, so that rounding to whole levels costs least."""
    low, high = np.quantile(picture, (0.01, 0.995))
    return np.clip(np.rint((picture - low) / max(high - low, 1.0) * 255.0), 0, 255).astype(np.uint8)


def _flat(
    board: Board, numbers: Int[Array, " corner"], corners: Float[Array, "corner 2"]
) -> tuple[Int[Array, " kept"], Float[Array, "kept 2"]]:
    """Corners without those far off the homography of the whole board, which a shadow's border misplaces."""
    if len(numbers) < FEWEST_CORNERS:
        return numbers, corners
    flat = board.corner_places(numbers)[:, :2]
    off = cv2.perspectiveTransform(flat[None], cv2.findHomography(flat, corners, cv2.LMEDS)[0])[0] - corners
    distance = np.linalg.norm(off, axis=1)
    kept = distance <= np.maximum(ODD_CORNER * np.median(distance), 0.3)
    return numbers[kept], corners[kept]


def _neighbourhoods(
    board: Board, numbers: Int[Array, " corner"], corners: Float[Array, "corner 2"]
) -> list[tuple[Float[Array, " 2"], float]]:
    """Each corner with the half side of its neighbourhood [px]: the board's own scale in the picture."""
    flat = board.corner_places(numbers)[:, :2]
    scale = cv2.findHomography(flat, corners, 0)[0]
    sides = []
    for place, corner in zip(flat, corners, strict=True):
        steps = place + board.square_mm * np.array([[1.0, 0.0], [0.0, 1.0]])
        ends = cv2.perspectiveTransform(steps[None], scale)[0]
        sides.append((corner, WINDOW * float(np.linalg.norm(ends - corner, axis=1).min())))
    return sides


def _in_projector(decoded: Decoded, corner: Float[Array, " 2"], radius: float) -> Float[Array, " 2"] | None:
    """The projector's pixel at a corner, by the homography of the pixels around it."""
    height, width = decoded.column.shape
    x0, y0 = np.maximum(np.floor(corner - radius), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(corner + radius), [width - 1, height - 1]).astype(int)
    column, row = decoded.column[y0 : y1 + 1, x0 : x1 + 1], decoded.row[y0 : y1 + 1, x0 : x1 + 1]
    y, x = np.nonzero(np.isfinite(column))
    seen = np.stack([x + x0, y + y0], axis=1) - corner
    share = (seen < 0.0).mean(axis=0) if len(seen) else np.zeros(2)
    if len(seen) < FEWEST_PIXELS or share.min() < LEAST_SIDE or share.max() > 1.0 - LEAST_SIDE:
        return None
    lit_by = np.stack([column[y, x], row[y, x]], axis=1).astype(float)
    middle = lit_by.mean(axis=0)
    transform = cv2.findHomography(seen, lit_by - middle, 0)[0]
    if transform is None:
        return None
    off = cv2.perspectiveTransform(seen[None], transform)[0] + middle - lit_by
    distance = np.linalg.norm(off, axis=1)
    kept = distance <= 3.0 * np.median(distance)
    transform = cv2.findHomography(seen[kept], (lit_by - middle)[kept], 0)[0]
    if transform is None:
        return None
    return transform[:2, 2] / transform[2, 2] + middle
