"""Every piece says what it is, which side of the body it belongs to, and where up is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold

from fabrication.bodies import mesh_of
from fabrication.fixtures.marks import UP, label
from fabrication.mold import Casting, Piece
from hilbrace.errors import GeometryError

Array = np.ndarray

SIZES_MM = (9.0, 7.0, 5.0)
"""Sizes of the letters, the first that finds room [mm]."""

ASIDE = (0.0, 0.09, -0.09, 0.18, -0.18, 0.27, -0.27, 0.36, -0.36, 0.43, -0.43)
"""Where on a piece room is looked for: parts of its extent away from its middle [-]."""

BEYOND_MM = 10.0
"""How far outside a piece the search for its surface starts [mm]."""


def marked(pieces: Sequence[Piece], casting: Casting, up: Float[Array, "3"]) -> tuple[Piece, ...]:
    """Pieces with their marks cut in: shells outside, cores on top; the base brings its own.

    Args:
        pieces: The finished pieces at their places in the mold.
        casting: What is cast; it knows the side.
        up: Unit direction that is up while casting.

    Raises:
        GeometryError: A piece has no room for even the smallest letters.
    """
    return tuple(piece if piece.kind == "base" else _marked(piece, casting, up) for piece in pieces)


def inscription(piece: Piece, casting: Casting) -> str:
    """What a piece says: ``MEDIAL L ↑``, or ``CORE L`` on the core's upper face, which is up already."""
    words = [piece.name.removeprefix("shell_").replace("_", " "), casting.side[:1]]
    if piece.pull is not None and not casting.flat:
        words.append(UP)
    return " ".join(word for word in words if word).upper()


def _marked(piece: Piece, casting: Casting, up: Float[Array, "3"]) -> Piece:
    seen_from = up if piece.pull is None else piece.pull
    if piece.pull is None and casting.flat:
        seen_from = -casting.direction.mean(axis=0)
    seen_from = seen_from / np.linalg.norm(seen_from)
    level = _heads(seen_from, up)
    text = inscription(piece, casting)
    parts = len(piece.solid.decompose())
    places = list(_places(piece.solid, seen_from, level))
    for size, heads, at in product(SIZES_MM, (level, np.cross(seen_from, level)), places):
        try:
            tool = label(text, at, seen_from, heads, size, onto=piece.solid)
        except GeometryError:
            continue
        solid = piece.solid - tool
        if len(solid.decompose()) == parts:
            return replace(piece, solid=solid)
    raise GeometryError(
        f"no room for the mark '{text}' on {piece.name}",
        where="mold marks",
        hint="use fewer shells (mold.shells) or a larger bed, so that pieces are larger",
    )


def _heads(seen_from: Float[Array, "3"], up: Float[Array, "3"]) -> Float[Array, "3"]:
    """Where letters' heads point: up, or forwards on a face that looks up itself."""
    for heads in (up, *np.eye(3)):
        level = heads - (heads @ seen_from) * seen_from
        if np.linalg.norm(level) > 0.5:
            return level / np.linalg.norm(level)
    return np.eye(3)[int(np.argmin(np.abs(seen_from)))]


def _places(
    solid: Manifold, seen_from: Float[Array, "3"], heads: Float[Array, "3"]
) -> Iterator[Float[Array, "3"]]:
    """Points of a body's face as one looks at it, from its middle outwards."""
    turn = np.stack([np.cross(heads, seen_from), heads, seen_from])
    local = mesh_of(solid)[0] @ turn.T
    low, high = local.min(axis=0), local.max(axis=0)
    middle, extent = 0.5 * (low + high), high - low
    for across, along in sorted(product(ASIDE, ASIDE), key=lambda shift: max(map(abs, shift))):
        x, y = middle[0] + across * extent[0], middle[1] + along * extent[1]
        top = np.array([x, y, high[2] + BEYOND_MM]) @ turn
        bottom = np.array([x, y, low[2] - BEYOND_MM]) @ turn
        hits = solid.ray_cast(tuple(top), tuple(bottom))
        if hits:
            yield np.asarray(min(hits, key=lambda hit: float(np.linalg.norm(hit.position - top))).position)
