"""Captures of the studio for the tests of structured light, each rendered once in a process."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import igl
import numpy as np

from hilbrace.scan.board import board_picture, parse_board
from hilbrace.scan.calibration import Calibration, Lens
from hilbrace.scan.patterns import PatternPlan, pattern_pictures
from mocks.scan_studio import (
    BOARD_POSES,
    Light,
    Rig,
    Scene,
    Shot,
    board_scene,
    expose,
    leg_scene,
    look,
    make_rig,
)

SMALL = PatternPlan(640, 360)
CAMERA = (480, 360)
BOARD = parse_board("charuco:7x5:30:22")
BOARD_MM = (210.0, 150.0)

Pictures = tuple[np.ndarray, ...]


@cache
def small_rig() -> Rig:
    """A camera of 480 x 360 and a projector of 640 x 360 pixels."""
    return make_rig(CAMERA, (SMALL.width, SMALL.height))


def known(rig: Rig) -> Calibration:
    """The calibration that the studio's pair truly has."""
    camera, projector = (
        Lens(lens.size, lens.matrix, lens.distortion, 0.0) for lens in (rig.camera, rig.projector)
    )
    return Calibration(camera, projector, rig.rotation, rig.translation, BOARD.text, (), 0.0)


@cache
def leg(turn: float = 0.0) -> tuple[Scene, Shot]:
    """A leg, and what the small pair sees of it."""
    scene = leg_scene(turn)
    return scene, look(scene, small_rig())


@cache
def leg_pictures(turn: float = 0.0, plan: PatternPlan = SMALL, light: Light | None = None) -> Pictures:
    """Pictures of a leg by the small pair."""
    return exposed(leg(turn)[1], plan, light or Light(), seed=int(turn))


@cache
def board_pictures(pose: int) -> Pictures:
    """Pictures of the board in a pose by the small pair."""
    shot = look(board_scene(board_picture(BOARD, 6), BOARD_MM, *BOARD_POSES[pose]), small_rig())
    return exposed(shot, SMALL, Light(), seed=pose)


def exposed(shot: Shot, plan: PatternPlan, light: Light, seed: int) -> Pictures:
    """One picture of each pattern."""
    random = np.random.default_rng(seed)
    return tuple(expose(shot, pattern, light, random) for pattern in pattern_pictures(plan))


def store(pictures: Pictures, folder: Path) -> Path:
    """Write pictures as a camera does."""
    folder.mkdir(parents=True)
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"IMG_{number:04d}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return folder


def distances(points: np.ndarray, scene: Scene) -> np.ndarray:
    """Distances of points from the true surface [mm]."""
    squared = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points, dtype=float),
        np.ascontiguousarray(scene.solid.vertices, dtype=float),
        np.ascontiguousarray(scene.solid.faces, dtype=np.int64),
    )[0]
    return np.sqrt(squared)


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
