"""``hilbrace ablate``: one table, one picture, one page, and it goes on where it was interrupted."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hilbrace.cli import main
from hilbrace.config import read_config
from tests.pipeline.small_run import write_small_run

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

TINY: dict[str, dict[str, object]] = {"optimize": {"iterations": 4, "checkpoint_every": 1, "snapshots": 0}}
FILES = ("ablation.csv", "ablation.json", "ablation.png", "ablation.html")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_small_run(tmp_path_factory.mktemp("ablation") / "run", **TINY)
    assert main(["run", str(folder), "--until", "optimize", "--json"]) == 0
    return folder


@pytest.fixture(scope="module")
def whole(source: Path) -> Path:
    assert main(["ablate", str(source)]) == 0
    return source / "ablation"


def test_the_table_has_a_row_for_every_variant(whole: Path):
    with (whole / "ablation.csv").open() as stream:
        rows = {row["variant"]: row for row in csv.DictReader(stream)}
    assert list(rows) == [
        "design", "without_elastic_energy", "without_compliance", "volume_30_percent", "volume_50_percent",
        "volume_70_percent", "uniform",
    ]  # fmt: skip
    assert "can be reached" in rows.pop("volume_70_percent")["reason"]
    for name, row in rows.items():
        assert not row["reason"]
        assert float(row["frontal_nm_per_deg"]) > 0.0, name
        assert float(row["L2_elastic_energy"]) > 0.0, name
    assert float(rows["uniform"]["ratio_vs_uniform"]) == 1.0
    assert float(rows["uniform"]["volume_fraction"]) == pytest.approx(
        float(rows["design"]["volume_fraction"]), abs=1e-4
    )
    low, own, high = (
        float(rows[name]["frontal_nm_per_deg"])
        for name in ("volume_30_percent", "design", "volume_50_percent")
    )
    assert low < own < high


def test_the_picture_and_the_page_are_there(whole: Path):
    assert (whole / "ablation.png").read_bytes()[:4] == b"\x89PNG"
    page = (whole / "ablation.html").read_text()
    assert "Research software, not a medical device" in page
    assert "Without L3 the brace supports less" in page
    assert "no such brace" in page
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_the_source_is_left_alone_and_its_stages_are_reused(source: Path, whole: Path):
    assert read_config(source / "run.toml").optimize.weights.elastic_energy > 0.0
    log = [json.loads(line) for line in (whole / "without_compliance" / "log.jsonl").read_text().splitlines()]
    assert {event["stage"] for event in log} == {"optimize"}
    assert not (whole / "design" / "log.jsonl").exists()


def test_a_second_call_computes_nothing_and_prints_one_object(source: Path, whole: Path, capsys):
    before = {name: (whole / name).read_bytes() for name in FILES}
    logs = {path: path.read_text() for path in whole.glob("*/log.jsonl")}
    capsys.readouterr()
    assert main(["ablate", str(source), "--json"]) == 0
    told = capsys.readouterr()
    assert not told.err
    assert len(json.loads(told.out)["rows"]) == 7
    assert {name: (whole / name).read_bytes() for name in FILES} == before
    finished = {path: text for path, text in logs.items() if "volume_70" not in str(path)}
    assert {path: path.read_text() for path in finished} == finished


def test_killed_in_the_middle_it_ends_in_the_same_bytes(source: Path, whole: Path, tmp_path: Path):
    out = tmp_path / "again"
    command = [sys.executable, "-m", "hilbrace", "ablate", str(source), "--out", str(out), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while (
        process.poll() is None
        and not (out / "without_elastic_energy" / "optimize" / "checkpoint.npz").exists()
    ):
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert not (out / "ablation.csv").exists()
    assert main(["ablate", str(source), "--out", str(out), "--json"]) == 0
    for name in FILES:
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name


def test_a_preset_wins_over_what_the_source_says(source: Path, tmp_path: Path, monkeypatch):
    from hilbrace.pipeline import ablation

    seen = []
    monkeypatch.setattr(ablation, "run_ablation", lambda config, *_, **__: seen.append(config) or _stop())
    with pytest.raises(KeyError):
        main(
            ["ablate", str(source), "--preset", "paper", "--out", str(tmp_path), "--set", "optimize.sigma=5"]
        )
    assert seen[0].preset == "paper"
    assert seen[0].optimize.coupling == "paper"
    assert seen[0].optimize.volume_fraction == 0.5
    assert seen[0].optimize.sigma == 5.0
    assert seen[0].motion.synthetic == "squat"


def _stop() -> None:
    raise KeyError


def test_a_folder_without_a_run_is_named(tmp_path: Path, capsys):
    assert main(["ablate", str(tmp_path)]) == 3
    assert "run.toml" in capsys.readouterr().err
