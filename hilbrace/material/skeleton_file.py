"""Skeleton files: one microstructure each, drawn as lines in the unit square.

A file is TOML. At least one of three keys draws lines; all coordinates are those of the unit cell, in [0, 1]:

    title = "Star"                          # how pictures and tables call it
    source = "where the shape comes from"   # optional
    polylines = [[[0, 0.5], [0.35, 0.35]]]  # open or closed, any number of points each
    voronoi_seeds = [[0, 0], [1, 0.5]]      # Voronoi edges of these seeds and their mirror images
    waves = [{ amplitude = 0.17, half_waves = 2 }]   # y = 1/2 + a cos(h pi x), and its transpose
    volume_range = [0.1, 0.65]              # optional: volume fractions that the design variable spans

The cell is tiled by reflection. A strut that ends on the border goes on in its mirror image; an end inside
the cell must lie on another strut. A mirror image of a part never meets another part, so all parts must hang
together within the cell and reach all four sides: otherwise the pattern falls to pieces.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import math
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Voronoi

from hilbrace.config.material import CELLS
from hilbrace.errors import ConfigError, InputError

Array = np.ndarray

FOLDER = Path(__file__).parent / "skeleton"
"""Skeleton files of the package, one for each name in `CELLS`."""

TOUCH = 1e-3
"""Points nearer than this are one [cell sides]; some 0.02 mm on the limb."""

KEYS = ("title", "source", "polylines", "voronoi_seeds", "waves", "volume_range")
_DRAWING = ("polylines", "voronoi_seeds", "waves")
_MOST_SEGMENTS = 3000
_WAVE_POINTS = 65


@dataclass(frozen=True)
class Skeleton:
    """A microstructure as drawn.

    Attributes:
        name: Name of the built-in cell, or path of the user's file, as it was asked for.
        title: How pictures and tables call it.
        segments: Straight pieces of the skeleton, start and end, in the unit square [cell sides].
        volume_range: Volume fractions that the design variable spans; ``None`` if left out.
        digest: SHA-256 of what the file draws; a table of homogenized samples keeps that of its skeleton.
    """

    name: str
    title: str
    segments: Float[Array, "segment 2 2"]
    volume_range: tuple[float, float] | None
    digest: str


def skeleton_path(name: str) -> Path:
    """File of a cell: a built-in one by name, a user's own by its path that ends in ``.toml``.

    Raises:
        ConfigError: No cell has this name.
    """
    if name.endswith(".toml"):
        return Path(name)
    if name not in CELLS:
        near = difflib.get_close_matches(name, CELLS, n=1)
        hint = f"did you mean '{near[0]}'? " if near else ""
        raise ConfigError(
            f"no microstructure named '{name}'",
            where="material",
            hint=f"{hint}choose one of {', '.join(CELLS)}, or the path of a skeleton file (.toml)",
        )
    return FOLDER / f"{name}.toml"


def read_skeleton(name: str) -> Skeleton:
    """Read the skeleton of a cell and check that it makes one connected pattern.

    Args:
        name: Name of a built-in cell, or path of a skeleton file.

    Raises:
        ConfigError: No cell has this name.
        InputError: The file is missing, a key is wrong, or the skeleton is broken; file and key are named.
    """
    path = skeleton_path(name)
    if not name.endswith(".toml"):
        return _built_in(name)
    return parse_skeleton(_toml(path), name)


def parse_skeleton(content: dict[str, Any], name: str) -> Skeleton:
    """Check the content of a skeleton file and draw its lines.

    Args:
        content: The parsed TOML.
        name: Name or path of the cell; errors tell it.

    Raises:
        InputError: A key is unknown or wrong, or the skeleton is broken.
    """
    _check_keys(content, name)
    lines: list[Float[Array, "point 2"]] = []
    for place, points in enumerate(_list(content, "polylines", name)):
        lines.append(_points(points, f"polylines[{place}]", name, least=2))
    if "voronoi_seeds" in content:
        seeds = _points(content["voronoi_seeds"], "voronoi_seeds", name, least=2)
        lines.extend(mirrored_voronoi(seeds))
    for place, wave in enumerate(_list(content, "waves", name)):
        lines.extend(_wave(wave, f"waves[{place}]", name))
    _check_lengths(lines, name)
    segments = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    if len(segments) > _MOST_SEGMENTS:
        raise _fault(name, "polylines", f"{len(segments)} segments", f"use at most {_MOST_SEGMENTS}")
    _check_connected(lines, segments, name)
    segments.setflags(write=False)
    title = content.get("title", Path(name).stem)
    return Skeleton(name, str(title), segments, _volume_range(content, name), _digest(content))


@cache
def _built_in(name: str) -> Skeleton:
    return parse_skeleton(_toml(FOLDER / f"{name}.toml"), name)


def mirrored_voronoi(seeds: Float[Array, "seed 2"]) -> list[Float[Array, "2 2"]]:
    """Voronoi edges of the seeds and their mirror images, cut to the unit cell.

    A seed strictly inside the cell makes the mirror line itself a Voronoi edge, and a straight square grid
    shows through the pattern; seeds on the border leave the mirror lines open.
    """
    images = [
        np.stack([x, y], axis=1)
        for x in (-seeds[:, 0], seeds[:, 0], 2 - seeds[:, 0])
        for y in (-seeds[:, 1], seeds[:, 1], 2 - seeds[:, 1])
    ]
    diagram = Voronoi(np.unique(np.round(np.concatenate(images), 9), axis=0))
    ridges = [ridge for ridge in diagram.ridge_vertices if min(ridge) >= 0]
    pieces = [_clip_to_cell(*diagram.vertices[ridge]) for ridge in ridges]
    return [piece for piece in pieces if piece is not None]


def _clip_to_cell(start: Array, end: Array) -> Array | None:
    """Part of a segment inside the unit square (Liang & Barsky 1984), ``None`` where it lies outside."""
    along = end - start
    enter, leave = 0.0, 1.0
    for axis in range(2):
        for step, room in ((-along[axis], start[axis]), (along[axis], 1.0 - start[axis])):
            if abs(step) < 1e-14:
                if room < -1e-9:
                    return None
            elif step < 0:
                enter = max(enter, room / step)
            else:
                leave = min(leave, room / step)
    if leave - enter < 1e-9:
        return None
    return np.array([start + enter * along, start + leave * along])


def _digest(content: dict[str, Any]) -> str:
    drawn = {key: content[key] for key in (*_DRAWING, "volume_range") if key in content}
    return hashlib.sha256(json.dumps(drawn, sort_keys=True).encode()).hexdigest()


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except OSError as fault:
        raise InputError(
            fault.strerror or "cannot be read", where=str(path), hint="check the path of the skeleton file"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise InputError(f"not valid TOML: {fault}", where=str(path), hint="mend the line named") from None


def _check_keys(content: dict[str, Any], name: str) -> None:
    for key in content:
        if key not in KEYS:
            near = difflib.get_close_matches(key, KEYS, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known keys: {', '.join(KEYS)}"
            raise InputError(f"unknown key '{key}'", where=f"{name}: {key}", hint=hint)
    for key in ("title", "source"):
        if not isinstance(content.get(key, ""), str):
            raise _fault(name, key, f"{content[key]!r} is no text", "put it in quotes")
    if not any(key in content for key in _DRAWING):
        raise _fault(name, _DRAWING[0], "the file draws nothing", f"give one of {', '.join(_DRAWING)}")


def _list(content: dict[str, Any], key: str, name: str) -> list[Any]:
    value = content.get(key, [])
    if not isinstance(value, list) or (key in content and not value):
        raise _fault(name, key, "not a list with at least one entry", "see the built-in skeleton files")
    return value


def _points(value: Any, key: str, name: str, least: int) -> Float[Array, "point 2"]:
    if not isinstance(value, list) or len(value) < least:
        raise _fault(name, key, f"not a list of at least {least} points", "write [[x, y], [x, y]]")
    for place, point in enumerate(value):
        if not (isinstance(point, list) and len(point) == 2 and all(map(_is_number, point))):
            raise _fault(name, f"{key}[{place}]", f"{point!r} is no point", "write two numbers: [x, y]")
        if not all(map(math.isfinite, point)):
            raise _fault(name, f"{key}[{place}]", f"{point!r} is not finite", "give finite numbers")
        if not all(0.0 <= number <= 1.0 for number in point):
            raise _fault(
                name,
                f"{key}[{place}]",
                f"{point!r} lies outside of the unit cell",
                "keep both coordinates between 0 and 1; the mirror images beyond are made from these",
            )
    return np.array(value, dtype=float)


def _wave(value: Any, key: str, name: str) -> list[Float[Array, "point 2"]]:
    """A wave about the middle and its transpose; the cosine meets the mirror lines at right angles."""
    if not isinstance(value, dict) or sorted(value) != ["amplitude", "half_waves"]:
        raise _fault(
            name, key, f"{value!r} is no wave", "write { amplitude = 0.17, half_waves = 2 }, nothing else"
        )
    amplitude, half_waves = value["amplitude"], value["half_waves"]
    if not (_is_number(amplitude) and 0 < abs(amplitude) < 0.5):
        raise _fault(
            name, f"{key}.amplitude", f"{amplitude!r} leaves the unit cell", "between 0 and 0.5, not 0"
        )
    if not (isinstance(half_waves, int) and 1 <= half_waves <= 8):
        raise _fault(name, f"{key}.half_waves", f"{half_waves!r} half waves", "a whole number from 1 to 8")
    x = np.linspace(0.0, 1.0, _WAVE_POINTS)
    wave = np.stack([x, 0.5 + amplitude * np.cos(half_waves * np.pi * x)], axis=1)
    return [wave, wave[:, ::-1]]


def _volume_range(content: dict[str, Any], name: str) -> tuple[float, float] | None:
    if "volume_range" not in content:
        return None
    value = content["volume_range"]
    if not (isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))):
        raise _fault(name, "volume_range", f"{value!r} is no range", "write two numbers: [0.1, 0.65]")
    low, high = map(float, value)
    if not 0.02 <= low < high <= 0.95:
        raise _fault(name, "volume_range", f"[{low:g}, {high:g}]", "rising, between 0.02 and 0.95")
    return low, high


def _check_lengths(lines: list[Array], name: str) -> None:
    for place, line in enumerate(lines):
        short = np.flatnonzero(np.linalg.norm(np.diff(line, axis=0), axis=1) < 1e-9)
        if short.size:
            raise _fault(
                name,
                f"polylines[{place}]",
                f"points {short[0]} and {short[0] + 1} are the same",
                "leave one of them out",
            )


def _check_connected(lines: list[Array], segments: Float[Array, "segment 2 2"], name: str) -> None:
    """Refuse loose ends, several parts, and a part that does not reach its mirror images."""
    gaps = _gaps(segments)
    first = np.cumsum([0, *(len(line) - 1 for line in lines)])
    for place, line in enumerate(lines):
        for end, own in ((line[0], first[place]), (line[-1], first[place + 1] - 1)):
            others = _point_gaps(end, np.delete(segments, own, axis=0))
            near = float(others.min(initial=np.inf))
            if near > TOUCH and np.minimum(end, 1 - end).min() > TOUCH:
                away = f", {near:.4g} cell sides from the next one" if math.isfinite(near) else ""
                raise _fault(
                    name,
                    f"polylines[{place}]",
                    f"open gap: a strut ends in nothing at ({end[0]:.6g}, {end[1]:.6g}){away}",
                    "let it end on the border of the cell or on another strut",
                )
    i, j = np.nonzero(gaps <= TOUCH)
    graph = coo_array((np.ones(len(i)), (i, j)), shape=gaps.shape)
    parts, part = connected_components(graph, directed=False)
    if parts > 1:
        apart = segments[np.flatnonzero(part != part[0])[0], 0]
        raise _fault(
            name,
            "polylines",
            f"{parts} parts that never touch: that through ({apart[0]:.6g}, {apart[1]:.6g}) hangs free",
            "mirror images join only a part with itself: connect the parts inside the cell",
        )
    for axis, at, side in ((0, 0, "left"), (0, 1, "right"), (1, 0, "lower"), (1, 1, "upper")):
        if np.abs(segments[:, :, axis] - at).min() > TOUCH:
            raise _fault(
                name,
                "polylines",
                f"the skeleton does not reach the {side} side, so that its mirror images stay apart",
                "let a strut end on each of the four sides of the cell",
            )


def _gaps(segments: Float[Array, "segment 2 2"]) -> Float[Array, "segment segment"]:
    """Distance of every two segments; 0 where they cross."""
    ends = np.stack([_point_gaps(point, segments) for point in segments.reshape(-1, 2)])
    near = ends.reshape(len(segments), 2, -1).min(axis=1)
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    apart = start[None] - start[:, None]
    turn = _cross(along[:, None], along[None])
    with np.errstate(divide="ignore", invalid="ignore"):
        t, s = _cross(apart, along[None]) / turn, _cross(apart, along[:, None]) / turn
    crossing = (np.abs(turn) > 1e-14) & (t >= 0) & (t <= 1) & (s >= 0) & (s <= 1)
    return np.where(crossing, 0.0, np.minimum(near, near.T))


def _point_gaps(point: Float[Array, "2"], segments: Float[Array, "segment 2 2"]) -> Float[Array, " segment"]:
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    t = ((point - start) * along).sum(axis=1) / (along**2).sum(axis=1)
    return np.linalg.norm(point - start - np.clip(t, 0, 1)[:, None] * along, axis=1)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _fault(name: str, key: str, what: str, hint: str) -> InputError:
    return InputError(what, where=f"{name}: {key}", hint=hint)
