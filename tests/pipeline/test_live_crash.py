"""A recorder that is killed loses at most fifty milliseconds, and says so when asked."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from evaluation.record.reading import read_log
from evaluation.sources.stream import MarkerFrame, PlateSamples
from tests.pipeline.live_mocks import ROOT
from tests.pipeline.live_recorder import RATE_HZ

LOST_S = 0.05


def kill_at(seconds: float, path) -> int:
    """Kill a recorder some time after its first frame; the last number that it had been given."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.pipeline.live_recorder", str(path)],
        stdout=subprocess.PIPE, cwd=ROOT, env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    with process:
        first = process.stdout.readline()
        assert first
        time.sleep(seconds)
        process.kill()
        given = process.stdout.read().split()
    return int((given or [first])[-1])


def judge(path, given: int) -> None:
    recorded = read_log(path)
    assert not recorded.finished
    frames = [item for item in recorded.items if isinstance(item, MarkerFrame)]
    numbers = [frame.number for frame in frames]
    assert numbers == list(range(len(numbers)))
    assert given + 1 - len(numbers) <= LOST_S * RATE_HZ, f"{given + 1 - len(numbers)} frames are lost"
    for frame in frames:
        assert np.array_equal(frame.positions[:, 0], frame.number / RATE_HZ + np.arange(13))
    samples = [item.number for item in recorded.items if isinstance(item, PlateSamples)]
    assert samples == list(range(0, 5 * len(samples), 5))
    assert abs(len(samples) - len(numbers)) <= 1


def kill_often(tmp_path, times: int, seed: int) -> None:
    moments = np.random.default_rng(seed).uniform(0.1, 1.2, times)
    for k, moment in enumerate(moments):
        path = tmp_path / f"{k}.mcap"
        judge(path, kill_at(float(moment), path))
    done = subprocess.run(
        [sys.executable, "-m", "hilbrace", "evaluate", "recover", str(path), "--json", "--c3d"],
        capture_output=True, text=True, check=True, cwd=ROOT,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["finished"] is False
    assert "without having been closed" in found["gaps"][0]
    assert found["missing"] == {"lab markers": 0, "lab 1": 0}
    assert found["recovered"].endswith("_recovered.mcap")
    assert read_log(tmp_path / found["recovered"]).finished
    assert (tmp_path / found["c3d"]).stat().st_size > 10_000


@pytest.mark.slow
def test_a_kill_costs_at_most_fifty_milliseconds(tmp_path):
    kill_often(tmp_path, 4, seed=1)


@pytest.mark.soak
def test_twenty_kills_cost_at_most_fifty_milliseconds_each(tmp_path):
    kill_often(tmp_path, 20, seed=2)
