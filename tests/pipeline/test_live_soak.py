"""Thirteen markers at 200 Hz and a plate at 1 kHz for a long time: nothing lost, no delay, no growth."""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import aiohttp
import psutil
import pytest

from evaluation.record.reading import missing_numbers, read_log
from evaluation.sources.stream import MarkerFrame, PlateSamples
from mocks import synthetic_study as made_up
from tests.pipeline.live_mocks import LAB, ROOT, vicon

WARM_UP_S = 6.0
"""Curves and queues have their full length after this time."""

GROWTH_BYTES = 10e6


def order(url: str, content: dict) -> dict:
    """Send an order as the page does, and wait for the answer."""

    async def talk() -> dict:
        origin = url.rstrip("/")
        async with aiohttp.ClientSession() as client, client.ws_connect(url + "live", origin=origin) as line:
            await line.send_str(json.dumps(content))
            while True:
                message = json.loads((await line.receive(timeout=120)).data)
                if "answer" in message:
                    return message["answer"]

    return asyncio.run(talk())


def run_live(tmp_path, seconds: float) -> dict:
    """Record one take of that length; the summary, the take's content and the memory gained meanwhile."""
    made_up.write_study(tmp_path, seed=3, repeats=1)
    lab, out = tmp_path / "lab.toml", tmp_path / "out"
    lab.write_text(LAB.format(standing='standing = "standing.c3d"'))
    with vicon(str(tmp_path / "standing.c3d"), str(tmp_path / "unbraced_1.c3d")) as mock:
        process = subprocess.Popen(
            [sys.executable, "-m", "hilbrace", "evaluate", "live", str(lab), "--out", str(out), "--port", "0",
             "--device", mock.address, "--json"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        try:
            url = re.search(r"http://\S+", process.stderr.readline()).group()
            assert order(url, {"order": "start"})["ok"]
            time.sleep(WARM_UP_S)
            before = psutil.Process(process.pid).memory_info().rss
            time.sleep(seconds - WARM_UP_S)
            grown = psutil.Process(process.pid).memory_info().rss - before
            process.terminate()
            said, _ = process.communicate(timeout=300)
        finally:
            process.kill()
            process.communicate()
    assert process.returncode == 0
    return json.loads(said) | {"grown": grown}


def judge(summary: dict, seconds: float) -> None:
    assert summary["loss"]["lost"] == summary["loss"]["dropped"] == 0
    recorded = read_log(Path(summary["folder"]) / "unbraced_1.mcap")
    assert recorded.finished
    frames = sum(isinstance(item, MarkerFrame) for item in recorded.items)
    samples = sum(len(item.values) for item in recorded.items if isinstance(item, PlateSamples))
    assert missing_numbers(recorded.items) == {"vicon markers": 0, "vicon Plate 1": 0}
    assert frames >= 200 * seconds - 20
    assert abs(samples - 5 * frames) <= 10
    assert len(recorded.infos[0].labels) == 13
    assert summary["grown"] < GROWTH_BYTES


@pytest.mark.slow
def test_nothing_is_lost_in_half_a_minute(tmp_path):
    judge(run_live(tmp_path, 24.0), 24.0)


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_nothing_is_lost_in_ten_minutes(tmp_path):
    summary = run_live(tmp_path, 600.0)
    judge(summary, 600.0)
    assert summary["latency_ms"]["p99"] < 10.0
