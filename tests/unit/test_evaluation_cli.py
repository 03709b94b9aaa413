"""``hilbrace evaluate`` as a laboratory meets it: files in, table, report and exit code out."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from hilbrace import cli
from hilbrace.cli import main
from mocks import synthetic_study as made_up

METHODS = ["paper", "per_trial", "two_landmark"]


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    """A made-up study of six conditions with three repeats, as C3D files."""
    return made_up.write_study(tmp_path_factory.mktemp("lab"), seed=4, repeats=3)


@pytest.fixture(scope="module")
def table(study) -> dict:
    """The table of that study; its files lie beside it."""
    folder = study.parent / "evaluation"
    done = subprocess.run(
        [sys.executable, "-m", "hilbrace", "evaluate", "table", str(study), "--json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stderr == ""
    assert {path.name for path in folder.iterdir()} == {
        "table.csv", "table.json", "events.toml", "report.html", "figures",
    }  # fmt: skip
    return json.loads(done.stdout)


def test_every_command_has_help_with_an_example(capsys):
    for words in (["angles"], ["table"], ["verify-pig"]):
        with pytest.raises(SystemExit) as stop:
            main(["evaluate", *words, "--help"])
        assert stop.value.code == 0
        assert "example: hilbrace evaluate" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "evaluate" in capsys.readouterr().out


def test_help_of_the_evaluation_imports_nothing_heavy():
    code = (
        "import sys, hilbrace.cli\n"
        "try: hilbrace.cli.main(['evaluate', 'table', '--help'])\n"
        "except SystemExit: pass\n"
        "names = {'torch', 'numpy', 'scipy', 'matplotlib', 'pydantic', 'rich'}\n"
        "sys.exit(', '.join(names & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_missing_package_is_a_clear_error(monkeypatch, capsys):
    monkeypatch.setattr(cli, "entry_points", lambda group: [])
    assert main(["evaluate", "table", "x.toml"]) == 3
    shown = capsys.readouterr().err
    assert "no installed package brings the command 'evaluate'" in shown
    assert shown.count("\n") == 2
    with pytest.raises(SystemExit):
        main(["--help"])


def test_a_package_that_does_not_load_is_a_clear_error(monkeypatch, capsys):
    point = cli.EntryPoint("evaluate", "evaluation.nowhere:add_commands", cli.COMMANDS)
    monkeypatch.setattr(cli, "entry_points", lambda group: [point])
    assert main(["evaluate", "table", "x.toml", "--json"]) == 3
    shown = capsys.readouterr()
    assert json.loads(shown.out)["error"] == "ConfigError"
    assert "does not load" in shown.err


def test_the_table_has_every_cell_by_every_method(table):
    keys = [(c["method"], c["condition"], c["event"], c["plane"]) for c in table["cells"]]
    assert len(set(keys)) == len(keys) == 3 * 6 * 2 * 2
    assert [*dict.fromkeys(key[0] for key in keys)] == METHODS
    assert table["conditions"][0] == table["baseline"] == "Unbraced"
    assert table["unit"] == "deg^2"
    assert table["synthetic"] is True
    assert all(cell["repeats"] == 3 for cell in table["cells"])
    assert [c["published_deg2"] for c in table["cells"][:4]] == [0.0, 0.825, 0.0, 16.519]


def test_the_table_is_near_what_was_planted(table):
    truth = made_up.planted_squares().ravel()
    for method in METHODS:
        cells = [cell for cell in table["cells"] if cell["method"] == method]
        signed = np.array([cell["signed_deg"] for cell in cells])
        assert np.abs(np.abs(signed) - np.sqrt(truth)).max() < 6.0
        inside = [
            c["squared_low_deg2"] - 1e-9 <= value <= c["squared_high_deg2"] + 1e-9
            for c, value in zip(cells, truth, strict=True)
        ]
        assert np.mean(inside) > 0.8


def test_csv_and_json_say_the_same(study, table):
    with (study.parent / "evaluation/table.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(table["cells"])
    for row, cell in zip(rows, table["cells"], strict=True):
        assert row["condition"] == cell["condition"]
        assert float(row["squared_deg2"]) == cell["squared_deg2"]
        assert float(row["signed_deg"]) ** 2 == pytest.approx(float(row["squared_deg2"]), abs=1e-6)
    stored = json.loads((study.parent / "evaluation/table.json").read_text())
    assert stored == {key: value for key, value in table.items() if key != "files"}


def test_the_report_stands_alone_and_says_what_it_is(study, table):
    page = (study.parent / "evaluation/report.html").read_text()
    assert "never of the measurement" in page
    assert page.count("data:image/svg+xml;base64,") == 4
    assert not re.search(r'(src|href)="(?!data:)', page)
    for name in table["conditions"]:
        assert name in page
    best = [c for c in table["cells"] if c["best"] and c["method"] == "paper"]
    assert len(best) == 4
    for cell in best:
        assert f"<b>{cell['squared_deg2']:.2f}</b>" in page
    for trial in table["trials"]:
        assert trial["trial"] in page
    pictures = {path.name for path in (study.parent / "evaluation/figures").iterdir()}
    assert {"mean_curves.svg", "mean_curves.png", "signed_differences.png"} <= pictures


def test_events_can_be_corrected_by_hand(study, table, tmp_path, capsys):
    events = tomllib.loads((study.parent / "evaluation/events.toml").read_text())["events"]
    assert len(events) == 18
    found = {row["trial"]: row["events"] for row in table["trials"]}
    assert events["optimized_2.c3d"]["landing_s"] == found["optimized_2"]["landing_s"]
    changed = tmp_path / "hand"
    shutil.copytree(study.parent, changed)
    text = (changed / "study.toml").read_text()
    (changed / "study.toml").write_text(text + '\n[events."optimized_2.c3d"]\nlanding_s = 2.0\n')
    assert main(["evaluate", "table", str(changed / "study.toml"), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    row = next(row for row in again["trials"] if row["trial"] == "optimized_2")
    assert row["events"]["found_by"] == "hand"
    assert row["events"]["landing_s"] == 2.0
    assert any("methods differ" in warning for warning in again["warnings"])


def test_the_same_files_give_the_same_bytes_and_the_terminal_says_where(study, table, tmp_path, capsys):
    assert main(["evaluate", "table", str(study), "--out", str(tmp_path)]) == 0
    for name in ("table.csv", "table.json", "report.html", "events.toml", "figures/mean_curves.svg"):
        assert (tmp_path / name).read_bytes() == (study.parent / "evaluation" / name).read_bytes()
    shown = capsys.readouterr().out
    assert "never of the measurement" in shown
    assert "paper 144.148" in shown
    assert "report.html" in shown


def test_angles_of_every_trial(study, tmp_path, capsys):
    assert main(["evaluate", "angles", str(study), "--out", str(tmp_path), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["convention"] == "paper"
    assert len(content["trials"]) == 18
    files = sorted((tmp_path / "angles").glob("*.csv"))
    assert len(files) == 18
    paper = np.genfromtxt(tmp_path / "angles/unbraced_1.csv", delimiter=",", names=True)
    assert paper["knee_sagittal_deg"].min() == pytest.approx(-70, abs=6)
    words = ["evaluate", "angles", str(study), "--out", str(tmp_path), "--convention", "plug_in_gait"]
    assert main(words) == 0
    gait = np.genfromtxt(tmp_path / "angles/unbraced_1.csv", delimiter=",", names=True)
    assert gait["knee_sagittal_deg"] == pytest.approx(-paper["knee_sagittal_deg"])
    assert gait["knee_frontal_deg"] == pytest.approx(paper["knee_frontal_deg"])
    assert "unbraced_1" in capsys.readouterr().out


def changed_study(study: Path, folder: Path, change) -> Path:
    """Another study file, of two of the conditions, that reads the same trials."""
    content = tomllib.loads(study.read_text())
    content["standing"] = str(study.parent / "standing.c3d")
    content["conditions"] = [content["conditions"][0], content["conditions"][-1]]
    for condition in content["conditions"]:
        condition["trials"] = [str(study.parent / name) for name in condition["trials"]]
    change(content["conditions"])
    path = folder / "study.toml"
    path.write_text(tomli_w.dumps(content))
    return path


def test_single_trials_have_no_intervals_and_no_nan(study, tmp_path, capsys):
    def keep_one(conditions):
        for condition in conditions:
            condition["trials"] = condition["trials"][:1]

    path = changed_study(study, tmp_path, keep_one)
    assert main(["evaluate", "table", str(path)]) == 0
    shown = capsys.readouterr()
    assert shown.out.count("a single trial has no confidence interval") == 2
    assert shown.err == ""
    page = re.sub(r"base64,[^\"]+", "", (tmp_path / "evaluation/report.html").read_text())
    assert not re.search(r"\bnan\b", page)
    content = json.loads((tmp_path / "evaluation/table.json").read_text(), parse_constant=pytest.fail)
    frontal = [cell for cell in content["cells"] if cell["plane"] == "frontal"]
    assert all(cell["ci_low_deg"] is None and cell["unbiased_deg2"] is None for cell in frontal)


def test_names_are_printed_as_they_are(study, tmp_path, capsys):
    def rename(conditions):
        conditions[1]["name"] = "Brace [/b] :bug: <b>"

    path = changed_study(study, tmp_path, rename)
    assert main(["evaluate", "table", str(path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "Brace [/b]" in shown
    assert ":bug:" in shown
    assert "Brace [/b] :bug: &lt;b&gt;" in (tmp_path / "evaluation/report.html").read_text()


def test_trials_of_one_name_in_two_folders_get_two_files_and_two_events(study, tmp_path, capsys):
    def in_folders(conditions):
        for folder, condition in zip(("none", "brace"), conditions, strict=True):
            (tmp_path / folder).mkdir()
            for number, name in enumerate(condition["trials"], 1):
                shutil.copy(name, tmp_path / folder / f"T{number}.c3d")
            condition["trials"] = f"{folder}/*.c3d"

    path = changed_study(study, tmp_path, in_folders)
    assert main(["evaluate", "angles", str(path)]) == 0
    assert len(list((tmp_path / "evaluation/angles").glob("*.csv"))) == 6
    assert main(["evaluate", "table", str(path)]) == 0
    events = tomllib.loads((tmp_path / "evaluation/events.toml").read_text())["events"]
    assert sorted(events) == [
        f"{folder}/T{number}.c3d" for folder in ("brace", "none") for number in (1, 2, 3)
    ]
    with path.open("a") as stream:
        stream.write((tmp_path / "evaluation/events.toml").read_text())
    assert main(["evaluate", "table", str(path), "--json"]) == 0
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "code", "parts"),
    [
        (["table", "none.toml"], 3, ["no such study file", "none.toml"]),
        (["verify-pig", "none.c3d"], 2, ["no such file", "none.c3d"]),
    ],
)
def test_errors_are_two_lines(words, code, parts, capsys):
    assert main(["evaluate", *words]) == code
    shown = capsys.readouterr().err
    assert shown.count("\n") == 2
    for part in parts:
        assert part in shown


def test_a_trial_with_a_moved_cluster_stops_the_table_by_name(study, tmp_path, capsys):
    changed = tmp_path / "moved"
    shutil.copytree(study.parent, changed)
    text = (changed / "study.toml").read_text()
    swapped = text.replace("[protocol]\n", '[protocol]\nmarkers = { thigh = ["TH2", "TH1", "TH3", "TH4"] }\n')
    assert swapped != text
    (changed / "study.toml").write_text(swapped)
    standing = changed / "standing.c3d"
    content = standing.read_bytes()
    standing.write_bytes(content.replace(b"Nobody:TH1", b"Nobody:THX").replace(b"Nobody:TH3", b"Nobody:TH1")
                         .replace(b"Nobody:THX", b"Nobody:TH3"))  # fmt: skip
    assert main(["evaluate", "table", str(changed / "study.toml")]) == 2
    shown = capsys.readouterr().err
    assert "thigh cluster does not have its standing shape: residual" in shown
    assert "unbraced_1.c3d" in shown


def test_stored_plug_in_gait_angles(shared_data, capsys):
    folder = shared_data / "c3d_plugin_gait"
    files = [str(path) for path in sorted(folder.rglob("*.c3d"))]
    assert main(["evaluate", "verify-pig", *files, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["agrees"]
    assert len(content["checks"]) == 42
    assert max(max(check["largest_deg"]) for check in content["checks"]) < 1e-3
    other = str(shared_data / "c3d_cluster_protocol/2022_01_0401.c3d")
    assert main(["evaluate", "verify-pig", files[0], other]) == 1
    shown = capsys.readouterr().out
    assert "reproduced" in shown
    assert "RMS [deg]" in shown
    assert "no Plug-in Gait angles" in shown
