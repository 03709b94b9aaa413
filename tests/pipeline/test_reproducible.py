"""One seed, one result: twice over, after a change taken back, and however often the run is killed."""

from __future__ import annotations

import json
import random
import shutil
import time
from pathlib import Path

import pytest

from tests.pipeline import small_run
from tests.pipeline.small_run import digests, finish, start

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]

KILLS = 6

COARSE: dict[str, object] = {"min_strut_mm": 2.5, "resolution_mm": 1.35}
"""A third of the triangles, since every run here is made many times."""


def write_small_run(folder: Path, **changes: dict[str, object]) -> Path:
    """The small run, with a coarse pattern."""
    return small_run.write_small_run(folder, pattern=COARSE, **changes)


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


SETTINGS = {
    "default": {},
    "exact": {"volume": "exact", "segmentation_every": 7, "gradient_noise": 0.1},
    "network": {"field": "network", "coupling": "paper", "p_norm_start": 4.0, "sharpness_end": 2.0},
    "all": {"field": "network", "volume": "exact", "segmentation_every": 7, "gradient_noise": 0.1},
}
"""Loops of every kind: with what they draw, solve and refresh on the way."""


TINY: dict[str, dict[str, object]] = {
    "domain": {"triangles": 400},
    "optimize": {"iterations": 14, "snapshots": 4},
    "pattern": {"min_strut_mm": 4.0, "resolution_mm": 2.2},
}
"""The long test makes sixty runs of each kind."""

TO_SOLID = ("--until", "solid")


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run whose motion is analysed: what comes before the design, and is slow."""
    folder = write_small_run(tmp_path_factory.mktemp("runs") / "analysed")
    finish(folder, "--until", "biomech")
    return folder


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", SETTINGS)
def test_killed_at_twenty_random_moments_each_run_ends_in_the_same_bytes(
    analysed: Path, kind: str, tmp_path: Path
):
    """Twenty runs, each killed once at any moment from domain to solid, and twenty kills of one run."""

    def fresh(name: str) -> Path:
        shutil.copytree(analysed, tmp_path / name)
        return small_run.write_small_run(
            tmp_path / name, **TINY | {"optimize": TINY["optimize"] | SETTINGS[kind]}
        )

    reference = fresh("reference")
    begin = time.perf_counter()
    finish(reference, *TO_SOLID)
    seconds = time.perf_counter() - begin
    expected, chance = digests(reference), random.Random(kind)
    often = fresh("often")
    for number in range(20):
        once = fresh(f"once_{number}")
        _kill_after(once, chance.uniform(0.0, 1.0) * seconds)
        finish(once, *TO_SOLID)
        assert digests(once) == expected, f"kill {number}"
        shutil.rmtree(once)
        _kill_after(often, chance.uniform(0.1, 0.6) * seconds)
    finish(often, *TO_SOLID)
    assert digests(often) == expected


def _kill_after(folder: Path, seconds: float) -> None:
    process = start(folder, *TO_SOLID)
    time.sleep(seconds)
    process.kill()
    process.communicate()


def test_a_loop_with_every_part_survives_a_kill(undisturbed: tuple[Path, float], tmp_path: Path):
    """The domain is the undisturbed run's; only the design is made again."""
    reference, _ = undisturbed
    designs = []
    for name in ("whole", "killed"):
        folder = tmp_path / name
        shutil.copytree(reference, folder)
        shutil.rmtree(folder / "optimize")
        write_small_run(folder, optimize=SETTINGS["all"])
        if name == "killed":
            _kill_at_a_checkpoint(folder)
        finish(folder, "--until", "optimize")
        designs.append((folder / "optimize" / "optimize.npz").read_bytes())
    assert designs[0] == designs[1]


def _kill_at_a_checkpoint(folder: Path) -> None:
    process = start(folder)
    while process.poll() is None and not (folder / "optimize" / "checkpoint.npz").exists():
        time.sleep(0.005)
    process.kill()
    process.communicate()
    assert (folder / "optimize" / "checkpoint.npz").exists()


def test_killed_while_optimizing_the_checkpoint_is_used(undisturbed: tuple[Path, float], tmp_path: Path):
    reference, _ = undisturbed
    folder = write_small_run(tmp_path / "checkpoint")
    finish(folder, "--until", "domain")
    checkpoint = folder / "optimize" / "checkpoint.npz"
    for _ in range(5):
        process = start(folder)
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
