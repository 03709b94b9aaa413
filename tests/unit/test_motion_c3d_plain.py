"""The plain reader against ezc3d on every recorded file, and on the same content in other byte orders."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from hilbrace.errors import InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.c3d_header import DEC, INTEL, MIPS, check_c3d
from hilbrace.motion.c3d_plain import read_plain
from tests.unit import motion_files as lab

MISREAD_BY_EZC3D = {"sample28_type1.C3D"}


@pytest.fixture(scope="module")
def reader():
    with C3DReader() as reader:
        yield reader


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    """A file of 30 frames, 21 markers with gaps and prefixes, and analog values."""
    positions = lab.markers()[:30].copy()
    positions[5:9, 0] = np.nan
    names = tuple(f"Anna:{name}" for name in lab.marker_names())
    return lab.write_c3d(tmp_path_factory.mktemp("c3d") / "small.c3d", names, positions)


def positions(content: dict, scale: float = 1e-3) -> np.ndarray:
    hidden = (content["residuals"] < 0) | (content["points"] == 0).all(axis=2)
    return np.where(hidden[:, :, None], np.nan, scale * content["points"])


def test_it_reads_what_ezc3d_reads(shared_data, reader):
    files = sorted(path for path in shared_data.rglob("*") if path.suffix.lower() == ".c3d")
    compared = set()
    for path in files:
        if path.name in MISREAD_BY_EZC3D:
            continue
        theirs = reader.read(path)
        header = check_c3d(path)
        ours = read_plain(path, header)
        labels = [label.rsplit(":", 1)[-1] for label in ours["labels"]]
        scale = 1e-3 if ours["units"].startswith("mm") else 1.0
        chosen = [labels.index(name) for name in theirs.markers.names]
        assert np.array_equal(positions(ours, scale)[:, chosen], theirs.markers.positions, equal_nan=True)
        assert ours["point_rate"] == theirs.markers.rate_hz
        assert dict(zip(ours["measured"], ours["measurements"], strict=True)) == theirs.measurements
        compared.add(header.processor)
    assert compared == {INTEL, DEC}


def to_mips(content: bytes) -> bytes:
    """The same file as an SGI computer would have written it: high bytes first."""
    changed = bytearray(content)

    def swap(at: int, size: int) -> None:
        changed[at : at + size] = changed[at : at + size][::-1]

    for at in (2, 4, 6, 8, 10, 16, 18):
        swap(at, 2)
    swap(12, 4)
    swap(20, 4)
    start = (content[0] - 1) * 512
    changed[start + 3] = MIPS
    position = start + 4
    while content[position] != 0:
        length, group = abs(struct.unpack_from("<b", content, position)[0]), content[position + 1]
        at = position + 2 + length
        offset = struct.unpack_from("<h", content, at)[0]
        swap(at, 2)
        if group < 128:
            kind, rank = struct.unpack_from("<bB", content, at + 2)
            size = int(np.prod([*content[at + 4 : at + 4 + rank], 1], dtype=int))
            for k in range(size if kind in (2, 4) else 0):
                swap(at + 4 + rank + kind * k, kind)
        if offset <= 0:
            break
        position = at + offset
    data = (struct.unpack_from("<H", content, 16)[0] - 1) * 512
    words = np.frombuffer(content[data:], "<f4")
    return bytes(changed[:data]) + words.astype(">f4").tobytes()


def test_a_file_of_an_sgi_computer(small, tmp_path, reader):
    path = tmp_path / "sgi.c3d"
    path.write_bytes(to_mips(small.read_bytes()))
    found, plain = reader.read(path), reader.read(small)
    assert check_c3d(path).processor == MIPS
    assert found.markers.names == plain.markers.names == lab.marker_names()
    assert np.array_equal(found.markers.positions, plain.markers.positions, equal_nan=True)
    assert np.isnan(found.markers.positions[5:9, 0]).all()
    assert found.plates is None
    assert found.notes == ("sgi.c3d was written by an SGI computer: force plates are not read.",)


def test_a_file_of_an_sgi_computer_that_is_cut_short_is_refused(small, tmp_path, reader):
    path = tmp_path / "sgi.c3d"
    whole = to_mips(small.read_bytes())
    for length in (0, 100, 600, 1024, len(whole) // 2, check_c3d(small).expected_bytes - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError):
            reader.read(path)


def test_damaged_parameters_are_a_recording_or_a_refusal(small, tmp_path, reader):
    whole = to_mips(small.read_bytes())
    path = tmp_path / "sgi.c3d"
    rng = np.random.default_rng(6)
    refused = 0
    for _ in range(300):
        content = bytearray(whole)
        for at in rng.integers(0, 2048, int(rng.integers(1, 8))):
            content[int(at)] = int(rng.integers(0, 256))
        path.write_bytes(content)
        try:
            reader.read(path)
        except InputError:
            refused += 1
    assert 5 < refused < 295
