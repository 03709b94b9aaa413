"""Marker maps: what the names in a laboratory's files mean on the skeleton.

A landmark is a marker whose place on the bone is known (its name in the skeleton's table); a cluster marker
sits anywhere on one segment, and its place is taken from the standing trial.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from importlib import resources
from pathlib import Path
from typing import Any

from hilbrace.errors import ConfigError, InputError
from hilbrace.skeleton.table import load_table

_FOOT_SEGMENTS = ("talus", "calcn", "toes")


@dataclass(frozen=True)
class MarkerMap:
    """The meaning of marker names.

    Attributes:
        name: Name of a built-in map, or path of a TOML file.
        landmarks: Marker of the skeleton's table by name in the file.
        clusters: Segment of the skeleton by name in the file.
        ignored: Patterns (``*``, ``?``, ``[ab]``) of names in the file that are no measured markers of a
            segment; a name that is a landmark or cluster is never ignored.
        optional: Patterns of names that a recording may lack.
    """

    name: str
    landmarks: dict[str, str]
    clusters: dict[str, str]
    ignored: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()

    def known(self) -> tuple[str, ...]:
        """All names that have a meaning, in the map's order."""
        return (*self.landmarks, *self.clusters)


def builtin_maps() -> tuple[str, ...]:
    """Names of the marker maps that come with the package."""
    folder = resources.files("hilbrace.motion").joinpath("maps")
    return tuple(
        sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if ".toml" in entry.name)
    )


def read_marker_map(name_or_path: str) -> MarkerMap:
    """Read a built-in map by name, or a TOML file by its path.

    Raises:
        ConfigError: There is no such map.
        InputError: The file is not TOML, or names a marker or segment that the skeleton does not have.
    """
    if name_or_path.endswith(".toml"):
        where = name_or_path
        try:
            text = Path(name_or_path).read_text("utf-8")
        except (OSError, UnicodeDecodeError) as fault:
            raise InputError(f"no readable marker map: {fault}", where=where, hint="check the path") from None
    elif name_or_path in builtin_maps():
        where = f"marker map '{name_or_path}'"
        text = resources.files("hilbrace.motion").joinpath("maps", f"{name_or_path}.toml").read_text("utf-8")
    else:
        raise ConfigError(
            f"no marker map '{name_or_path}'",
            where="motion.marker_map",
            hint=f"choose one of {', '.join(builtin_maps())}, or the path of a TOML file",
        )
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise InputError(f"not valid TOML: {fault}", where=where, hint="mend the line named") from None
    return _parse(content, name_or_path, where)


def match_markers(marker_map: MarkerMap, names: Iterable[str], where: str) -> MarkerMap:
    """Check that map and recording name the same markers.

    Args:
        marker_map: The map.
        names: Names in the recording, those of the standing trial included.
        where: File or files, for the message.

    Returns:
        The map without the markers that the recording lacks and may lack.

    Raises:
        InputError: Lists the names that only the recording has, and those that only the map has.
    """
    names = tuple(dict.fromkeys(names))
    known = marker_map.known()
    present = set(names)
    strange = [n for n in names if n not in known and not _fits(n, marker_map.ignored)]
    missing = [n for n in known if n not in present and not _fits(n, marker_map.optional)]
    if strange or missing:
        raise InputError(
            _both_ways(strange, missing, marker_map.name),
            where=where,
            hint=_suggestion(strange, missing, known, marker_map.name),
        )
    return replace(
        marker_map,
        landmarks={n: v for n, v in marker_map.landmarks.items() if n in present},
        clusters={n: v for n, v in marker_map.clusters.items() if n in present},
    )


def segment_of(marker_map: MarkerMap) -> dict[str, str]:
    """Segment of the skeleton (``"femur_l"``, ...) that each known marker sits on."""
    table = load_table()["markers"]
    return {name: table[mark][0] for name, mark in marker_map.landmarks.items()} | marker_map.clusters


def foot_markers(marker_map: MarkerMap, side: str) -> tuple[str, ...]:
    """Names of the markers on one foot.

    Args:
        marker_map: The map.
        side: ``"right"`` or ``"left"``.
    """
    segments = {f"{segment}_{side[0]}" for segment in _FOOT_SEGMENTS}
    return tuple(name for name, segment in segment_of(marker_map).items() if segment in segments)


def file_name_of(marker_map: MarkerMap, landmark: str) -> str | None:
    """Name in the file of a landmark of the skeleton's table, if the map has it."""
    return next((name for name, mark in marker_map.landmarks.items() if mark == landmark), None)


def _parse(content: dict[str, Any], name: str, where: str) -> MarkerMap:
    unknown = sorted(set(content) - {"landmarks", "clusters", "ignored", "optional"})
    if unknown:
        raise InputError(
            f"unknown key '{unknown[0]}'",
            where=where,
            hint="a marker map has [landmarks], [clusters], ignored and optional",
        )
    landmarks, clusters = content.get("landmarks", {}), content.get("clusters", {})
    patterns = content.get("ignored", []), content.get("optional", [])
    tables = all(
        isinstance(t, dict) and all(isinstance(v, str) for v in t.values()) for t in (landmarks, clusters)
    )
    lists = all(isinstance(p, list) and all(isinstance(v, str) for v in p) for p in patterns)
    if not tables or not lists or not landmarks:
        raise InputError(
            "a section is missing or holds something else than names",
            where=where,
            hint='write [landmarks] with lines like LASI = "LASI"; ignored and optional are lists of names',
        )
    table = load_table()
    _check_targets(landmarks, tuple(table["markers"]), "marker of the skeleton", where)
    _check_targets(clusters, tuple(table["bodies"]), "segment of the skeleton", where)
    twice = [mark for mark in landmarks.values() if list(landmarks.values()).count(mark) > 1]
    both = [key for key in landmarks if key in clusters]
    if twice or both:
        raise InputError(
            f"'{(twice + both)[0]}' is given twice", where=where, hint="give each marker one meaning"
        )
    return MarkerMap(name, dict(landmarks), dict(clusters), tuple(patterns[0]), tuple(patterns[1]))


def _check_targets(section: dict[str, str], known: tuple[str, ...], what: str, where: str) -> None:
    for key, target in section.items():
        if target not in known:
            near = difflib.get_close_matches(target, known, n=1, cutoff=0.3)
            raise InputError(
                f"'{key}' stands for '{target}', which is no {what}",
                where=where,
                hint=f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known[:8])}, ...",
            )


def _fits(name: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _both_ways(strange: list[str], missing: list[str], name: str) -> str:
    parts = []
    if strange:
        parts.append(f"marker map '{name}' does not know {some_names(strange)}")
    if missing:
        parts.append(f"the recording lacks {some_names(missing)}")
    return "; ".join(parts)


def some_names(names: list[str]) -> str:
    """The first twelve names, and how many more there are."""
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def _suggestion(strange: list[str], missing: list[str], known: tuple[str, ...], name: str) -> str:
    pairs = [
        f"{n} for {near[0]}"
        for n in strange[:6]
        if (near := difflib.get_close_matches(n, missing or list(known), n=1, cutoff=0.6))
    ]
    mend = "rename markers, or set motion.marker_map to a map (TOML file) that lists them"
    if len(strange) > 3 and len(missing) > 3:
        mend = (
            f"another map may fit ({', '.join(m for m in builtin_maps() if m != name)}), or write one as TOML"
        )
    return f"{mend}; nearest names: {', '.join(pairs)}" if pairs else mend
