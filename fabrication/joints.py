"""What holds the pieces together, aligns them and pries them apart: cut into them, and put on the list."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from manifold3d import Manifold, OpType

from fabrication.fixtures.bolt import bolts, placed_bolts
from fabrication.fixtures.cad import Placed
from fabrication.fixtures.jack import jack_slots, placed_jack_slots
from fabrication.fixtures.key import keys, placed_keys
from fabrication.flanges import FlangePlaces
from fabrication.mold import Hardware, Piece
from hilbrace.config import MoldSettings


@dataclass(frozen=True)
class Joints:
    """Bodies to add to the pieces and to take from them, and what to buy.

    Attributes:
        adders: Keys, by the piece that they stand on.
        sockets: Their sockets, by piece.
        everywhere: Bolt holes and jack slots, to be taken from every piece.
        hardware: Bolts, nuts, washers and clamps.
        drawn: All of it as it was drawn, for the STEP file.
    """

    adders: dict[str, Manifold]
    sockets: dict[str, Manifold]
    everywhere: tuple[Manifold, ...]
    hardware: tuple[Hardware, ...]
    drawn: tuple[Placed, ...]


def find_joints(places: FlangePlaces, settings: MoldSettings) -> Joints:
    """The joints of a mold.

    Args:
        places: Where they go.
        settings: Section ``mold``: bolts and printer.

    Raises:
        ConfigError: No metric bolt has the diameter of ``bolt_mm``.
        GeometryError: Flanges are too thin, or pieces come off too slantwise.
    """
    holes, bought = bolts(places.bolts, settings)
    pins, sockets = keys(places.keys, settings)
    clamps = (Hardware(len(places.clamps), "spring clamp, 25 mm"),) if places.clamps else ()
    cutters = (holes, jack_slots(places.jacks))
    return Joints(
        adders=pins,
        sockets=sockets,
        everywhere=tuple(cutter for cutter in cutters if not cutter.is_empty()),
        hardware=bought + clamps,
        drawn=(
            *placed_bolts(places.bolts, settings),
            *placed_keys(places.keys, settings),
            *placed_jack_slots(places.jacks),
        ),
    )


def joined(pieces: Sequence[Piece], joints: Joints) -> tuple[Piece, ...]:
    """Pieces with their keys, sockets, bolt holes and jack slots."""
    return tuple(replace(piece, solid=_joined(piece.solid, piece.name, joints)) for piece in pieces)


def _joined(solid: Manifold, name: str, joints: Joints) -> Manifold:
    if name in joints.adders:
        solid = solid + joints.adders[name]
    cutters = [*joints.everywhere, *([joints.sockets[name]] if name in joints.sockets else [])]
    if cutters:
        solid = solid - Manifold.batch_boolean(cutters, OpType.Add)
    solid.volume()  # computed now: pending operations would be flattened into slower ones
    return solid
