"""Boards, calibration from rendered captures, and the file that a calibration lives in."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hilbrace.errors import ConfigError, InputError
from hilbrace.scan.board import Board, board_picture, find_corners, parse_board, write_board
from hilbrace.scan.calibrate import SeenBoard, calibrate_pair, see_board
from hilbrace.scan.calibration import read_calibration, save_calibration
from hilbrace.scan.capture import open_capture
from hilbrace.scan.decode import decode_capture
from hilbrace.scan.patterns import PatternPlan, pattern_pictures
from hilbrace.scan.triangulate import triangulate
from mocks.scan_studio import BOARD_POSES, board_scene, leg_scene, make_rig, photograph
from tests.unit.scan_scenes import (
    BOARD,
    BOARD_MM,
    CAMERA,
    SMALL,
    board_pictures,
    distances,
    known,
    leg_pictures,
    rms,
    small_rig,
    store,
)

PROJECTOR = (SMALL.width, SMALL.height)


def ideal_poses(board=BOARD, noise=0.05, seed=0, poses=BOARD_POSES, turns=None):
    """Corners projected through the studio's true lenses."""
    rig, random, seen = small_rig(), np.random.default_rng(seed), []
    numbers = np.arange(board.corner_count)
    middle = np.array([*(0.5 * board.square_mm * side for side in board.squares), 0.0])
    for number, (tilt, place) in enumerate(poses):
        rotation = Rotation.from_euler("xyz", tilt, degrees=True).as_matrix()
        points = (board.corner_places(numbers) - middle) @ rotation.T + place
        beam = points @ rig.rotation.T + rig.translation
        pixels = [rig.camera.project(points), rig.projector.project(beam)]
        noisy = [pixel + random.normal(0, noise, pixel.shape) for pixel in pixels]
        seen.append(SeenBoard(f"pose_{number:02d}", numbers, *noisy))
    return seen


def test_the_true_pair_is_found_from_its_corners():
    calibration, left_out = calibrate_pair(ideal_poses(noise=0.01), BOARD, CAMERA, PROJECTOR)
    rig = small_rig()
    assert left_out == ()
    np.testing.assert_allclose(calibration.camera.matrix, rig.camera.matrix, atol=0.5)
    np.testing.assert_allclose(calibration.projector.matrix, rig.projector.matrix, atol=0.7)
    np.testing.assert_allclose(calibration.translation, rig.translation, atol=0.3)
    np.testing.assert_allclose(calibration.rotation, rig.rotation, atol=1e-3)
    assert calibration.rms_px == pytest.approx(0.01 * np.sqrt(2), rel=0.15)


def test_a_pose_that_moved_is_left_out():
    seen = ideal_poses()
    seen[4] = dataclasses.replace(
        seen[4], projector=seen[4].projector * [1.0, 1.02] + np.sin(seen[4].camera / 20) * 4
    )
    calibration, left_out = calibrate_pair(seen, BOARD, CAMERA, PROJECTOR)
    assert left_out == ("pose_04",)
    assert len(calibration.poses) == len(seen) - 1
    assert calibration.rms_px < 0.1


def test_too_few_and_too_similar_poses_are_refused():
    with pytest.raises(InputError, match="3 usable poses"):
        calibrate_pair(ideal_poses()[:3], BOARD, CAMERA, PROJECTOR)
    flat = [((0, 0, angle), (angle, -angle, 600)) for angle in range(0, 25, 5)]
    with pytest.raises(InputError, match="too alike"):
        calibrate_pair(ideal_poses(poses=flat, noise=0.2), BOARD, CAMERA, PROJECTOR)


def test_a_pair_that_changed_between_poses_is_refused():
    seen = ideal_poses()
    shifted = [
        dataclasses.replace(pose, projector=pose.projector + np.array([0.0, 25.0 * (number % 2)]))
        for number, pose in enumerate(seen)
    ]
    with pytest.raises(InputError, match=r"adjusted together|too alike"):
        calibrate_pair(shifted, BOARD, CAMERA, PROJECTOR)


@pytest.mark.slow
def test_calibration_from_captures(tmp_path):
    seen = []
    for pose in range(9):
        folder = store(board_pictures(pose), tmp_path / f"pose_{pose}")
        seen.append(see_board(decode_capture(open_capture(folder, SMALL)), BOARD, folder))
    calibration, left_out = calibrate_pair(seen, BOARD, CAMERA, PROJECTOR)
    assert left_out == ()
    assert calibration.camera.rms_px <= 0.15
    assert calibration.projector.rms_px <= 0.15
    assert max(max(pose.camera_px, pose.projector_px) for pose in calibration.poses) <= 0.3
    np.testing.assert_allclose(calibration.camera.matrix, small_rig().camera.matrix, atol=3.0)
    assert calibration.base_mm == pytest.approx(float(np.linalg.norm(small_rig().translation)), rel=0.005)


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_a_leg_measured_with_a_calibration_from_captures(tmp_path):
    """At a laboratory's resolution: twelve poses of the board, then a leg, both photographed."""
    plan, rig, texture = PatternPlan(1280, 720), make_rig(), board_picture(BOARD, 8)
    patterns, seen = pattern_pictures(plan), []
    for number, pose in enumerate(BOARD_POSES):
        folder = tmp_path / f"pose_{number}"
        photograph(board_scene(texture, BOARD_MM, *pose), rig, patterns, folder, seed=number)
        seen.append(see_board(decode_capture(open_capture(folder, plan)), BOARD, folder))
    calibration, left_out = calibrate_pair(seen, BOARD, rig.camera.size, rig.projector.size)
    assert left_out == ()
    assert max(calibration.camera.rms_px, calibration.projector.rms_px) <= 0.3
    photograph(leg_scene(), rig, patterns, tmp_path / "leg")
    view = triangulate(decode_capture(open_capture(tmp_path / "leg", plan)), calibration, "leg")
    assert view.valid.sum() > 90_000
    assert rms(distances(view.points[view.valid], leg_scene())) <= 0.5


