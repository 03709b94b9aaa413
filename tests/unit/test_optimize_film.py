"""The film of the evolving field: what a frame shows, and files that open and come out alike."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from hilbrace.config import PatternSettings
from hilbrace.domain.domain import Domain
from hilbrace.errors import InputError
from hilbrace.optimize.design import LOSSES, Design
from hilbrace.optimize.film import (
    FRAME_MS,
    LAST_MS,
    SIZE,
    film_frames,
    rasterised,
    write_film,
    write_film_glb,
)
from hilbrace.optimize.history import TRACE
from tests.unit.sleeve import sleeve_design, sleeve_domain

SNAPSHOTS = 3


@pytest.fixture(scope="module")
def domain() -> Domain:
    return sleeve_domain()


@pytest.fixture(scope="module")
def design(domain: Domain) -> Design:
    plain = sleeve_design(domain, PatternSettings())
    levels = np.array([0, 128, 255], dtype=np.uint8)
    course = np.linspace(1.0, 0.5, SNAPSHOTS)
    return replace(
        plain,
        iterations=SNAPSHOTS - 1,
        film=np.repeat(levels[:, None], len(domain.uv), axis=1),
        film_iterations=np.arange(SNAPSHOTS),
        history=np.repeat(course[:, None], len(LOSSES) + 1, axis=1),
        trace=np.repeat(course[:, None], len(TRACE), axis=1),
    )


def test_a_square_fills_its_box_and_nothing_else():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    raster = rasterised(points, np.array([[0, 1, 2], [0, 2, 3]]), (10, 20, 40, 60), shaded=False)
    covered = np.zeros((100, 80), dtype=bool)
    covered[raster.row, raster.column] = True
    rows, columns = np.nonzero(covered)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (10, 49, 30, 69)
    assert covered[31:69, 11:49].all()
    assert (raster.light == 1.0).all()
    right = (points[raster.corners, 0] * raster.weights).sum(axis=1)
    assert np.abs(10 + 39 * right - raster.column).max() < 1.6


def test_what_is_near_hides_what_is_far():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    points = np.concatenate([square, square + np.array([0, 0, 1.0])])
    faces = np.array([[4, 5, 6], [0, 1, 2], [0, 2, 3], [4, 6, 7]])
    raster = rasterised(points, faces, (0, 0, 30, 30), shaded=True)
    assert (raster.corners >= 4).all()
    assert len(np.unique(raster.row * 1000 + raster.column)) == len(raster.row)


def test_a_frame_has_the_colours_of_its_snapshot(domain, design):
    frames = film_frames(domain, design)
    assert [frame.shape for frame in frames] == [(SIZE[1], SIZE[0], 3)] * SNAPSHOTS
    middle = [frame[270, 185].astype(int) for frame in frames]
    assert middle[0].tolist() == pytest.approx([68, 1, 84], abs=3)
    assert middle[2].tolist() == pytest.approx([253, 231, 36], abs=3)
    assert (frames[0][:5] == 255).all()


def test_the_film_opens_and_has_the_same_bytes_twice(domain, design, tmp_path: Path):
    paths = [tmp_path / "one.gif", tmp_path / "two.gif"]
    for path in paths:
        write_film(domain, design, path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    with Image.open(paths[0]) as film:
        assert (film.n_frames, film.size) == (SNAPSHOTS, SIZE)
        durations = []
        for frame in range(SNAPSHOTS):
            film.seek(frame)
            durations.append(film.info["duration"])
        last = np.asarray(film.convert("RGB"))
    assert durations == [FRAME_MS] * (SNAPSHOTS - 1) + [LAST_MS]
    assert np.abs(last[270, 185].astype(int) - [253, 231, 36]).max() < 12


def test_the_turnable_film_shows_one_snapshot_at_a_time(domain, design, tmp_path: Path):
    path = tmp_path / "film.glb"
    write_film_glb(domain, design, path)
    content = path.read_bytes()
    length = struct.unpack("<I", content[12:16])[0]
    document = json.loads(content[20 : 20 + length])
    assert struct.unpack("<I", content[8:12])[0] == len(content)
    assert len(document["meshes"]) == len(document["animations"][0]["channels"]) == SNAPSHOTS
    sizes = [node["scale"] for node in document["nodes"][1:]]
    assert sizes == [[0.0] * 3, [0.0] * 3, [1.0] * 3]
    scene = trimesh.load(path)
    assert len(scene.geometry) == SNAPSHOTS
    shape = next(iter(scene.geometry.values()))
    assert len(shape.faces) == len(domain.triangles)


def test_a_design_without_snapshots_makes_no_film(domain, design, tmp_path: Path):
    with pytest.raises(InputError, match="no snapshots") as fault:
        write_film(
            domain, replace(design, film=design.film[:0], film_iterations=np.arange(0)), tmp_path / "a"
        )
    assert "optimize.snapshots" in fault.value.hint
