"""What ``hilbrace cells`` says, draws and takes in."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from hilbrace.cli import main
from hilbrace.config import parse_config
from hilbrace.config.material import CELLS
from hilbrace.errors import ConfigError, InputError
from hilbrace.material.bounds import hashin_shtrikman
from hilbrace.material.cell_atlas import add_cell, atlas, atlas_text, chosen_cells
from hilbrace.material.cell_figures import PAPERS_FIVE, cell_samples, order, papers_order
from hilbrace.material.curves import cell_digest, load_curves, load_microstructures, load_table
from hilbrace.material.skeleton_file import read_skeleton
from hilbrace.material.tables import main as tables_main

OWN = """
title = "My triangles"
polylines = [[[0, 0], [1, 0], [1, 1], [0, 1], [0, 0], [1, 1]]]
"""


@pytest.fixture(scope="module")
def own_cell(tmp_path_factory):
    path = tmp_path_factory.mktemp("cells") / "mine.toml"
    path.write_text(OWN, "utf-8")
    add_cell(str(path), 24)
    return path


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("atlas")
    return atlas(CELLS, 0.35, folder), folder


@pytest.mark.parametrize("name", CELLS)
def test_shipped_tables_belong_to_their_skeletons(name):
    table = load_table(name)
    assert table["skeleton"] == read_skeleton(name).digest
    assert table["cell"] == name
    assert len(table["columns"]["volume"]) == 25
    stated = read_skeleton(name).volume_range
    assert table["columns"]["volume"][0] == pytest.approx(stated[0], abs=1e-4)
    assert table["columns"]["volume"][-1] == pytest.approx(stated[1], abs=1e-4)


@pytest.mark.parametrize("name", CELLS)
def test_finer_grids_change_the_shipped_figures_less_and_less(name):
    study = load_table(name)["study"]
    assert study["pixels"] == [32, 64, 128, 256]
    steps = np.abs(np.diff(study["E_mean"]))
    assert (np.diff(steps) < 0).all()
    assert steps[-1] < 0.05 * study["E_mean"][-1]
    for key in ("D11", "D66"):
        bending = study[key]
        assert abs(bending[-1] / bending[-2] - 1) < 0.04


def test_the_figures_tell_every_cell_its_fit_and_its_distance_from_the_bounds(shown):
    figures, _ = shown
    assert [cell["name"] for cell in figures["cells"]] == list(CELLS)
    assert figures["bounds"]["hashin_shtrikman"] == pytest.approx(hashin_shtrikman(0.35), abs=1e-4)
    for cell in figures["cells"]:
        assert cell["samples"] == 25
        assert cell["monotone"]
        assert cell["f_E_mean_squared_error"] < 1e-4
        assert cell["f_V_mean_squared_error"] < 1e-4
        assert cell["least_margin_to_voigt"] > 0
        assert cell["least_margin_to_hashin_shtrikman"] > 0
        at = cell["at_volume"]
        assert at["E_mean"] == pytest.approx(
            np.interp(0.35, cell_samples(cell["name"]).volume, cell_samples(cell["name"]).modulus), rel=1e-3
        )
        assert min(at["E_1"], at["E_2"], at["E_45"]) <= at["E_mean"] <= max(at["E_1"], at["E_2"], at["E_45"])


def test_known_signs_of_poissons_ratio(shown):
    figures, _ = shown
    nu = {cell["name"]: cell["at_volume"]["nu_12"] for cell in figures["cells"]}
    assert nu["reentrant"] < -1 < 0 < nu["honeycomb"]
    reentrant = np.linalg.inv(cell_samples("reentrant").stiffness_at(0.35))
    assert -reentrant[0, 1] / reentrant[0, 0] == pytest.approx(nu["reentrant"], rel=1e-3)


def test_pictures_and_samples_are_written(shown):
    figures, folder = shown
    for name in ("cells", "moduli", "directions", "bending"):
        assert (folder / f"{name}.png").stat().st_size > 20_000
        assert (folder / f"{name}.svg").read_text("utf-8").lstrip().startswith("<?xml")
    with (folder / "cells.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 25 * len(CELLS)
    assert {row["cell"] for row in rows} == set(CELLS)
    for row in rows:
        assert float(row["E_fit"]) == pytest.approx(float(row["E_mean"]), abs=0.012)
        assert float(row["E_1"]) < float(row["voigt"])
    text = atlas_text(figures)
    assert all(name in text for name in CELLS)
    assert max(map(len, text.splitlines()[: len(CELLS) + 1])) < 140


def test_order_at_equal_volume_is_that_of_the_tables():
    cells = [cell_samples(name) for name in PAPERS_FIVE]
    ranges = order(cells)
    for part in ranges:
        volume = (part["volume_low"] + part["volume_high"]) / 2
        moduli = {
            cell.name: np.interp(volume, cell.volume, cell.modulus)
            for cell in cells
            if cell.name in part["compared"]
        }
        assert max(moduli, key=moduli.__getitem__) == part["stiffest"]
        assert min(moduli, key=moduli.__getitem__) == part["softest"]
    assert ranges[0]["volume_low"] == pytest.approx(0.10)


def test_the_papers_order_holds_for_five_cells_like_its_own_wherever_the_waves_are_apart():
    cells = [cell_samples(name) for name in PAPERS_FIVE]
    for volume in np.arange(0.15, 0.551, 0.05):
        moduli = {
            cell.name: np.interp(volume, cell.volume, cell.modulus)
            for cell in cells
            if cell.volume[0] - 1e-6 <= volume <= cell.volume[-1] + 1e-6
        }
        assert max(moduli, key=moduli.__getitem__) == "voronoi_tri"
        assert min(moduli, key=moduli.__getitem__) == "sinusoidal"
    sentences = papers_order([cell_samples(name) for name in CELLS])
    assert len(sentences) == 4
    # and where it does not hold, the sentences name the cell
    assert any("square" in sentence or "octagon" in sentence for sentence in sentences)


def test_a_cell_of_ones_own_is_homogenized_once_and_then_used_by_its_path(own_cell):
    name = str(own_cell)
    curves = load_curves(name)
    assert 0 < curves.modulus(0.0) < curves.modulus(1.0) < 0.5
    assert curves.volume(0.0) == pytest.approx(0.10, abs=5e-3)
    cells = load_microstructures("sinusoidal", name)
    assert cells.firm == curves
    assert (own_cell.parent / "mine.table.json").is_file()


@pytest.fixture
def no_pictures(monkeypatch):
    """Leave the drawing, which takes its seconds, to the test that looks at it."""
    monkeypatch.setattr("hilbrace.material.cell_atlas.write_pictures", _only_the_folder)


def _only_the_folder(cells, volume, folder):
    folder.mkdir(exist_ok=True)
    return []


def test_the_own_cell_is_shown_beside_others(own_cell, tmp_path):
    figures = atlas(["voronoi_tri", str(own_cell)], 0.3, tmp_path)
    assert [cell["title"] for cell in figures["cells"]] == ["Voronoi-tri", "My triangles"]
    assert figures["order"] == []
    assert "compare the sinusoidal grid" in atlas_text(figures)


def test_a_table_of_another_drawing_is_refused(own_cell, tmp_path):
    copy = tmp_path / "mine.toml"
    copy.write_text(OWN.replace("[0, 0], [1, 1]]]", "[0, 0]], [[0, 1], [1, 0]]]"), "utf-8")
    with pytest.raises(InputError, match="not been homogenized yet") as error:
        load_curves(str(copy))
    assert error.value.hint == f"run `hilbrace cells add {copy}`"
    table = copy.with_suffix(".table.json")
    table.write_bytes(own_cell.with_suffix(".table.json").read_bytes())
    with pytest.raises(InputError, match="of another drawing"):
        load_curves(str(copy))
    table.write_text("{", "utf-8")
    with pytest.raises(InputError, match="damaged"):
        load_curves(str(copy))


def test_the_digest_of_a_cell_follows_its_table(own_cell, tmp_path):
    copy = tmp_path / "mine.toml"
    copy.write_text(OWN, "utf-8")
    table = copy.with_suffix(".table.json")
    table.write_bytes(own_cell.with_suffix(".table.json").read_bytes())
    before = cell_digest(str(copy))
    assert before == cell_digest(str(own_cell))
    table.write_text(table.read_text("utf-8").replace('"poisson": 0.45', '"poisson": 0.44'), "utf-8")
    assert cell_digest(str(copy)) != before


def test_a_run_starts_anew_where_its_own_cell_changed_and_only_there(own_cell, tmp_path):
    from hilbrace.pipeline.runner import stage_key
    from hilbrace.pipeline.stages import STAGES

    copy = tmp_path / "mine.toml"
    table = copy.with_suffix(".table.json")
    copy.write_text(OWN, "utf-8")
    table.write_bytes(own_cell.with_suffix(".table.json").read_bytes())
    config = parse_config({"material": {"firm": str(copy)}}, "run.toml")
    stages = [stage for stage in STAGES if "motion" not in stage.sections]
    before = {stage.name: stage_key(stage, config, {}) for stage in stages}
    table.write_text(table.read_text("utf-8").replace('"poisson": 0.45', '"poisson": 0.44'), "utf-8")
    changed = [stage.name for stage in stages if stage_key(stage, config, {}) != before[stage.name]]
    assert changed == [stage.name for stage in stages if "material" in stage.sections]
    assert {"optimize", "pattern"} <= set(changed)


def test_a_run_with_a_cell_that_has_no_table_stops_before_its_first_stage(tmp_path):
    from hilbrace.pipeline import run_stages

    (tmp_path / "mine.toml").write_text(OWN, "utf-8")
    config = parse_config({"material": {"firm": str(tmp_path / "mine.toml")}}, "run.toml")
    with pytest.raises(InputError, match="not been homogenized yet"):
        run_stages(config, tmp_path / "run", quiet=True)
    assert not (tmp_path / "run").exists()


def test_words_of_the_command():
    assert chosen_cells([]) == ([], list(CELLS))
    assert chosen_cells(["star", "star", "a.toml"]) == ([], ["star", "a.toml"])
    assert chosen_cells(["add", "a.toml"]) == (["a.toml"], [*CELLS, "a.toml"])
    for words in (["add"], ["add", "star"]):
        with pytest.raises(ConfigError):
            chosen_cells(words)


def test_the_configuration_knows_cells_by_name_and_by_path(tmp_path):
    for name in (*CELLS, "cells/mine.toml"):
        assert parse_config({"material": {"firm": name, "soft": name}}, "run.toml").material.firm == name
    with pytest.raises(ConfigError, match=r"'material\.soft' = 'hexagons'"):
        parse_config({"material": {"soft": "hexagons"}}, "run.toml")


def test_a_path_in_a_run_file_is_relative_to_it(tmp_path):
    from hilbrace.config import read_config

    file = tmp_path / "run.toml"
    file.write_text('[material]\nfirm = "cells/mine.toml"\n', "utf-8")
    material = read_config(file).material
    assert material.firm == str((tmp_path / "cells" / "mine.toml").resolve())
    assert material.soft == "sinusoidal"


def test_the_command_takes_in_a_cell_and_tells_one_json_object(tmp_path, capsys, no_pictures):
    path = tmp_path / "grid.toml"
    path.write_text("polylines = [[[0.5, 0], [0.5, 1]], [[0, 0.5], [1, 0.5]]]\n", "utf-8")
    out = tmp_path / "out"
    assert main(["cells", "add", str(path), "--pixels", "16", "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["cells"][-1]["name"] == str(path)
    assert told["files"] == [str(out / "cells.csv")]
    assert main(["cells", "star", str(path), "--out", str(out)]) == 0
    assert "E mean" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "code", "named"),
    [
        (["cells", "starr"], 3, "did you mean 'star'?"),
        (["cells", "none.toml"], 2, "none.toml"),
        (["cells", "add", "none.toml"], 2, "none.toml"),
        (["cells", "add"], 3, "no skeleton file is named"),
        (["cells", "star", "--volume", "1.5"], 3, "--volume"),
        (["cells", "star", "--volume", "nan"], 3, "--volume"),
        (["cells", "add", "x.toml", "--pixels", "2"], 3, "--pixels"),
    ],
)
def test_wrong_words_are_named_in_two_lines(words, code, named, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == code
    told = capsys.readouterr().err
    assert named in told
    assert len(told.splitlines()) == 2
    assert not (tmp_path / "hilbrace-cells").exists()


def test_a_broken_skeleton_is_refused_before_any_work(tmp_path, capsys):
    path = tmp_path / "gap.toml"
    path.write_text("polylines = [[[0.5, 0], [0.5, 0.4]], [[0, 0.5], [1, 0.5]]]\n", "utf-8")
    assert main(["cells", "add", str(path)]) == 2
    assert "open gap" in capsys.readouterr().err
    assert not path.with_suffix(".table.json").exists()


def test_the_program_of_the_tables_names_what_it_wrote(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("hilbrace.material.tables.make_table", lambda name: {"cell": name, "d": [0.0, 1.0]})
    assert tables_main(["--out", str(tmp_path), "star"]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "star.json")
    assert '"d": [0.0, 1.0]' in (tmp_path / "star.json").read_text("utf-8").replace(
        "[ 0.0, 1.0 ]", "[0.0, 1.0]"
    )
