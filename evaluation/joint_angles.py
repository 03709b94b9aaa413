"""Joint angles of two segment frames: Cardan angles in the order of the joint coordinate system.

A segment frame is a rotation whose columns are the segment's anterior, upward (proximal) and rightward axes
in the laboratory, for both legs; this is OpenSim's order. Angle ``a`` turns the distal segment about the
proximal rightward axis, ``b`` about the floating anterior axis, and ``c`` about the distal long axis:
``R = Rz(a) Rx(b) Ry(c)``. These are the angles of Grood & Suntay (1983, J Biomech Eng 105:136-144) and of
the ISB's joint coordinate systems, and Visual3D's default x-y-z sequence, whose axes have other names.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Array = np.ndarray

ANTERIOR, UP, RIGHT = 0, 1, 2
"""Columns of a segment frame."""


def relative_rotation(
    proximal: Float[Array, "*frame 3 3"], distal: Float[Array, "*frame 3 3"]
) -> Float[Array, "*frame 3 3"]:
    """The distal frame as the proximal segment sees it."""
    return np.swapaxes(proximal, -1, -2) @ distal


def cardan_angles(rotation: Float[Array, "*frame 3 3"]) -> Float[Array, "*frame 3"]:
    """Angles (a, b, c) of a relative rotation [rad]; b lies within a right angle of zero.

    At b = +-90 degrees a and c turn about the same axis and cannot be told apart.

    Args:
        rotation: Distal frame in the proximal one; NaN gives NaN.
    """
    a = np.arctan2(-rotation[..., ANTERIOR, UP], rotation[..., UP, UP])
    b = np.arcsin(np.clip(rotation[..., RIGHT, UP], -1.0, 1.0))
    c = np.arctan2(-rotation[..., RIGHT, ANTERIOR], rotation[..., RIGHT, RIGHT])
    return np.stack([a, b, c], axis=-1)


def rotation_from_cardan(angles: Float[Array, "*frame 3"]) -> Float[Array, "*frame 3 3"]:
    """The relative rotation ``Rz(a) Rx(b) Ry(c)`` of angles [rad]."""
    (sa, sb, sc), (ca, cb, cc) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    rows = (
        (ca * cc - sa * sb * sc, -sa * cb, ca * sc + sa * sb * cc),
        (sa * cc + ca * sb * sc, ca * cb, sa * sc - ca * sb * cc),
        (-cb * sc, sb, cb * cc),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def grood_suntay_angles(
    proximal: Float[Array, "*frame 3 3"], distal: Float[Array, "*frame 3 3"]
) -> Float[Array, "*frame 3"]:
    """The same angles (a, b, c) [rad] from the axes of the joint coordinate system, without a matrix.

    The first axis is the proximal rightward one, the third the distal long one, and the floating axis is
    normal to both (Grood & Suntay 1983).
    """
    first, third = proximal[..., RIGHT], distal[..., UP]
    floating = np.cross(third, first)
    floating = floating / np.linalg.norm(floating, axis=-1, keepdims=True)
    a = np.arctan2(_dot(floating, proximal[..., UP]), _dot(floating, proximal[..., ANTERIOR]))
    b = np.arcsin(np.clip(_dot(first, third), -1.0, 1.0))
    c = np.arctan2(_dot(floating, distal[..., RIGHT]), _dot(floating, distal[..., ANTERIOR]))
    return np.stack([a, b, c], axis=-1)


def _dot(one: Float[Array, "*frame 3"], other: Float[Array, "*frame 3"]) -> Float[Array, "*frame"]:
    return np.asarray((one * other).sum(axis=-1))
