"""Records on disk: the same content gives the same bytes, and damage is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hilbrace.errors import InputError
from hilbrace.run.records import load, pack, save, write_atomic


@dataclass(frozen=True)
class Sample:
    name: str
    values: np.ndarray
    flags: np.ndarray
    names: tuple[str, ...]
    figure: float


@dataclass(frozen=True)
class Other:
    name: str


ARRAYS = hnp.arrays(
    np.float64, hnp.array_shapes(min_dims=0, max_dims=3, max_side=4), elements=st.floats(width=64)
)


@given(values=ARRAYS, name=st.text(max_size=8), figure=st.floats(allow_nan=False, allow_infinity=False))
def test_a_record_comes_back_bit_for_bit(tmp_path_factory, values, name, figure):
    path = tmp_path_factory.mktemp("records") / "sample.npz"
    record = Sample(name, values, np.asarray(values > 0), ("a", "b"), figure)
    save(record, path)
    back = load(Sample, path)
    assert back.values.tobytes() == values.tobytes()
    assert back.values.shape == values.shape
    assert (back.name, back.names, back.figure) == (name, ("a", "b"), figure)
    assert pack(back) == pack(record)


def test_bytes_do_not_depend_on_memory_layout():
    values = np.arange(12.0).reshape(3, 4)
    turned = np.asfortranarray(values)
    assert pack(Sample("x", values, values > 1, (), 0.0)) == pack(Sample("x", turned, turned > 1, (), 0.0))


def test_a_damaged_record_is_named(tmp_path: Path):
    path = tmp_path / "sample.npz"
    save(Sample("x", np.zeros(1000), np.zeros(3, bool), (), 1.0), path)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InputError, match="damaged"):
        load(Sample, path)


def test_a_flipped_bit_is_found(tmp_path: Path):
    path = tmp_path / "sample.npz"
    save(Sample("x", np.random.default_rng(0).random(1000), np.zeros(3, bool), (), 1.0), path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
    with pytest.raises(InputError):
        load(Sample, path)


def test_a_record_of_another_version_is_refused_by_its_fields(tmp_path: Path):
    @dataclass(frozen=True)
    class Later:
        name: str
        added: float

    Later.__name__ = "Other"
    save(Other("x"), tmp_path / "old.npz")
    with pytest.raises(InputError, match="added does not fit"):
        load(Later, tmp_path / "old.npz")


def test_another_kind_is_refused(tmp_path: Path):
    save(Other("x"), tmp_path / "other.npz")
    with pytest.raises(InputError, match="holds a Other"):
        load(Sample, tmp_path / "other.npz")


def test_a_missing_record_says_which(tmp_path: Path):
    with pytest.raises(InputError) as fault:
        load(Sample, tmp_path / "none.npz")
    assert "none.npz" in fault.value.two_lines()


def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "file"
    write_atomic(path, b"old")

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]
