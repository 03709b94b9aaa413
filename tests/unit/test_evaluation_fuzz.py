"""Two thousand damaged C3D files: each is read or refused by name, in seconds; none passes cut short."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest

from evaluation.c3d_writer import write_c3d
from hilbrace.errors import InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.c3d_header import check_c3d
from hilbrace.motion.recording import read_recording
from mocks import synthetic_study as made_up

MUTANTS = 2000
SLOWEST_S = 5.0
RECORDED = (
    "c3d_force_plates/TYPE-2.C3D",
    "c3d_force_plates/TYPE-4.C3D",
    "c3d_force_plates/qualisys_type3_2frames.c3d",
    "c3d_force_plates/sample28_type1.C3D",
    "c3d_force_plates/vicon_type2_walking2.c3d",
)


@pytest.fixture(scope="module")
def originals(tmp_path_factory, shared_data) -> list[Path]:
    """Files of four makers, and one of ours."""
    path = tmp_path_factory.mktemp("own") / "own.c3d"
    trial = made_up.trial_recording(
        np.array([[-70.0, -1.0], [-60.0, -4.0]]), np.random.default_rng(0), made_up.Scatter(), 2.5
    )
    write_c3d(path, trial)
    return [path, *(shared_data / name for name in RECORDED)]


def mutate(content: bytes, needed: int, rng: np.random.Generator) -> tuple[bytes, bool]:
    """A damaged copy, and whether it lacks data."""
    kind = rng.integers(0, 4)
    if kind == 0:
        length = int(rng.integers(0, needed))
        return content[:length], True
    changed = bytearray(content)
    if kind == 1:
        for _ in range(int(rng.integers(1, 20))):
            changed[int(rng.integers(0, len(changed)))] ^= 1 << int(rng.integers(0, 8))
    elif kind == 2:
        at = 2 * int(rng.integers(0, 12))
        changed[at : at + 2] = struct.pack("<H", int(rng.integers(0, 65536)))
    else:
        end = min(len(changed), 512 * int(changed[512 + 2] + 1))
        for _ in range(int(rng.integers(1, 6))):
            at = int(rng.integers(512, end))
            changed[at] = int(rng.integers(0, 256))
    return bytes(changed), False


def refused(path: Path, reader: C3DReader) -> str:
    """The refusal's two lines; nothing if the file was read whole."""
    try:
        recording = read_recording(path, None, None, reader)
    except InputError as fault:
        return fault.two_lines()
    assert len(recording.markers.time) == check_c3d(path).frames
    return ""


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_two_thousand_damaged_files(originals, tmp_path):
    rng = np.random.default_rng(2026)
    contents = [(path.read_bytes(), check_c3d(path).expected_bytes) for path in originals]
    path = tmp_path / "mutant.c3d"
    outcomes = {"read": 0, "refused": 0, "cut short": 0}
    slowest = 0.0
    with C3DReader() as reader:
        for k in range(MUTANTS):
            mutant, cut = mutate(*contents[k % len(contents)], rng)
            path.write_bytes(mutant)
            start = time.monotonic()
            refusal = refused(path, reader)
            slowest = max(slowest, time.monotonic() - start)
            assert refusal or not cut, f"mutant {k} is cut short and was read"
            assert refusal.count("\n") == bool(refusal)
            outcomes["cut short" if cut else "refused" if refusal else "read"] += 1
    assert min(outcomes.values()) > 100, outcomes
    assert slowest < SLOWEST_S
