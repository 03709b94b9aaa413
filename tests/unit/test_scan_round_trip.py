"""The whole way: a process that photographs, the command that decodes, at the resolution of a laboratory."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from hilbrace.cli import main
from hilbrace.scan.calibration import save_calibration
from hilbrace.scan.capture import open_capture
from hilbrace.scan.decode import decode_capture
from hilbrace.scan.patterns import PatternPlan, write_patterns
from hilbrace.scan.point_cloud import UPRIGHT
from hilbrace.scan.triangulate import triangulate
from mocks.scan_studio import leg_scene, make_rig
from tests.unit.scan_scenes import (
    BOARD,
    SMALL,
    board_pictures,
    distances,
    known,
    leg_pictures,
    rms,
    small_rig,
    store,
)

ROOT = Path(__file__).resolve().parents[2]


def photographed(patterns, out, *words):
    command = [sys.executable, "-m", "mocks.scan_studio", "--patterns", patterns, "--out", out, *words]
    subprocess.run([str(word) for word in command], cwd=ROOT, check=True)
    return out


def said(capsys, *words):
    code = main([str(word) for word in words])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Patterns, a true calibration and two views of a leg by the small pair."""
    folder = tmp_path_factory.mktemp("small")
    write_patterns(SMALL, folder / "patterns")
    save_calibration(known(small_rig()), folder / "calibration.toml")
    store(leg_pictures(), folder / "front")
    store(leg_pictures(30.0), folder / "turned")
    return folder


def decode(folder, *words):
    options = ("--patterns", folder / "patterns", "--calibration", folder / "calibration.toml")
    return ("scan", "decode", *words, *options)


@pytest.mark.slow
def test_points_of_a_laboratory_capture(tmp_path):
    plan = PatternPlan(1280, 720)
    write_patterns(plan, tmp_path / "patterns")
    folder = photographed(tmp_path / "patterns", tmp_path / "leg")
    view = triangulate(decode_capture(open_capture(folder, plan)), known(make_rig()), "leg")
    off = distances(view.points[view.valid], leg_scene())
    assert view.valid.sum() > 90_000
    assert rms(off) <= 0.15
    assert np.quantile(off, 0.99) < 0.6
    assert rms(off) <= 1.3 * rms(view.error[view.valid])


def test_two_views_become_a_cloud_and_a_mesh(small, tmp_path, capsys):
    out = tmp_path / "leg"
    words = decode(small, small / "front", small / "turned", "--turn", "0,30", "--out", out, "--voxel", "4")
    code, text, _ = said(capsys, *words)
    assert code == 0
    assert "front" in text
    assert "mesh:" in text
    names = {path.name for path in out.iterdir()}
    assert names == {
        "cloud.ply", "limb.ply", "scan.json", "front.ply", "front.png", "turned.ply", "turned.png",
    }  # fmt: skip
    report = json.loads((out / "scan.json").read_text())
    assert [view["name"] for view in report["views"]] == ["front", "turned"]
    assert report["views"][1]["misfit_mm"] < 0.6
    mesh = trimesh.load(out / "limb.ply", process=False)
    assert rms(distances(np.asarray(mesh.vertices) @ UPRIGHT, leg_scene(0.0))) < 0.4
    assert cv2.imread(str(out / "front.png")).std() > 10
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    assert said(capsys, *words)[0] == 0
    assert first == {path.name: path.read_bytes() for path in out.iterdir()}


def test_calibrate_command(small, tmp_path, capsys):
    for pose in (0, 1, 2, 3, 6):
        store(board_pictures(pose), tmp_path / "captures" / f"pose_{pose}")
    shutil.copytree(tmp_path / "captures" / "pose_0", tmp_path / "captures" / "pose_8")
    (tmp_path / "captures" / "pose_8" / "IMG_0005.png").unlink()
    words = (
        "scan",
        "calibrate",
        tmp_path / "captures",
        "--patterns",
        small / "patterns",
        "--board",
        BOARD.text,
    )
    out = tmp_path / "made" / "calibration.toml"
    code, text, _ = said(capsys, *words, "--out", out, "--json")
    figures = json.loads(text)
    assert code == 0
    assert out.is_file()
    assert figures["rms_px"] <= 0.3
    assert len(figures["poses"]) == 5
    assert list(figures["left_out"]) == ["pose_8"]
    assert "column_bit_02_inverse" in figures["left_out"]["pose_8"]
    few = ("scan", "calibrate", tmp_path / "captures" / "pose_8", *words[3:], "--out", out)
    code, _, error = said(capsys, *few)
    assert code == 2
    assert "0 usable poses" in error
    assert "column_bit_02_inverse" in error


