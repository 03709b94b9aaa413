"""One seed, one result: twice over, after a change taken back, and however often the run is killed."""

from __future__ import annotations

import json
import random
import time
from pathlib import Path

import pytest

from tests.pipeline.small_run import digests, finish, start, write_small_run

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

KILLS = 6


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """A finished small run and the time it took [s]."""
    folder = write_small_run(tmp_path_factory.mktemp("runs") / "undisturbed")
    begin = time.perf_counter()
    finish(folder)
    return folder, time.perf_counter() - begin


def test_a_killed_run_ends_in_the_same_bytes(undisturbed: tuple[Path, float], tmp_path: Path):
    """Six kills at random moments of what is left of the run."""
    reference, seconds = undisturbed
    folder = write_small_run(tmp_path / "killed")
    chance = random.Random(20240501)
    struck = 0
    for _ in range(KILLS):
        process = start(folder)
        time.sleep(chance.uniform(0.05, 0.2) * seconds)
        struck += process.poll() is None
        process.kill()
        process.communicate()
    assert struck == KILLS, "the run was over before the last kill"
    finish(folder)
    assert digests(folder) == digests(reference)


def test_killed_while_optimizing_the_checkpoint_is_used(undisturbed: tuple[Path, float], tmp_path: Path):
    reference, _ = undisturbed
    folder = write_small_run(tmp_path / "checkpoint")
    finish(folder, "--until", "domain")
    for _ in range(5):
        process = start(folder)
        checkpoint = folder / "optimize" / "checkpoint.npz"
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        while process.poll() is None and not (checkpoint.exists() and checkpoint.stat().st_mtime_ns > before):
            time.sleep(0.005)
        process.kill()
        process.communicate()
    assert checkpoint.exists()
    finish(folder)
    assert digests(folder) == digests(reference)


def test_a_second_run_with_the_seed_gives_the_same_bytes(undisturbed: tuple[Path, float], tmp_path: Path):
    reference, _ = undisturbed
    folder = write_small_run(tmp_path / "again")
    finish(folder)
    assert digests(folder) == digests(reference)


def test_another_seed_gives_another_design(undisturbed: tuple[Path, float], tmp_path: Path):
    reference, _ = undisturbed
    folder = write_small_run(tmp_path / "other", optimize={"seed": 1})
    finish(folder, "--until", "optimize")
    own = (folder / "optimize" / "optimize.npz").read_bytes()
    assert own != (reference / "optimize" / "optimize.npz").read_bytes()


def test_only_what_changed_is_repeated(undisturbed: tuple[Path, float], tmp_path: Path):
    import shutil

    reference, _ = undisturbed
    folder = tmp_path / "changed"
    shutil.copytree(reference, folder)
    messages = finish(folder, "--json")
    assert not (folder / "log.jsonl").read_text().count('"start"') > _starts(reference)
    assert messages == ""
    finish(folder, "--set", "solid.simplify_mm=0.08")
    begun = [json.loads(line)["stage"] for line in (folder / "log.jsonl").read_text().splitlines()]
    assert set(begun[2 * _starts(reference) :]) == {"solid", "report"}


def _starts(folder: Path) -> int:
    return (folder / "log.jsonl").read_text().count('"start"')
