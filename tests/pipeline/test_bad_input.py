"""Bad input through the command line: an exit code, two lines, and the mend; never a traceback."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from hilbrace.cli import main
from hilbrace.motion.synthetic import generate, write_recording

Files = dict[str, Path]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """A synthetic squat as a laboratory's files."""
    return write_recording(generate("squat", rate_hz=100.0), tmp_path_factory.mktemp("recording"))


def _settings(files: Files) -> dict:
    return {
        "subject": {"mass_kg": 75.3, "height_m": 1.70},
        "motion": {
            "markers": str(files["trc"]),
            "static": str(files["static_trc"]),
            "forces": str(files["grf"]),
            "window": [0.5, 0.9],
        },
    }


def _copy(files: Files, folder: Path) -> Files:
    copies = {}
    for name, path in files.items():
        copies[name] = folder / path.name
        copies[name].write_bytes(path.read_bytes())
    return copies


def _refused(settings: dict, folder: Path, capsys: pytest.CaptureFixture[str], until: str = "motion") -> str:
    """Run, and return the two lines of the refusal."""
    (folder / "run.toml").write_text(tomli_w.dumps(settings))
    code = main(["run", str(folder / "run.toml"), "--out", str(folder / "out"), "--until", until])
    said = capsys.readouterr().err
    lines = [
        line for line in said.strip().splitlines() if not re.match(r"^\w+ +(\d+\.\d s|unchanged)$", line)
    ]
    assert code not in (0, 1), said
    assert len(lines) == 2, said
    assert lines[1].strip().startswith("mend: ")
    return "\n".join(lines)


def _replace(path: Path, old: str, new: str, count: int = 1) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


def _cells(path: Path, change: Callable[[list[str], np.ndarray], None]) -> None:
    """Change the table of a MOT file: names and values are handed over together."""
    head, body = path.read_text().split("endheader\n")
    lines = body.splitlines()
    names = lines[0].split("\t")
    values = np.array([[float(cell) for cell in line.split()] for line in lines[1:]])
    change(names, values)
    rows = ["\t".join(f"{value:.9g}" for value in row) for row in values]
    path.write_text(head + "endheader\n" + "\n".join(["\t".join(names), *rows]) + "\n")


def test_the_files_as_written_are_accepted(recording: Files, tmp_path: Path):
    (tmp_path / "run.toml").write_text(tomli_w.dumps(_settings(_copy(recording, tmp_path))))
    words = ["run", str(tmp_path / "run.toml"), "--out", str(tmp_path / "out"), "--until", "motion"]
    assert main(words) == 0


def test_missing_file(recording: Files, tmp_path: Path, capsys):
    files = _copy(recording, tmp_path)
    files["trc"].unlink()
    assert files["trc"].name in _refused(_settings(files), tmp_path, capsys)


def test_truncated_c3d(recording: Files, tmp_path: Path, capsys):
    files = _copy(recording, tmp_path)
    content = files["c3d"].read_bytes()
    files["c3d"].write_bytes(content[: int(0.8 * len(content))])
    settings = _settings(files)
    settings["motion"] |= {"markers": str(files["c3d"]), "static": str(files["static_c3d"])}
    del settings["motion"]["forces"]
    text = _refused(settings, tmp_path, capsys)
    assert files["c3d"].name in text
    assert re.search("truncated|cut|short|bytes", text)


def test_trc_without_units(recording: Files, tmp_path: Path, capsys):
    files = _copy(recording, tmp_path)
    lines = files["trc"].read_text().split("\n")
    keys, values = lines[1].split("\t"), lines[2].split("\t")
    place = keys.index("Units")
    del keys[place], values[place]
    lines[1], lines[2] = "\t".join(keys), "\t".join(values)
    files["trc"].write_text("\n".join(lines))
    text = _refused(_settings(files), tmp_path, capsys)
    assert "nits" in text
    assert files["trc"].name in text


def test_unknown_marker_names_are_listed_both_ways(recording: Files, tmp_path: Path, capsys):
    files = _copy(recording, tmp_path)
    for name in ("trc", "static_trc"):
        _replace(files[name], "RASI", "Strange")
    text = _refused(_settings(files), tmp_path, capsys)
    assert "Strange" in text
    assert "RASI" in text


