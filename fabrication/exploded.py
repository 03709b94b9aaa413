"""How far each piece is drawn out of the closed mold so that all can be seen."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fabrication.mold import Mold, Piece

Array = np.ndarray

PULLED = 0.45
"""Way of a shell along its pull, in widths of the mold."""

FLAT = 1.0
"""The same of the lid of a flat casting, which would hide it."""

SPREAD = 0.25
"""Way apart along the mold's axis, in distances from its middle."""


def exploded(mold: Mold) -> dict[str, Float[Array, "3"]]:
    """Displacement of each piece [mm], by its name: shells along their pull, all apart along the axis.

    Args:
        mold: The closed mold.
    """
    axis = mold.core.axis / np.linalg.norm(mold.core.axis)
    boxes = {piece.name: np.reshape(piece.solid.bounding_box(), (2, 3)) for piece in mold.pieces}
    corners = np.concatenate(list(boxes.values()))
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    size = corners.max(axis=0) - corners.min(axis=0)
    width = float(np.sort(size)[1])
    return {
        piece.name: SPREAD * float((boxes[piece.name].mean(axis=0) - middle) @ axis) * axis
        + (FLAT if mold.casting.flat else PULLED) * width * _way(piece, axis)
        for piece in mold.pieces
    }


def _way(piece: Piece, axis: Array) -> Array:
    if piece.pull is not None:
        return piece.pull
    return -0.1 * axis if piece.kind == "base" else np.zeros(3)
