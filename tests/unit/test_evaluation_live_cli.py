"""``hilbrace evaluate live | record | recover | devices`` as a laboratory meets them."""

from __future__ import annotations

import json
import socket
import subprocess
import sys

import pytest

from evaluation.record.reading import read_log
from evaluation.sources import serial_port
from hilbrace.cli import main
from mocks import synthetic_study as made_up


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    return made_up.write_study(tmp_path_factory.mktemp("lab"), seed=2, seconds=4.0, repeats=1).parent


def test_every_command_has_help_with_an_example(capsys):
    for name in ("live", "record", "recover", "devices"):
        with pytest.raises(SystemExit) as stop:
            main(["evaluate", name, "--help"])
        assert stop.value.code == 0
        assert f"example: hilbrace evaluate {name}" in capsys.readouterr().out


def test_help_imports_nothing_heavy():
    code = (
        "import sys, hilbrace.cli\n"
        "try: hilbrace.cli.main(['evaluate', 'live', '--help'])\n"
        "except SystemExit: pass\n"
        "names = {'numpy', 'scipy', 'aiohttp', 'mcap', 'serial', 'pydantic', 'qtm_rt', 'pylsl'}\n"
        "sys.exit(', '.join(names & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_record_a_replay_and_recover_it(trial, tmp_path, capsys):
    out = tmp_path / "take.mcap"
    address = f"c3d://{trial}/unbraced_1.c3d?speed=20"
    words = ["evaluate", "record", address, "--out", str(out), "--condition", "Unbraced", "--c3d", "--json"]
    assert main(words) == 0
    shown = capsys.readouterr()
    said = json.loads(shown.out)
    assert shown.err == ""
    assert (said["frames"], said["samples"], said["lost"], said["dropped"]) == (800, 4000, 0, 0)
    assert said["devices"] == [
        {"name": "c3d", "state": "ended", "lost": 0, "drift_ppm": None, "drift_error_ppm": None}
    ]
    assert said["notes"] == []
    assert read_log(out).condition == "Unbraced"
    again = main([*words[:-2], "--json"])
    assert again == 0
    assert json.loads(capsys.readouterr().out)["recording"].endswith("take_2.mcap")

    content = out.read_bytes()
    out.with_name("cut.mcap").write_bytes(content[: len(content) // 2])
    assert main(["evaluate", "recover", str(tmp_path / "cut.mcap"), "--c3d"]) == 0
    text = capsys.readouterr().out
    assert "was cut" in text
    assert "without having been closed" in text
    assert (tmp_path / "cut_recovered.c3d").is_file()
    assert main(["evaluate", "recover", str(tmp_path / "absent.mcap"), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["what"] == "no such recording"


def test_the_converted_file_measures_as_the_original(trial, tmp_path, capsys):
    out = tmp_path / "take.mcap"
    main(["evaluate", "record", f"c3d://{trial}/unbraced_1.c3d?speed=50", "--out", str(out), "--c3d"])
    text = (trial / "study.toml").read_text().split("[[conditions]]")[0]
    assert text.count("standing.c3d") == 1
    for name, file in (("ours", out.with_suffix(".c3d")), ("theirs", trial / "unbraced_1.c3d")):
        path = tmp_path / f"{name}.toml"
        standing = text.replace("standing.c3d", str(trial / "standing.c3d"))
        path.write_text(f'{standing}\n[[conditions]]\nname = "Unbraced"\ntrials = ["{file}"]\n')
        assert main(["evaluate", "angles", str(path), "--out", str(tmp_path / name)]) == 0
    (ours,), (theirs,) = ((tmp_path / name / "angles").glob("*.csv") for name in ("ours", "theirs"))
    assert ours.read_text() == theirs.read_text()


def test_nobody_answers(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    assert main(["evaluate", "record", f"vicon://127.0.0.1:{port}", "--seconds", "1"]) == 7
    shown = capsys.readouterr().err
    assert shown.startswith("LabError: ")
    assert shown.count("\n") == 2
    assert main(["evaluate", "devices", f"vicon://127.0.0.1:{port}", "--json"]) == 7
    (check,) = json.loads(capsys.readouterr().out)["devices"]
    assert check["answers"] is False


def test_devices_tests_a_connection_and_lists_ports(trial, capsys, monkeypatch):
    assert main(["evaluate", "devices", f"c3d://{trial}/unbraced_1.c3d", "--seconds", "0.5", "--json"]) == 0
    (check,) = json.loads(capsys.readouterr().out)["devices"]
    assert check["answers"]
    assert (len(check["labels"]), check["rate_hz"], check["lost"]) == (13, 200.0, 0)
    monkeypatch.setattr(serial_port.list_ports, "comports", list)
    assert main(["evaluate", "devices"]) == 0
    assert capsys.readouterr().out == "no serial port on this computer\n"


def test_live_needs_a_device_and_a_free_port(trial, tmp_path, capsys):
    lab = tmp_path / "lab.toml"
    lab.write_text(
        'baseline = "A"\n[[conditions]]\nname = "A"\n[protocol]\nside = "left"\nhip = { model = "marker" }\n'
    )
    assert main(["evaluate", "live", str(lab)]) == 3
    assert "no device is named" in capsys.readouterr().err
    device = ["--device", f"c3d://{trial}/unbraced_1.c3d"]
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["evaluate", "live", str(lab), *device, "--port", port]) == 2
    assert "cannot open the dashboard" in capsys.readouterr().err
    assert main(["evaluate", "live", str(lab), *device, "--port", "0", "--seconds", "1", "--json"]) == 0
    shown = capsys.readouterr()
    assert "open http://127.0.0.1:" in shown.err
    assert json.loads(shown.out)["loss"]["lost"] == 0
    assert (tmp_path / "recordings").is_dir()