@pytest.mark.parametrize(
    ("change", "words", "code", "what"),
    [
        ("none", ("--turn", "0"), 3, "turns of 2 views"),
        ("none", ("--turn", "5,30"), 3, "0 for the first"),
        ("none", ("--depth", "far"), 3, "400:900"),
        ("none", ("--depth", "10:20"), 3, "no points between"),
        ("none", ("--voxel", "0"), 3, "--voxel"),
        ("calibration", (), 2, "not calibrated"),
        ("patterns", (), 2, "hilbrace scan patterns"),
        ("picture", (), 2, "IMG_0003.png"),
        ("projector", (), 3, "800 x 600"),
    ],
)
def test_errors_name_what_and_where(small, tmp_path, capsys, change, words, code, what):
    for name in ("patterns", "front", "turned"):
        shutil.copytree(small / name, tmp_path / name)
    shutil.copy(small / "calibration.toml", tmp_path)
    if change == "calibration":
        (tmp_path / "calibration.toml").unlink()
    elif change == "patterns":
        (tmp_path / "patterns" / "manifest.json").unlink()
    elif change == "picture":
        (tmp_path / "turned" / "IMG_0003.png").write_bytes(b"cut short")
    elif change == "projector":
        shutil.rmtree(tmp_path / "patterns")
        write_patterns(PatternPlan(800, 600), tmp_path / "patterns")
    command = decode(tmp_path, tmp_path / "front", tmp_path / "turned", *words, "--out", tmp_path / "out")
    found, _, error = said(capsys, *command)
    assert found == code
    assert what in error
    assert error.count("\n") == 2


def test_the_list_of_patterns_is_found_beside_the_pictures(small, tmp_path, capsys, monkeypatch):
    shutil.copytree(small / "front", tmp_path / "front")
    shutil.copy(small / "calibration.toml", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert "hilbrace scan patterns" in said(capsys, "scan", "decode", "front")[2]
    shutil.copy(small / "patterns" / "manifest.json", tmp_path)
    code, text, _ = said(capsys, "scan", "decode", "front", "--voxel", "8", "--json")
    assert code == 0
    assert json.loads(text)["views"][0]["contrast_grey_levels"] > 40
    assert (tmp_path / "scan" / "limb.ply").is_file()


def test_patterns_command(tmp_path, capsys):
    words = ("scan", "patterns", "--projector", "320x200", "--out", tmp_path / "p")
    code, text, _ = said(capsys, *words, "--json")
    figures = json.loads(text)
    assert code == 0
    assert set(figures["files"]) == {path.name for path in (tmp_path / "p").iterdir()}
    assert "board.pdf" in figures["files"]
    assert said(capsys, "scan", "patterns", "--projector", "wide")[0] == 3
    code, _, error = said(capsys, "scan", "picture")
    assert code == 3
    assert "patterns, calibrate, decode" in error


LARGE = """
import resource, sys
from pathlib import Path
import numpy as np
from hilbrace.scan.calibration import read_calibration
from hilbrace.scan.clean import clean_mesh
from hilbrace.scan.decode_command import decode_view
from hilbrace.scan.fuse import fuse_views
from hilbrace.scan.merge import merge_views
from hilbrace.scan.patterns import read_manifest
folder = Path(sys.argv[1])
plan, pair = read_manifest(folder / "patterns"), read_calibration(folder / "calibration.toml")
view = decode_view(folder / "wall", "wall", plan, pair, (0.0, np.inf), folder)
moves = merge_views([view.cloud], ["wall"], None)
mesh = clean_mesh(*fuse_views([view.smooth], moves, pair.camera, 4.0), "wall")
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(len(view.cloud.points), len(mesh.triangles), peak)
"""


@pytest.mark.soak
def test_five_million_points_stay_under_four_gigabytes(tmp_path):
    """A wall, square to a large camera: every pixel is a point."""
    from hilbrace.scan.calibration import Calibration, Lens
    from hilbrace.scan.patterns import pattern_pictures

    plan, size, depth = PatternPlan(1280, 1024), (2600, 2000), 800.0
    camera = Lens(size, np.array([[2600.0, 0, 1299.5], [0, 2600, 999.5], [0, 0, 1]]), np.zeros(5), 0.0)
    beam = Lens((1280, 1024), np.array([[1150.0, 0, 410], [0, 1150, 512], [0, 0, 1]]), np.zeros(5), 0.0)
    pair = Calibration(camera, beam, np.eye(3), np.array([150.0, 0, 0]), "", (), 0.0)
    write_patterns(plan, tmp_path / "patterns")
    save_calibration(pair, tmp_path / "calibration.toml")
    x = ((np.arange(size[0]) - 1299.5) / 2600 + 150 / depth) * 1150 + 410
    y = (np.arange(size[1]) - 999.5) / 2600 * 1150 + 512
    at_x, at_y = (grid.astype(np.float32) for grid in np.meshgrid(x, y))
    random = np.random.default_rng(0)
    seen = tuple(
        (
            20 + 0.7 * cv2.remap(picture, at_x, at_y, cv2.INTER_LINEAR) + random.normal(0, 1, at_x.shape)
        ).astype(np.uint8)
        for picture in pattern_pictures(plan)
    )
    store(seen, tmp_path / "wall")
    del seen
    done = subprocess.run(
        [sys.executable, "-c", LARGE, str(tmp_path)], cwd=ROOT, check=True, capture_output=True, text=True
    )
    points, triangles, peak_kb = (int(word) for word in done.stdout.split())
    assert points > 5_000_000
    assert triangles > 10_000
    assert peak_kb < 4 * 1024 * 1024
