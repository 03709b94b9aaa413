"""The records of the workshop: what shall be cast, the pieces that cast it, and how they are filled.

Lengths in mm, in the brace's rest frame (x anterior, y up, z to the subject's right). Bodies are kept as
`manifold3d.Manifold` in double precision; single precision appears only in exported files.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from manifold3d import Manifold

Array = np.ndarray

Kind = Literal["core", "shell", "base", "fixture"]


@dataclass(frozen=True)
class Casting:
    """What shall be cast, and on what: a brace, already enlarged by the shrinkage, and the limb inside it.

    Attributes:
        name: Short name for labels and files, such as ``serve-knee-L``.
        joint: ``knee``, ``ankle``, or ``""`` of a foreign brace.
        side: ``left``, ``right`` or ``""``.
        brace: The body to cast.
        thickness_mm: Nominal thickness.
        vertices: The limb's surface under the brace and beyond its edges, an open sheet or tube (of a flat
            coupon: its ground).
        direction: Unit direction at each vertex in which the brace is thick.
        thickness: Thickness at each vertex: ``vertices + thickness * direction`` is the outer face of the
            brace, of the core's lands and the inner face of the shells, all with the same triangles.
        triangles: Triangles of that surface, outward.
        covered: Triangles under the brace, whose border is exactly the brace's outline; ``None`` of a
            foreign brace, whose grooves are cut by a boolean instead.
        beyond: Which triangles lie beyond the brace's edges: -1 below the lower one (the foot that the core
            stands on), 1 above the upper one (the gutter), 2 beside the gutter of a flat casting, 0 between
            the edges. These parts are ruled: the edge of the outer face moved straight along an axis, so
            that a shell slides off them sideways.
        down: Unit direction in which the part below the lower edge runs: opposite to ``up``, but forwards of
            an ankle's.
        up: Unit direction in which the part above the upper edge runs; up while casting.
        centreline: Points along the limb's axis from the lower to the upper edge, bends included.
        shrinkage: Linear enlargement that the brace got, 0.001 for 0.1 % [-].
        flat: The surface is a sheet with one border (a coupon on its ground), not a tube.
        repairs: What was mended in a foreign brace, a sentence each.
    """

    name: str
    joint: str
    side: str
    brace: Manifold
    thickness_mm: float
    vertices: Float[Array, "vertex 3"]
    direction: Float[Array, "vertex 3"]
    thickness: Float[Array, " vertex"]
    triangles: Int[Array, "triangle 3"]
    covered: Bool[Array, " triangle"] | None
    beyond: Int[Array, " triangle"]
    down: Float[Array, "3"]
    up: Float[Array, "3"]
    centreline: Float[Array, "point 3"]
    shrinkage: float
    flat: bool = False
    repairs: tuple[str, ...] = ()

    @property
    def outer(self) -> Float[Array, "vertex 3"]:
        """The outer face: the level of the core's lands and of the shells' inner faces."""
        return self.vertices + self.thickness[:, None] * self.direction


@dataclass(frozen=True)
class Core:
    """The limb's stand-in, with the brace as grooves in it.

    Attributes:
        solid: The grooved core: its lands touch the shells, its grooves and gutter are the cavity.
        land: The same body without grooves and gutter. Shells are cut with this very mesh.
        gutter: The open ring along the upper rim, as a body: sprue, riser and vent in one.
        lower: Points of the outer face along the brace's lower rim.
        upper: Points of the outer face along the brace's upper rim.
        axis: Unit direction in which the core stands, from foot to gutter.
        foot: Middle of the flat end below the lower rim, across ``Casting.down``.
    """

    solid: Manifold
    land: Manifold
    gutter: Manifold
    lower: Float[Array, "low 3"]
    upper: Float[Array, "up 3"]
    axis: Float[Array, "3"]
    foot: Float[Array, "3"]


@dataclass(frozen=True)
class Piece:
    """One piece to print.

    Attributes:
        name: File name without ending, such as ``shell_medial``.
        title: What a person calls it.
        kind: What it is.
        solid: Its body where it sits in the closed mold.
        pull: Unit direction in which it comes off; ``None`` of what stays.
        printing: Rotation that turns it as it stands on the printer's bed, whose z is up.
        colour: Red, green, blue, 0 to 1.
    """

    name: str
    title: str
    kind: Kind
    solid: Manifold
    pull: Float[Array, "3"] | None
    printing: Float[Array, "3 3"]
    colour: tuple[float, float, float]


@dataclass(frozen=True)
class Hardware:
    """Something to buy.

    Attributes:
        count: How many.
        name: What, such as ``M4 x 25 bolt``.
    """

    count: int
    name: str


@dataclass(frozen=True)
class Filling:
    """How the silicone gets in and the air out.

    Attributes:
        up: Unit direction that is up while casting.
        port: Where the syringe goes in: a point of the cavity.
        vents: Points of the cavity where bubbles would stay without the vents that were drilled.
        inlet: Unit direction out of the cavity at the port, along which the syringe stands.
    """

    up: Float[Array, "3"]
    port: Float[Array, "3"]
    vents: Float[Array, "vent 3"]
    inlet: Float[Array, "3"]


@dataclass(frozen=True)
class Mold:
    """A closed mold.

    Attributes:
        casting: What it casts.
        core: Its core, before a bed split.
        pieces: Everything to print, core first, then shells, base and fixtures, after the bed split.
        filling: How it is filled.
        hardware: What to buy.
        undercut: Area of the shells' inner faces that hinders their removal [mm^2], by piece.
        undercut_deg: Angle by which each triangle of the casting's surface hinders the shell on it, negative
            where it lets the shell go [deg].
        shell_of: Number of the shell on each triangle of the casting's surface.
        channels: Room that is filled but belongs to neither brace nor gutter: port, vents, reliefs.
        gaps: Room in the pieces that stays empty: bolt holes, jack slots, the clearance of keys.
        drawn: Fixtures as they were drawn (`fabrication.fixtures.cad.Placed`), for the STEP file.
    """

    casting: Casting
    core: Core
    pieces: tuple[Piece, ...]
    filling: Filling
    hardware: tuple[Hardware, ...]
    undercut: dict[str, float] = field(default_factory=dict)
    undercut_deg: Float[Array, " triangle"] = field(default_factory=lambda: np.zeros(0))
    shell_of: Int[Array, " triangle"] = field(default_factory=lambda: np.zeros(0, np.int64))
    channels: tuple[Manifold, ...] = ()
    gaps: tuple[Manifold, ...] = ()
    drawn: tuple[Any, ...] = ()

    def of(self, kind: Kind) -> tuple[Piece, ...]:
        """Pieces of a kind."""
        return tuple(piece for piece in self.pieces if piece.kind == kind)
