"""Stages of another run folder are taken over with their files, and count as if made there."""

from __future__ import annotations

from pathlib import Path

from hilbrace.run.folder import StageEntry, file_digest, is_current, read_manifest, write_manifest
from hilbrace.run.reuse import reuse_stages


def finished(folder: Path, **texts: str) -> Path:
    entries = {}
    for name, text in texts.items():
        (folder / name).mkdir(parents=True)
        file = folder / name / f"{name}.txt"
        file.write_text(text)
        entries[name] = StageEntry(f"key of {name}", {f"{name}/{name}.txt": file_digest(file)}, 1.0, {})
    write_manifest(folder, entries, {})
    return folder


def test_named_stages_are_copied_and_current(tmp_path: Path):
    source = finished(tmp_path / "a", motion="m", body="b", solid="s")
    target = tmp_path / "b"
    reuse_stages(source, target, ("motion", "body", "biomech"))
    manifest = read_manifest(target)
    assert list(manifest) == ["motion", "body"]
    assert is_current(target, manifest["motion"], "key of motion")
    assert not (target / "solid").exists()


def test_what_the_target_made_itself_is_kept_and_copies_are_its_own(tmp_path: Path):
    source, target = finished(tmp_path / "a", motion="m"), finished(tmp_path / "b", optimize="o")
    reuse_stages(source, target, ("motion",))
    assert list(read_manifest(target)) == ["optimize", "motion"]
    (target / "motion" / "motion.txt").write_text("changed")
    assert (source / "motion" / "motion.txt").read_text() == "m"
    assert not is_current(target, read_manifest(target)["motion"], "key of motion")


def test_a_file_that_is_gone_is_not_current(tmp_path: Path):
    source, target = finished(tmp_path / "a", motion="m"), tmp_path / "b"
    (source / "motion" / "motion.txt").unlink()
    reuse_stages(source, target, ("motion",))
    assert not is_current(target, read_manifest(target)["motion"], "key of motion")
