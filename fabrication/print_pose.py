"""How each piece stands on the printer's bed, and what that costs: support, height, and whether it fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold
from scipy.spatial import ConvexHull

from fabrication.bodies import mesh_of
from fabrication.mold import Piece
from fabrication.printers import Printer

Array = np.ndarray

BED_MM = 0.05
"""Faces this close to the bed lie on it [mm]."""

LEAN_MM2 = 100.0
"""Poses whose overhang differs by less than this are equally good, and the lower one is taken [mm^2]."""

FLATS, FLAT_DIGITS = 4, 6
"""How many of a body's flats it may stand on, and how exactly normals agree on one flat."""

TURN_DEG = 1.0
"""Step in which a piece is turned on the bed to see whether it fits [deg]."""


@dataclass(frozen=True)
class Pose:
    """A piece as it stands on the bed, and what that costs.

    Attributes:
        rotation: Turns the piece; its rows are the printer's axes, z up.
        size: Width, depth and height on the bed [mm].
        overhang_mm2: Area that needs support: faces from below, flatter than it can print [mm^2].
        contact_mm2: Area that lies on the bed [mm^2].
        fits: Whether the piece stays inside the printer's usable room.
    """

    rotation: Float[Array, "3 3"]
    size: tuple[float, float, float]
    overhang_mm2: float
    contact_mm2: float
    fits: bool


@dataclass(frozen=True)
class PrintCost:
    """What printing a piece costs.

    Attributes:
        name: The piece.
        pose: How it stands.
        volume_ml: Its volume, all filled [ml].
    """

    name: str
    pose: Pose
    volume_ml: float


def pose_pieces(pieces: Sequence[Piece], printer: Printer, up: Float[Array, "3"]) -> tuple[Piece, ...]:
    """Turn each piece as it is printed best.

    The core stands upright, so that its grooves are round about, or on one of its ends if it has no sole, and
    the base lies as it stands. A shell stands on either end or lies on its flanges or its back, whichever
    fits and needs the least support.

    Args:
        pieces: Pieces at their places in the mold.
        printer: The printer.
        up: Unit direction in which the mold stands.
    """
    return tuple(replace(piece, printing=best_pose(piece, printer, up).rotation) for piece in pieces)


def best_pose(piece: Piece, printer: Printer, up: Float[Array, "3"]) -> Pose:
    """The way in which a piece is printed best: one that fits, with the least support, and then the lowest.

    Args:
        piece: The piece at its place in the mold.
        printer: The printer.
        up: Unit direction in which the mold stands.

    Returns:
        The pose; one that does not fit if none does.
    """
    poses = [pose(piece.solid, rising, printer) for rising in _candidates(piece, up, printer)]
    fitting = [each for each in poses if each.fits] or poses
    least = min(each.overhang_mm2 for each in fitting)
    good = [each for each in fitting if each.overhang_mm2 <= least + LEAN_MM2]
    return min(good, key=lambda each: each.size[2])


def pose(solid: Manifold, rising: Float[Array, "3"], printer: Printer) -> Pose:
    """How a body stands on the bed with one of its directions up, turned about it so that it fits best.

    Args:
        solid: The body.
        rising: Unit direction that points up from the bed.
        printer: The printer.
    """
    vertices, triangles = mesh_of(solid)
    upright = _upright(rising)
    turn, width, depth = _fit(vertices @ upright[:2].T, printer)
    rotation = turn @ upright
    height = vertices @ rising
    size = (width, depth, float(np.ptp(height)))
    overhang, contact = _areas_below(vertices, triangles, rising, printer)
    fits = all(length <= room for length, room in zip(size, printer.usable_mm, strict=True))
    return Pose(rotation, size, overhang, contact, fits)


def printing_costs(pieces: Sequence[Piece], printer: Printer) -> tuple[PrintCost, ...]:
    """What printing each piece costs in the pose it has.

    Args:
        pieces: Pieces with their ``printing`` rotation.
        printer: The printer.
    """
    return tuple(
        PrintCost(piece.name, _posed(piece, printer), piece.solid.volume() / 1000.0) for piece in pieces
    )


def _posed(piece: Piece, printer: Printer) -> Pose:
    vertices, triangles = mesh_of(piece.solid)
    width, depth, height = (float(length) for length in np.ptp(vertices @ piece.printing.T, axis=0))
    overhang, contact = _areas_below(vertices, triangles, piece.printing[2], printer)
    fits = all(length <= room for length, room in zip((width, depth, height), printer.usable_mm, strict=True))
    return Pose(piece.printing, (width, depth, height), overhang, contact, fits)


def _candidates(piece: Piece, up: Array, printer: Printer) -> list[Array]:
    if piece.kind == "base":
        return [up]
    if piece.kind == "core" or piece.pull is None:
        stands = pose(piece.solid, up, printer).contact_mm2 > LEAN_MM2
        return [up] if stands else [up, -up, *_off_flats(piece.solid)]
    across = piece.pull - (piece.pull @ up) * up
    if np.linalg.norm(across) < 1e-6:
        return [up, -up]
    across = across / np.linalg.norm(across)
    return [up, -up, across, -across]


def _off_flats(solid: Manifold) -> list[Float[Array, "3"]]:
    """Directions in which a body rises when it stands on one of its largest flats."""
    vertices, triangles = mesh_of(solid)
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    twice = np.linalg.norm(normals, axis=1)
    unit = normals[twice > 0] / twice[twice > 0, None]
    _, first, index = np.unique(unit.round(FLAT_DIGITS), axis=0, return_index=True, return_inverse=True)
    areas = np.bincount(index.reshape(-1), weights=0.5 * twice[twice > 0])
    return [-unit[first[each]] for each in np.argsort(-areas, kind="stable")[:FLATS]]


def _upright(rising: Array) -> Float[Array, "3 3"]:
    """A rotation whose last row is a direction."""
    side = np.eye(3)[int(np.argmin(np.abs(rising)))]
    x = side - (side @ rising) * rising
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(rising, x), rising])


def _fit(shadow: Float[Array, "vertex 2"], printer: Printer) -> tuple[Float[Array, "3 3"], float, float]:
    """The turn about z that leaves most room around a shadow on the bed, and the shadow's width and depth."""
    outline = shadow[ConvexHull(shadow).vertices]
    angles = np.radians(np.arange(0.0, 180.0, TURN_DEG))
    turned = np.stack(
        [
            np.outer(np.cos(angles), outline[:, 0]) - np.outer(np.sin(angles), outline[:, 1]),
            np.outer(np.sin(angles), outline[:, 0]) + np.outer(np.cos(angles), outline[:, 1]),
        ]
    )
    width, depth = np.ptp(turned, axis=2)
    use = np.maximum(width / printer.usable_mm[0], depth / printer.usable_mm[1])
    best = int(np.argmin(use))
    c, s = np.cos(angles[best]), np.sin(angles[best])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), float(width[best]), float(depth[best])


def _areas_below(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    rising: Float[Array, "3"],
    printer: Printer,
) -> tuple[float, float]:
    """Area of a body's overhangs, and the area on which it stands [mm^2]."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    area = 0.5 * np.linalg.norm(normals, axis=1)
    down = 0.5 * (normals @ -rising)
    height = vertices @ rising
    standing = height[triangles].max(axis=1) < height.min() + BED_MM
    flat = down > area * np.cos(np.radians(printer.overhang_deg)) * (1 + 1e-9)
    return float(area[flat & ~standing].sum()), float(area[flat & standing].sum())
