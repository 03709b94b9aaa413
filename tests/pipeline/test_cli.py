"""The command line as a person or a script meets it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import hilbrace
from hilbrace.cli import STAGES, main


def test_help_has_an_example_for_every_command(capsys: pytest.CaptureFixture[str]):
    for words in (
        ["--help"],
        ["demo", "--help"],
        ["run", "--help"],
        ["show", "--help"],
        ["doctor", "--help"],
    ):
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert stop.value.code == 0
        assert "example: hilbrace" in capsys.readouterr().out


def test_help_imports_none_of_the_heavy_libraries():
    code = (
        "import sys, hilbrace.cli\n"
        "try: hilbrace.cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "names = {'torch', 'numpy', 'scipy', 'opensim', 'matplotlib', 'trimesh', 'pydantic'}\n"
        "heavy = names & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "code", "parts"),
    [
        (["run", "none/run.toml"], 3, ["none/run.toml", "hilbrace demo"]),
        (["run", "{tmp}"], 3, ["run.toml"]),
        (["show", "{tmp}"], 2, ["no run in this folder"]),
        (
            ["demo", "--set", "domain.trianlges=900"],
            3,
            ["domain.trianlges", "did you mean 'domain.triangles'?"],
        ),
        (["demo", "--set", "triangles"], 3, ["--set section.key=value"]),
    ],
)
def test_errors_are_two_lines_with_a_mend(
    words, code, parts, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main([word.format(tmp=tmp_path) for word in words]) == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 2
    assert lines[1].strip().startswith("mend:")
    for part in parts:
        assert part in "\n".join(lines)


def test_json_errors_are_one_object_on_standard_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["show", str(tmp_path), "--json"]) == 2
    content = json.loads(capsys.readouterr().out)
    assert content["error"] == "InputError"
    assert content["mend"]


def test_the_command_line_knows_the_stages():
    from hilbrace.pipeline.stages import STAGES as KNOWN

    assert tuple(stage.name for stage in KNOWN) == STAGES


def test_stages_read_only_what_comes_before_them():
    from hilbrace.pipeline.stages import STAGES as KNOWN

    for index, stage in enumerate(KNOWN):
        assert set(stage.needs) <= {earlier.name for earlier in KNOWN[:index]}


def test_doctor_answers_in_json_and_leaves_nothing_behind(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = main(["doctor", "--json"])
    assert list(tmp_path.iterdir()) == []
    findings = json.loads(capsys.readouterr().out)
    assert code == 0
    assert findings["healthy"]
    assert findings["opensim_worker"]["answers"]
    assert findings["hilbrace"] == hilbrace.__version__
    assert findings["packages"]["torch"]


def test_a_person_s_configuration_is_not_rewritten(tmp_path: Path):
    """Comments in a run folder's own ``run.toml`` survive; with ``--set`` the old file is kept beside."""
    text = '# my study\n[motion]\nsynthetic = "squat"\nwindow = [0.5, 0.8]\n'
    (tmp_path / "run.toml").write_text(text)
    assert main(["run", str(tmp_path), "--until", "motion", "--json"]) == 0
    assert (tmp_path / "run.toml").read_text() == text
    words = ["run", str(tmp_path), "--until", "motion", "--json", "--set", "motion.cutoff_hz=15"]
    assert main(words) == 0
    assert (tmp_path / "run.toml.before").read_text() == text
    assert "cutoff_hz = 15" in (tmp_path / "run.toml").read_text()
