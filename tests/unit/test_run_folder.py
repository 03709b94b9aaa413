"""Run folders: one process at a time, stages that know whether they are current."""

from __future__ import annotations

import json
import multiprocessing
from pathlib import Path

import pytest

from hilbrace.errors import BusyError, InputError
from hilbrace.run import folder as runs


def _hold(path: Path, held: object, release: object) -> None:
    with runs.locked(path):
        held.set()  # type: ignore[attr-defined]
        release.wait(20)  # type: ignore[attr-defined]


def test_a_second_process_is_refused_until_the_first_ends(tmp_path: Path):
    context = multiprocessing.get_context("spawn")
    held, release = context.Event(), context.Event()
    first = context.Process(target=_hold, args=(tmp_path, held, release))
    first.start()
    assert held.wait(20)
    with pytest.raises(BusyError, match="another process"), runs.locked(tmp_path):
        pass
    first.kill()
    first.join()
    with runs.locked(tmp_path):
        pass


def test_a_stage_is_current_only_with_its_key_and_files(tmp_path: Path):
    file = tmp_path / "a.npz"
    file.write_bytes(b"content")
    entry = runs.StageEntry("key", {"a.npz": runs.file_digest(file)}, 1.0, {})
    assert runs.is_current(tmp_path, entry, "key")
    assert not runs.is_current(tmp_path, entry, "other key")
    assert not runs.is_current(tmp_path, None, "key")
    file.write_bytes(b"changed")
    assert not runs.is_current(tmp_path, entry, "key")
    file.unlink()
    assert not runs.is_current(tmp_path, entry, "key")


def test_the_manifest_reads_back(tmp_path: Path):
    entry = runs.StageEntry("key", {"a": "b"}, 1.5, {"motion": {"frames": 3}})
    runs.write_manifest(tmp_path, {"motion": entry}, {"hilbrace": "0"})
    assert runs.read_manifest(tmp_path) == {"motion": entry}
    assert json.loads((tmp_path / runs.MANIFEST).read_text())["hilbrace"] == "0"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"stages": {"motion": {}}}'])
def test_a_damaged_manifest_is_named(tmp_path: Path, text: str):
    (tmp_path / runs.MANIFEST).write_text(text)
    with pytest.raises(InputError, match="damaged manifest"):
        runs.read_manifest(tmp_path)


def test_digests_keep_their_parts_apart():
    assert runs.digest("ab", "c") != runs.digest("a", "bc")


def test_a_missing_input_is_named(tmp_path: Path):
    with pytest.raises(InputError) as fault:
        runs.file_digest(tmp_path / "jump.trc")
    assert "jump.trc" in fault.value.two_lines()