def test_forces_in_the_wrong_columns(recording: Files, tmp_path: Path, capsys):
    files = _copy(recording, tmp_path)

    def swap(names: list[str], values: np.ndarray) -> None:
        up = [i for i, name in enumerate(names) if name.endswith("_vy")]
        side = [i for i, name in enumerate(names) if name.endswith("_vz")]
        values[:, [*up, *side]] = values[:, [*side, *up]]

    _cells(files["grf"], swap)
    text = _refused(_settings(files), tmp_path, capsys)
    assert files["grf"].name in text
    assert "_v" in text


def test_centre_of_pressure_may_be_missing_only_without_load(recording: Files, tmp_path: Path, capsys):
    files = _copy(recording, tmp_path)

    def unloaded(names: list[str], values: np.ndarray) -> None:
        force = [i for i, name in enumerate(names) if re.search(r"_r_v[xyz]$", name)]
        point = [i for i, name in enumerate(names) if re.search(r"_r_p[xyz]$", name)]
        values[:3, force] = 0.0
        values[:3, point] = np.nan

    _cells(files["grf"], unloaded)
    settings = _settings(files)
    settings["motion"]["window"] = [0.0, 0.9]
    (tmp_path / "run.toml").write_text(tomli_w.dumps(settings))
    words = ["run", str(tmp_path / "run.toml"), "--out", str(tmp_path / "low"), "--until", "motion"]
    assert main(words) == 0
    capsys.readouterr()

    def loaded(names: list[str], values: np.ndarray) -> None:
        values[60, [i for i, name in enumerate(names) if name.endswith("_r_px")]] = np.nan

    _cells(files["grf"], loaded)
    text = _refused(settings, tmp_path, capsys)
    assert files["grf"].name in text
    assert re.search("0.6|frame|row", text)


def test_millimetres_called_metres(recording: Files, tmp_path: Path, capsys):
    files = _copy(recording, tmp_path)
    for name in ("trc", "static_trc"):
        lines = files[name].read_text().split("\n")
        for row in range(6, len(lines)):
            cells = lines[row].split("\t")
            if len(cells) > 3:
                lines[row] = "\t".join([*cells[:2], *(f"{1000 * float(c):.3f}" for c in cells[2:] if c)])
        files[name].write_text("\n".join(lines))
    text = _refused(_settings(files), tmp_path, capsys)
    assert "millimetres called metres" in text


def test_empty_window(recording: Files, tmp_path: Path, capsys):
    settings = _settings(_copy(recording, tmp_path))
    settings["motion"]["window"] = [90.0, 91.0]
    assert "window" in _refused(settings, tmp_path, capsys)


@pytest.mark.parametrize(("name", "value"), [("above", 0.0), ("below", -0.2)])
def test_empty_region(name: str, value: float, recording: Files, tmp_path: Path, capsys):
    """A region without height; skin that is missing altogether is tested with the region itself."""
    settings = _settings(_copy(recording, tmp_path))
    settings["domain"] = {name: value}
    assert f"domain.{name}" in _refused(settings, tmp_path, capsys, until="domain")


def test_bands_that_leave_no_pattern(recording: Files, tmp_path: Path, capsys):
    settings = _settings(_copy(recording, tmp_path))
    settings["domain"] = {"triangles": 600}
    settings["pattern"] = {"rim_mm": 300.0}
    assert "pattern.rim_mm" in _refused(settings, tmp_path, capsys, until="optimize")


def test_a_typing_error_in_the_configuration(recording: Files, tmp_path: Path, capsys):
    settings = _settings(_copy(recording, tmp_path))
    settings["domain"] = {"sid": "left"}
    text = _refused(settings, tmp_path, capsys)
    assert "domain.sid" in text
    assert "domain.side" in text


def test_no_motion_is_named(tmp_path: Path, capsys):
    text = _refused({"subject": {"name": "nobody"}}, tmp_path, capsys)
    assert "motion.markers" in text
