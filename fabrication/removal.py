"""The proof that a mold opens: each piece moved off on its way, and what it runs into measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold

from fabrication.mold import Piece

Array = np.ndarray

STEPS_MM = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
"""How far a piece is moved: first less than any feature, last clear of everything [mm]."""


def collisions(
    solid: Manifold, others: Sequence[Manifold], pull: Float[Array, "3"], steps_mm: Sequence[float] = STEPS_MM
) -> Float[Array, " step"]:
    """Volume that a body shares with others after each step on its way off [mm^3].

    Args:
        solid: The body where it sits in the closed mold.
        others: What stays.
        pull: Unit direction in which it comes off.
        steps_mm: How far it has moved [mm].
    """
    out = []
    for step in steps_mm:
        moved = solid.translate(tuple(step * np.asarray(pull, float)))
        out.append(sum(max((moved ^ other).volume(), 0.0) for other in others if _near(moved, other)))
    return np.array(out, dtype=float)


def collision(piece: Piece, others: Sequence[Piece], pull: Float[Array, "3"] | None = None) -> float:
    """Largest volume that a piece shares with others at any step on its way off [mm^3]; 0 if it is free.

    Args:
        piece: What comes off.
        others: What stays.
        pull: Unit direction; the piece's own if left out.

    Returns:
        The volume; 0 of a piece that stays.
    """
    way = piece.pull if pull is None else pull
    if way is None:
        return 0.0
    return float(collisions(piece.solid, [other.solid for other in others], way).max(initial=0.0))


def _near(first: Manifold, second: Manifold) -> bool:
    """Whether the bounding boxes of two bodies touch."""
    a, b = np.reshape(first.bounding_box(), (2, 3)), np.reshape(second.bounding_box(), (2, 3))
    return bool((a[0] <= b[1]).all() and (b[0] <= a[1]).all())
