"""Take finished stages over from another run folder."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from hilbrace.run.folder import read_manifest, write_manifest


def reuse_stages(source: Path, target: Path, stages: Sequence[str]) -> None:
    """Copy the files and the manifest's entries of finished stages into another run folder.

    Whether they serve there is decided as ever, by their keys and digests. The manifest is written last, so
    that an interrupted copy counts for nothing.

    Args:
        source: Run folder to take from; only read.
        target: Run folder to bring up, made if absent.
        stages: Names of stages; those that the source has not finished are left out.

    Raises:
        InputError: A manifest is damaged.
    """
    theirs, own = read_manifest(source), read_manifest(target)
    wanted = {name: theirs[name] for name in stages if name in theirs and own.get(name) != theirs[name]}
    target.mkdir(parents=True, exist_ok=True)
    for entry in wanted.values():
        for name in entry.files:
            if (source / name).is_file():
                (target / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source / name, target / name)
    write_manifest(target, own | wanted, {})
