"""``hilbrace fabricate`` as a person runs it: a whole mold from a tiny run, its files and its errors."""

from __future__ import annotations

import json
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
import trimesh

from fabrication.bodies import mesh_of
from fabrication.mold import Casting
from fabrication.printers import custom_bed
from fabrication.slicer import ask_slicer, slice_piece, slicer_program
from hilbrace.pattern.export import stl_bytes
from tests.pipeline.small_run import finish, write_small_run
from tests.unit.mold_cases import bent_tube, flat_coupon

TINY = {
    "domain": {"triangles": 500, "frames_per_second": 4.0, "above": 0.2, "below": 0.2},
    "optimize": {"iterations": 2},
    "pattern": {"min_strut_mm": 4.0, "min_slit_mm": 2.0},
    "mold": {"printer": "250x210x210"},
}

FILES = {"mold.3mf", "mold.glb", "fixtures.step", "checks.json", "worksheet.html", "stl", "pictures"}


def fabricate(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hilbrace", "fabricate", *words]
    return subprocess.run(command, text=True, capture_output=True, timeout=280, check=False)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = write_small_run(tmp_path_factory.mktemp("fabricate") / "run", **TINY)
    finish(folder, "--until", "solid")
    return folder


@pytest.fixture(scope="module")
def made(run) -> dict:
    """The mold of the tiny run, beside what an older one left."""
    (run / "mold" / "stl").mkdir(parents=True)
    (run / "mold" / "checks.json").write_text("{}")
    (run / "mold" / "stl" / "shell_of_yesterday.stl").write_text("old")
    done = fabricate(str(run), "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_the_mold_of_a_run_is_proved_and_its_figures_are_metrics(run, made):
    assert made["passed"]
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["mold"] == made["metrics"]
    assert {"solid", "brace"} <= set(metrics)
    mold = metrics["mold"]
    assert mold["pieces"] == len(mold["pieces_by_name"]) >= 4
    assert mold["cavity_volume_error"] < 2e-3
    assert mold["max_overlap_mm3"] <= 2
    assert mold["removal_collision_mm3"] < 1e-3
    assert mold["trapped_maxima"] == 0
    checks = json.loads((run / "mold" / "checks.json").read_text())
    assert checks["passed"]
    assert all(check["passed"] for check in checks["checks"].values())
    assert all((run / "mold" / name).exists() for name in checks["pictures"].values())


@pytest.mark.slow
def test_the_folder_holds_this_mold_alone(run, made):
    folder = run / "mold"
    assert {path.name for path in folder.iterdir()} == FILES
    names = {path.stem for path in (folder / "stl").iterdir()}
    assert names == set(made["metrics"]["pieces_by_name"])
    assert not [path for path in run.iterdir() if path.name.startswith(".mold")]
    for path in (folder / "stl").iterdir():
        assert trimesh.load(path).is_watertight


@pytest.mark.slow
@pytest.mark.slicer
@pytest.mark.skipif(slicer_program() is None, reason="PrusaSlicer is not installed")
def test_the_slicer_agrees_on_every_piece(run, made):
    for path in sorted((run / "mold" / "stl").iterdir()):
        opinion = ask_slicer(path)
        assert opinion.manifold, path.name
        assert (opinion.open_edges, opinion.parts) == (0, 1), path.name
        stated = made["metrics"]["pieces_by_name"][path.stem]
        assert opinion.volume_mm3 / 1000 == pytest.approx(stated["volume_ml"], rel=1e-3)


@pytest.mark.soak
@pytest.mark.slicer
@pytest.mark.skipif(slicer_program() is None, reason="PrusaSlicer is not installed")
def test_core_and_shells_are_sliced(run, made):
    for path in sorted((run / "mold" / "stl").iterdir()):
        slicing = slice_piece(path, custom_bed("250x210x210", "fdm"))
        assert 10 < slicing.minutes < 60 * 60, path.name
        volume = made["metrics"]["pieces_by_name"][path.stem]["volume_ml"]
        assert 0.1 * 1.24 * volume < slicing.filament_g < 1.3 * 1.24 * volume, path.name


@pytest.mark.slow
def test_the_work_sheet_needs_no_other_file(run, made):
    text = (run / "mold" / "worksheet.html").read_text("utf-8")

    class Page(HTMLParser):
        addresses: list[str] = []  # noqa: RUF012

        def handle_starttag(self, tag, attrs):
            self.addresses += [value for name, value in attrs if name in ("src", "href") and value]

    page = Page()
    page.feed(text)
    assert len(page.addresses) >= 7
    assert all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert "not a medical device" in text
    assert "does not cure" in text
    assert "Shore 30A" in text
    assert made["mold"] in text


def write_brace(folder: Path, casting: Casting) -> None:
    """A brace and its limb as a person gets them from another program."""
    (folder / "brace.stl").write_bytes(stl_bytes(*mesh_of(casting.brace)))
    (folder / "limb.stl").write_bytes(stl_bytes(casting.vertices, casting.triangles))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "words"),
    [(flat_coupon, ()), (bent_tube, ("--limb", "limb.stl"))],
    ids=["coupon", "sleeve"],
)
def test_a_mold_from_files_of_another_program(tmp_path, make, words):
    write_brace(tmp_path, make())
    words = tuple(str(tmp_path / word) if word.endswith(".stl") else word for word in words)
    done = fabricate(str(tmp_path / "brace.stl"), *words, "--set", "mold.resolution_mm=2.5", "--json")
    assert done.returncode == 0, done.stderr
    made = json.loads(done.stdout)
    assert made["passed"]
    assert made["metrics"]["cavity_volume_error"] < 2e-3
    assert {path.name for path in (tmp_path / "brace-mold").iterdir()} == FILES


def test_help_shows_an_example():
    done = fabricate("--help")
    assert done.returncode == 0
    assert "example: hilbrace fabricate" in done.stdout


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (("nowhere.stl",), 2, "no such file"),
        (("{folder}",), 3, "no such file"),
        (("nowhere.stl", "--set", "mold.wall=3"), 3, "did you mean 'mold.wall_mm'"),
        (("nowhere.stl", "--set", "mold.wall_mm"), 3, "write --set mold.key=value"),
        (("nowhere.stl", "--set", "mold.printer=toaster"), 3, "no printer 'toaster'"),
    ],
)
def test_bad_words_get_named_errors(tmp_path, words, code, says):
    done = fabricate(*(word.format(folder=tmp_path) for word in words))
    assert done.returncode == code
    assert says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 2


def test_a_folder_of_something_else_is_not_overwritten(tmp_path):
    from fabrication.files import replaced
    from hilbrace.errors import InputError

    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.png").write_text("meow")
    with pytest.raises(InputError, match="holds no mold"), replaced(tmp_path / "photos"):
        pass
    assert (tmp_path / "photos" / "cat.png").read_text() == "meow"


def test_an_interrupted_mold_leaves_the_old_one(tmp_path):
    from fabrication.files import replaced

    old = tmp_path / "mold"
    old.mkdir()
    (old / "checks.json").write_text("old")
    with pytest.raises(ZeroDivisionError), replaced(old) as fresh:
        (fresh / "checks.json").write_text(str(1 / 0))
    assert (old / "checks.json").read_text() == "old"
    with replaced(old) as fresh:
        (fresh / "checks.json").write_text("new")
    assert (old / "checks.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["mold"]
