"""The outer shells: an even wall around the limb with flanges where they meet, hollowed by the land."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold, OpType

from fabrication.bodies import body_of
from fabrication.ends import border_loops
from fabrication.fixtures.bolt import least_thickness
from fabrication.hardware import fastener
from fabrication.mold import Casting, Core, Piece
from fabrication.offsets import surroundings, thick_body
from fabrication.parting import Parting
from hilbrace.config.mold import MoldSettings
from hilbrace.errors import GeometryError

Array = np.ndarray

FLANGE_THICKNESS_MM = 6.0
"""Least thickness of each flange: an M4 bolt's head and nut sink into two of them [mm]."""

EXTRA_WALL_MM = 0.3
"""What chords of the outer face and the spacing of the points may cut off, added to the wall [mm]."""

WALL_SPACING_MM, WIDE_SPACING_MM = 1.5, 3.0
"""Spacing of the points that stand for the limb under the wall and under the flanges' edge [mm]."""

DUST_MM3 = 1.0
"""Crumbs that rounding leaves beside a shell, all together [mm^3]."""

COLOURS = ((0.36, 0.56, 0.80), (0.93, 0.66, 0.33), (0.50, 0.72, 0.45), (0.75, 0.52, 0.74))


def build_shells(casting: Casting, core: Core, parting: Parting, settings: MoldSettings) -> tuple[Piece, ...]:
    """Make the shells, without bolts, keys and ports.

    Their outer face is a level set of the distance from the limb, so it has no folds and the wall is nowhere
    thinner than wanted; their inner face is the core's land, triangle by triangle.

    Args:
        casting: What shall be cast.
        core: Its core.
        parting: Where the shells meet and which way they come off.
        settings: Section ``mold``: wall and flanges.

    Raises:
        GeometryError: A shell falls apart.
    """
    body = _lid(casting, settings) if casting.flat else _sleeve(core, parting, settings)
    body = body - core.land
    body.volume()  # computed once, not again for each shell
    pieces = []
    rooms = zip(parting.names, parting.titles, parting.sectors, parting.reliefs, parting.pulls, strict=True)
    for number, (name, title, sector, clearing, pull) in enumerate(rooms):
        solid = body ^ sector
        if not clearing.is_empty():
            solid = solid - clearing
        pieces.append(
            Piece(
                name=name,
                title=title,
                kind="shell",
                solid=one_part(solid, name),
                pull=pull,
                printing=np.eye(3),
                colour=COLOURS[number % len(COLOURS)],
            )
        )
    return tuple(pieces)


def one_part(solid: Manifold, name: str) -> Manifold:
    """A body freed of the crumbs that rounding leaves beside it.

    Raises:
        GeometryError: It consists of several parts of some size.
    """
    parts = sorted(solid.decompose(), key=lambda part: part.volume(), reverse=True)
    if not parts:
        raise GeometryError(f"{name} is empty", where="mold shells", hint="check the limb's surface")
    crumbs = sum(abs(part.volume()) for part in parts[1:])
    if crumbs > DUST_MM3:
        raise GeometryError(
            f"{name} falls into {len(parts)} parts",
            where="mold shells",
            hint="choose another number in mold.shells or a thicker mold.wall_mm",
        )
    return parts[0]


def flange_thickness(settings: MoldSettings) -> float:
    """Thickness of each flange, as the nuts of its bolts need it [mm].

    Args:
        settings: Section ``mold``: size of the bolts.
    """
    return max(FLANGE_THICKNESS_MM, least_thickness(fastener(settings.bolt_mm)))


def _sleeve(core: Core, parting: Parting, settings: MoldSettings) -> Manifold:
    """Wall and flanges around a tube, still full of limb."""
    wall = thick_body(surroundings(core.land, WALL_SPACING_MM), settings.wall_mm + EXTRA_WALL_MM)
    wide = thick_body(surroundings(core.land, WIDE_SPACING_MM), settings.wall_mm + settings.flange_mm)
    slabs = [seam.slab(flange_thickness(settings)) for seam in parting.seams]
    flanges = wide ^ Manifold.batch_boolean(slabs, OpType.Add)
    body = wall + flanges
    for end in parting.ends:
        body = end.trim(body)
    return body


def _lid(casting: Casting, settings: MoldSettings) -> Manifold:
    """A plate on a flat casting: its surface, moved along the pull."""
    normal = casting.direction.mean(axis=0)
    lift = settings.wall_mm * normal / np.linalg.norm(normal)
    return swept(casting.outer, casting.triangles, lift)


def swept(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], way: Float[Array, "3"]
) -> Manifold:
    """The body that a surface sweeps on a straight way to its outer side."""
    count = len(vertices)
    walls = []
    for loop in border_loops(triangles):
        ahead = np.roll(loop, -1)
        walls += [
            np.stack([loop, ahead, ahead + count], axis=1),
            np.stack([loop, ahead + count, loop + count], axis=1),
        ]
    faces = np.concatenate([triangles[:, ::-1], triangles + count, *walls])
    return body_of(np.concatenate([vertices, vertices + way]), faces, "lid")
