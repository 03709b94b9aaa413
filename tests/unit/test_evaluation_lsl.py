"""LSL streams from a sender in a process of its own, both kept to the loopback address."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evaluation.sources.lsl import load_pylsl, marker_labels
from hilbrace.errors import InputError

ROOT = Path(__file__).resolve().parents[2]

ONLY_HERE = """
[multicast]
ResolveScope = machine
ListenAddress = 127.0.0.1
[lab]
KnownPeers = {127.0.0.1}
[log]
level = -3
"""

SENDER = """
import sys, time, pylsl
labels, unit, rate = sys.argv[2].split(","), sys.argv[3], float(sys.argv[4])
info = pylsl.StreamInfo(sys.argv[1], "test", len(labels), rate, "float32", "sender")
info.set_channel_labels(labels)
info.set_channel_units([unit] * len(labels))
outlet = pylsl.StreamOutlet(info)
print("ready", flush=True)
outlet.wait_for_consumers(20)
start = pylsl.local_clock()
for k in range(int(sys.argv[5])):
    at = start + k / rate + (0.5 if k >= 60 else 0.0)
    time.sleep(max(0, start + k / rate - pylsl.local_clock()))
    outlet.push_sample([float(k + 1000 * c) for c in range(len(labels))], at)
time.sleep(0.3)
"""

READER = """
import json, sys, time
from evaluation.sources.lsl import LslStream
from evaluation.sources.stream import LabError, MarkerFrame, PlateSamples, SourceEvent
from hilbrace.errors import HilbraceError
from tests.unit.plate_mocks import built_calibration
source = LslStream("lab", sys.argv[1], built_calibration() if sys.argv[2] == "counts" else None)
told = {"values": [], "numbers": [], "times": [], "gaps": [], "error": ""}
try:
    info = source.open()
    told |= {"labels": info.labels, "plates": len(info.plates), "device": info.device}
    end = time.monotonic() + 20
    while time.monotonic() < end:
        for item in source.read(0.1):
            if isinstance(item, MarkerFrame):
                told["values"].append(item.positions.tolist())
                told["numbers"].append(item.number)
                told["times"].append(item.device_time_s)
            elif isinstance(item, PlateSamples):
                told["values"] += item.values.tolist()
                told["numbers"] += range(item.number, item.number + len(item.values))
            elif isinstance(item, SourceEvent):
                told["gaps"].append(item.lost)
except HilbraceError as fault:
    told["error"] = fault.what
source.close()
print(json.dumps(told))
"""


@pytest.fixture
def here(tmp_path):
    """An environment in which LSL stays on this machine."""
    pytest.importorskip("pylsl", reason="the extra lsl is not installed", exc_type=ImportError)
    settings = tmp_path / "lsl.cfg"
    settings.write_text(ONLY_HERE)
    return {**os.environ, "LSLAPICFG": str(settings), "PYTHONPATH": str(ROOT)}


def receive(here: dict, stream: str, kind: str) -> dict:
    command = [sys.executable, "-c", READER, stream, kind]
    result = subprocess.run(
        command, env=here, cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    return json.loads(result.stdout)


def exchange(here: dict, labels: str, unit: str, kind: str = "") -> dict:
    """What a reader says about 120 samples at 100 Hz with half a second missing before the 61st."""
    stream = f"hilbrace test {os.getpid()} {kind or unit}"
    command = [sys.executable, "-c", SENDER, stream, labels, unit, "100", "120"]
    with subprocess.Popen(command, env=here, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as sender:
        assert sender.stdout is not None
        assert sender.stdout.readline().strip() == b"ready"
        try:
            return receive(here, stream, kind)
        finally:
            sender.terminate()


def test_markers_arrive_in_metres_with_the_gap_of_their_time_stamps(here):
    got = exchange(here, "TH1.x,TH1.y,TH1.z,SH1.x,SH1.y,SH1.z", "millimeters")
    assert got["labels"] == ["TH1", "SH1"]
    assert got["numbers"] == list(range(120))
    assert got["gaps"] == [50]
    sent = [[1e-3 * (k + 1000 * c) for c in range(6)] for k in range(120)]
    np.testing.assert_allclose(np.reshape(got["values"], (120, 6)), sent, rtol=1e-6)
    np.testing.assert_allclose(
        np.diff(got["times"]), [0.51 if k == 59 else 0.01 for k in range(119)], atol=1e-6
    )
    assert "ended" in got["error"]


def test_a_plate_of_counts_arrives_as_it_is(here):
    got = exchange(here, ",".join(f"ch{k}" for k in range(8)), "count", "counts")
    assert got["plates"] == 1
    assert got["numbers"] == list(range(120))
    assert got["values"] == [[float(k + 1000 * c) for c in range(8)] for k in range(120)]
    assert got["gaps"] == [50]


def test_streams_that_are_not_there_or_not_understood_say_so(here):
    assert "no stream 'nobody'" in receive(here, "nobody", "")["error"]
    assert "a plate of counts needs a calibration" in exchange(here, "a,b,c", "count")["error"]


def test_without_pylsl_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(InputError, match="need pylsl") as caught:
        load_pylsl()
    assert "hilbrace[lsl]" in caught.value.hint


@pytest.mark.parametrize(
    ("channels", "labels"),
    [
        (("A.x", "A.y", "A.z", "B.x", "B.y", "B.z"), ("A", "B")),
        (("A_1_x", "A_1_y", "A_1_z"), ("A_1",)),
        (("A.x", "A.z", "A.y"), ()),
        (("A.x", "A.y"), ()),
        (("x", "y", "z"), ()),
        (("Fx", "Fy", "Fz", "Mx", "My", "Mz"), ()),
    ],
)
def test_markers_are_known_by_their_labels(channels, labels):
    assert marker_labels(channels) == labels
