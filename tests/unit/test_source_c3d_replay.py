"""C3D files played as if they were measured now."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from evaluation.c3d_writer import write_c3d, z_up
from evaluation.sources.c3d_replay import C3DReplay
from evaluation.sources.reconnecting import Reconnecting
from evaluation.sources.stream import LabError, ground_load, y_up
from hilbrace.errors import InputError
from mocks import synthetic_study
from tests.unit.mock_process import listen


@pytest.fixture(scope="module")
def recording():
    angles = synthetic_study.planted_angles()["unbraced"]
    rng = np.random.default_rng(2)
    return synthetic_study.trial_recording(angles, rng, synthetic_study.Scatter(), 2.0)


@pytest.fixture
def path(recording, tmp_path):
    file = tmp_path / "trial.c3d"
    write_c3d(file, recording)
    return file


def test_a_file_arrives_whole_and_ends(recording, path):
    source = Reconnecting(C3DReplay("replay", path, math.inf), silence_s=0.0)
    info = source.open()
    heard = listen(source, lambda heard: bool(heard.events("ended")))
    assert source.read(0.0) == []
    source.close()
    assert heard.events("gap", "disconnected") == []
    assert (info.labels, info.rate_hz, info.up) == (recording.markers.names, 200.0, "z")
    places = np.stack([frame.positions for frame in heard.frames])
    np.testing.assert_allclose(places, z_up(recording.markers.positions), atol=1e-6)
    np.testing.assert_allclose(y_up(places, info.up), recording.markers.positions, atol=1e-6)
    load = np.concatenate([ground_load(info.plates[0], block.values) for block in heard.samples])
    np.testing.assert_allclose(load[:, :3], z_up(recording.plates.force[:, 0]), atol=1e-3)
    moment = np.cross(recording.plates.point[:, 0], recording.plates.force[:, 0])
    np.testing.assert_allclose(load[:, 3:], z_up(moment), atol=1e-2)


def test_real_time_and_faster_take_their_time(path):
    source = C3DReplay("replay", path, speed=8.0)
    source.open()
    start = time.monotonic()
    heard = listen(source, lambda heard: bool(heard.events("ended")))
    assert time.monotonic() - start >= 0.95 * 2.0 / 8.0
    assert [frame.number for frame in heard.frames] == list(range(400))
    assert source.read(0.0) == []


def test_it_plays_again_after_opening_again(path):
    source = C3DReplay("replay", path, math.inf)
    for _ in range(2):
        source.open()
        assert len(listen(source, lambda heard: bool(heard.events("ended"))).frames) == 400
        source.close()
    with pytest.raises(LabError, match="not open"):
        source.read(0.0)


def test_files_that_are_missing_or_speeds_that_are_none_are_named(tmp_path):
    with pytest.raises(InputError):
        C3DReplay("replay", tmp_path / "none.c3d").open()
    for speed in (0.0, -1.0, math.nan):
        with pytest.raises(InputError, match="positive speed"):
            C3DReplay("replay", tmp_path / "none.c3d", speed)
