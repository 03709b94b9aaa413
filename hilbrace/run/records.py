"""Records on disk: one frozen dataclass of arrays and figures, one ``.npz`` file.

The bytes depend on the content alone (fixed member dates and order), so that two runs of one seed give
identical files. No pickle is written or read.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
import tempfile
import zipfile
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from hilbrace.errors import InputError

Record = TypeVar("Record")

_FIGURES = "figures.json"
_EPOCH = (1980, 1, 1, 0, 0, 0)


def write_atomic(path: Path, content: bytes) -> None:
    """Write a file so that a reader sees the old content or the new, never a part.

    Args:
        path: File to write; its folder must exist.
        content: The bytes of the whole file.
    """
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def pack(record: Any) -> bytes:
    """The record as the bytes of an ``.npz`` archive.

    Arrays become members of their own; every other field (text, numbers, tuples, dicts, ``None``) goes
    into one JSON member.
    """
    arrays: dict[str, np.ndarray] = {}
    figures: dict[str, Any] = {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            arrays[field.name] = value
        else:
            figures[field.name] = value
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive:
        text = json.dumps({"record": type(record).__name__, "fields": figures}, sort_keys=True)
        archive.writestr(_member(_FIGURES), text)
        for name in sorted(arrays):
            data = io.BytesIO()
            np.lib.format.write_array(data, np.asarray(arrays[name], order="C"), allow_pickle=False)
            archive.writestr(_member(f"{name}.npy"), data.getvalue())
    return buffer.getvalue()


def save(record: Any, path: Path) -> None:
    """Write a record atomically."""
    write_atomic(path, pack(record))


def load(kind: type[Record], path: Path) -> Record:
    """Read a record written by `save`.

    Args:
        kind: The record's class.
        path: The ``.npz`` file.

    Raises:
        InputError: The file is missing, damaged, holds another kind of record, or one that another version
            wrote.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            content = json.loads(archive.read(_FIGURES))
            values = dict(content["fields"])
            for name in archive.namelist():
                if name.endswith(".npy"):
                    data = io.BytesIO(archive.read(name))
                    values[name[:-4]] = np.lib.format.read_array(data, allow_pickle=False)
    except FileNotFoundError:
        raise InputError(
            "no such record", where=str(path), hint="run the stage that writes it first"
        ) from None
    except (zipfile.BadZipFile, KeyError, ValueError, OSError) as fault:
        raise InputError(
            f"damaged record: {fault}", where=str(path), hint="delete the file and run the stage again"
        ) from fault
    if content["record"] != kind.__name__:
        raise InputError(
            f"holds a {content['record']}, not a {kind.__name__}",
            where=str(path),
            hint="name the file of the right stage",
        )
    hints = get_type_hints(kind)
    strange = sorted(set(values) - set(hints)) + sorted(_required(kind) - set(values))
    if strange:
        raise InputError(
            f"written by another version: {', '.join(strange)} does not fit",
            where=str(path),
            hint="delete the file and run the stage again",
        )
    for name, value in values.items():
        if isinstance(value, list) and str(hints[name]).startswith("tuple"):
            values[name] = tuple(tuple(v) if isinstance(v, list) else v for v in value)
    return kind(**values)


def _required(kind: type) -> set[str]:
    return {
        field.name
        for field in dataclasses.fields(kind)
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    }


def _member(name: str) -> zipfile.ZipInfo:
    member = zipfile.ZipInfo(name, date_time=_EPOCH)
    member.compress_type = zipfile.ZIP_DEFLATED
    member.external_attr = 0o644 << 16
    return member
