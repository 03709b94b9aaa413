"""Addresses of devices: what they lead to, and what is said about mistakes."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.sources.addresses import EXAMPLES, open_addresses, parse_address
from evaluation.sources.amti_plate import AmtiPlate
from evaluation.sources.c3d_replay import C3DReplay
from evaluation.sources.lsl import LslStream
from evaluation.sources.qualisys import QualisysSource
from evaluation.sources.serial_plate import SerialPlate
from evaluation.sources.vicon import ViconSource
from hilbrace.errors import InputError


@pytest.fixture
def calibration(tmp_path):
    path = tmp_path / "plate.txt"
    path.write_text("\n".join(" ".join(f"{v:.3f}" for v in row) for row in np.eye(6, 12)))
    return f"calibration={path}&units=N, N*m"


def test_every_kind_of_device(calibration, tmp_path):
    sources = open_addresses(
        [
            "vicon://10.0.0.1",
            "vicon://10.0.0.2:802?name=left",
            "vicon://10.0.0.3",
            "qualisys://qtm.lab:22223",
            f"serial:///dev/ttyUSB0?protocol=cobs&x=0.3&heading=90&{calibration}",
            f"serial://COM3?protocol=lines&baud=115200&{calibration}",
            f"amti:///dev/ttyS0?rate=100&{calibration}",
            "lsl://ForcePlate",
            f"c3d://{tmp_path}/trial.c3d?speed=2&up=y",
        ]
    )
    assert [source.name for source in sources] == [
        "vicon", "left", "vicon_3", "qualisys", "serial", "serial_2", "amti", "lsl", "c3d",
    ]  # fmt: skip
    kinds = [ViconSource] * 3 + [QualisysSource, SerialPlate, SerialPlate, AmtiPlate, LslStream, C3DReplay]
    assert [type(source) for source in sources] == kinds
    assert sources[1].address == "10.0.0.2:802"


def test_places_behind_the_slashes():
    assert parse_address("serial:///dev/ttyUSB0").place == "/dev/ttyUSB0"
    assert parse_address("serial://COM3").place == "COM3"
    assert parse_address("lsl://Force%20Plate").host == "Force Plate"
    assert parse_address("vicon://[::1]:801").host == "::1"


def test_examples_are_addresses():
    for scheme, example in EXAMPLES.items():
        assert parse_address(example).scheme == scheme


@pytest.mark.parametrize(
    ("address", "what", "hint"),
    [
        ("vicom://10.0.0.1", "no address", "vicon://"),
        ("10.0.0.1", "no address", "qualisys://"),
        ("vicon:10.0.0.1", "no address", "vicon://"),
        ("vicon://", "computer is missing", "vicon://"),
        ("vicon://10.0.0.1:port", "Port", "vicon://"),
        ("vicon://10.0.0.1?nam=x", "unknown option 'nam'", "known are name"),
        ("serial:///dev/ttyUSB0", "needs its calibration", "calibration=FILE"),
        ("serial:///dev/ttyUSB0?protokol=cobs", "unknown option 'protokol'", "'protocol'"),
        ("serial:///dev/ttyUSB0?protocol=usb", "unknown protocol", "lines"),
        ("serial://?calibration=x", "port is missing", "serial://"),
        ("c3d://", "file is missing", "c3d://"),
        ("c3d:///x.c3d?speed=fast", "no number", "number"),
        ("c3d:///x.c3d?up=x", "no vertical axis", "up=z"),
        ("lsl://", "name of the stream is missing", "lsl://"),
        ("amti:///dev/ttyS0?calibration=absent.acl", "cannot be read", "path"),
    ],
)
def test_mistakes_are_named(address, what, hint):
    with pytest.raises(InputError) as fault:
        open_addresses([address])
    assert what in fault.value.what
    assert hint in fault.value.hint