def test_a_picture_without_the_board_is_named(tmp_path):
    folder = store(leg_pictures(), tmp_path / "pose_3")
    with pytest.raises(InputError, match="0 of the 24 corners") as fault:
        see_board(decode_capture(open_capture(folder, SMALL)), BOARD, folder)
    assert "pose_3" in fault.value.where


@pytest.mark.parametrize("text", ["charuco:7x5:30:22", "charuco:8x6:25:18.5:5x5_100", "chessboard:9x6:25"])
def test_printed_boards_are_found(text):
    board = parse_board(text)
    assert board.text == text
    picture = np.pad(board_picture(board, 4), 60, constant_values=255)
    numbers, corners = find_corners(board, picture)
    assert sorted(numbers) == list(range(board.corner_count))
    expected = board.corner_places(numbers)[:, :2] * 4 + 59.5
    turned = expected[::-1]
    off = min(np.abs(corners - expected).max(), np.abs(corners - turned).max())
    assert off < 0.3


def test_a_board_of_an_old_print_is_found():
    board = parse_board("charuco:7x6:30:22")
    old = cv2.aruco.CharucoBoard((7, 6), 30.0, 22.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    old.setLegacyPattern(True)
    picture = np.pad(old.generateImage((840, 720)), 60, constant_values=255)
    assert len(find_corners(board, picture)[0]) == 30


@pytest.mark.parametrize(
    "text",
    ["", "charuco", "charuco:7x5:30", "charuco:7x5:30:31", "charuco:7x5:30:22:9x9_1", "charuco:20x20:30:22",
     "chessboard:1x6:25", "chessboard:9x6:0.1", "chessboard:9x6:..", "charuco:7x5:30:22:4X4_50 "],
)  # fmt: skip
def test_other_words_are_no_boards(text):
    if text.endswith(" "):
        assert parse_board(text).columns == 7
        return
    with pytest.raises(ConfigError) as fault:
        parse_board(text)
    assert "charuco:7x5:30:22" in fault.value.hint


def test_the_printed_page_has_the_true_size(tmp_path):
    assert write_board(Board("chessboard", 9, 6, 25.0), tmp_path) == ["board.pdf"]
    page = (tmp_path / "board.pdf").read_bytes()
    box = page.split(b"/MediaBox [")[1].split(b"]")[0].split()
    points = [float(number) for number in box[2:]]
    assert points == pytest.approx([(250 + 25) / 25.4 * 72, (175 + 25) / 25.4 * 72], abs=0.1)


def test_a_calibration_is_read_as_it_was_written(tmp_path):
    calibration, _ = calibrate_pair(ideal_poses(), BOARD, CAMERA, PROJECTOR)
    save_calibration(calibration, tmp_path / "c.toml")
    again = read_calibration(tmp_path / "c.toml")
    np.testing.assert_array_equal(again.camera.matrix, calibration.camera.matrix)
    np.testing.assert_array_equal(again.rotation, calibration.rotation)
    assert [pose.folder for pose in again.poses] == [pose.folder for pose in calibration.poses]
    save_calibration(again, tmp_path / "d.toml")
    assert (tmp_path / "c.toml").read_bytes() == (tmp_path / "d.toml").read_bytes()


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("[camera]", "[kamera]", "not a calibration"),
        ("rotation = [[", "rotation = [[7.0, 0.0, 0.0], [", "not a calibration"),
        ("matrix = [[", "matrix = [[nan, 0, 0], [0, 1, 0], [0, 0, 1]] #", "camera.matrix"),
        ("translation_mm = [", "translation_mm = [0, 0, 0] #", "translation_mm"),
        ("rotation = [", "rotation = [[2, 0, 0], [0, 1, 0], [0, 0, 1]] #", "no rotation"),
    ],
)
def test_a_damaged_calibration_is_refused(tmp_path, old, new, what):
    path = tmp_path / "c.toml"
    save_calibration(known(small_rig()), path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=what) as fault:
        read_calibration(path)
    assert fault.value.where == str(path)


def test_no_calibration_at_all(tmp_path):
    with pytest.raises(InputError, match="not calibrated") as fault:
        read_calibration(tmp_path / "calibration.toml")
    assert "hilbrace scan calibrate" in fault.value.hint
