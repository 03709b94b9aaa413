"""The OpenSim process: what it refuses, how it fails, what it leaves behind."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

import numpy as np
import pytest

from hilbrace.biomech.engine import Engine
from hilbrace.errors import InputError, SolverError

BUILD = {"bodies": ("femur_l",), "scales": np.array([[1.0, 1.1, 1.0]]), "mass_kg": 70.0}


def test_it_answers_silently_and_leaves_nothing_behind(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    told = []
    with Engine() as engine:
        figures = engine.call("build_model", **BUILD)
        frames = np.zeros((300, len(figures["coordinates"])))
        poses = engine.call(
            "poses", progress=lambda done, total: told.append((done, total)), coordinates=frames
        )
    assert figures["masses"].sum() == pytest.approx(70.0)
    assert poses["rotations"].shape == (300, 22, 3, 3)
    assert told[-1] == (300, 300)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")
    assert engine.pid is None
    assert "opensim" not in sys.modules


def test_a_refused_call_keeps_its_error_and_the_engine():
    with Engine() as engine:
        with pytest.raises(InputError) as refused:
            engine.call("build_model", bodies=("tail",), scales=np.ones((1, 3)), mass_kg=70.0)
        assert "tail" in str(refused.value)
        assert refused.value.hint
        assert engine.call("build_model", **BUILD)["muscles"] == 80


def test_an_unforeseen_failure_names_the_task_and_keeps_the_engine():
    with Engine() as engine:
        with pytest.raises(SolverError, match="unexpected keyword") as failed:
            engine.call("build_model", tail=1)
        assert failed.value.where == "build_model"
        assert "Traceback" in str(failed.value.__cause__)
        assert engine.call("build_model", **BUILD)["muscles"] == 80


def test_a_missing_model_file_is_named(tmp_path):
    with Engine() as engine, pytest.raises(InputError, match=r"absent\.osim"):
        engine.call("read_model", path=str(tmp_path / "absent.osim"))


@pytest.mark.parametrize("kind", [signal.SIGSEGV, signal.SIGKILL])
def test_a_crash_becomes_an_error(kind):
    with Engine() as engine:
        engine.call("build_model", **BUILD)
        threading.Timer(0.3, os.kill, (engine.pid, kind)).start()
        with pytest.raises(SolverError, match=kind.name) as crashed:
            engine.call("poses", coordinates=np.zeros((50_000, 41)))
        assert crashed.value.where == "poses"


def test_a_call_after_a_crash_is_an_error_too():
    with Engine() as engine:
        engine.call("build_model", **BUILD)
        os.kill(engine.pid, signal.SIGKILL)
        time.sleep(0.2)
        for _ in range(2):
            with pytest.raises(SolverError, match="SIGKILL"):
                engine.call("poses", coordinates=np.zeros((2, 41)))


def test_a_hang_ends_within_the_time_given():
    with Engine(silence_s=1.0) as engine:
        os.kill(engine.pid, signal.SIGSTOP)
        started = time.monotonic()
        with pytest.raises(SolverError, match="no sign for 1 s"):
            engine.call("poses", coordinates=np.zeros((2, 41)))
    assert time.monotonic() - started < 5.0


def test_it_works_only_inside_its_block():
    engine = Engine()
    with pytest.raises(SolverError, match="not running"):
        engine.call("poses", coordinates=np.zeros((1, 41)))


def test_a_python_without_opensim_is_told_so(tmp_path, monkeypatch):
    (tmp_path / "opensim.py").write_text("raise ImportError('no such wheel')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(SolverError, match="no such wheel") as missing, Engine():
        pass
    assert "pip install opensim" in missing.value.hint
