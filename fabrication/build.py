"""From what shall be cast to the closed mold: every part in its place, in the order in which they depend."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold, OpType

from fabrication.bed_split import split_for_bed
from fabrication.core import build_core
from fabrication.filling import plan
from fabrication.fixtures.cad import union
from fabrication.fixtures.luer import placed_luer_port, syringe_room
from fabrication.fixtures.stand import base
from fabrication.flanges import flange_places
from fabrication.hardware import shopping_list
from fabrication.joints import Joints, find_joints, joined
from fabrication.marking import marked
from fabrication.mold import Casting, Mold, Piece
from fabrication.parting import find_parting
from fabrication.print_pose import pose_pieces
from fabrication.printers import profile
from fabrication.shells import build_shells
from hilbrace.config.mold import MoldSettings

Step = Callable[[str], AbstractContextManager[object]]
"""Opened around each step with its name, so that a person sees how far the work is."""

Array = np.ndarray

CORE_COLOUR = (0.84, 0.82, 0.77)


def quietly(name: str) -> AbstractContextManager[object]:
    """A step that shows nothing."""
    return contextlib.nullcontext(name)


def build_mold(casting: Casting, settings: MoldSettings, step: Step = quietly) -> Mold:
    """Make the mold of a casting.

    Args:
        casting: What shall be cast, enlarged by the shrinkage.
        settings: Section ``mold``.
        step: Opened around each step.

    Raises:
        GeometryError: No parting comes apart, or a part does not fit where it must.
    """
    printer = profile(settings)
    with step("core"):
        core = build_core(casting, settings)
    with step("parting"):
        parting = find_parting(casting, core, settings)
    with step("shells"):
        shells = build_shells(casting, core, parting, settings)
    with step("filling"):
        filling, vents = plan(casting, core, shells, settings)
        boss, bore = placed_luer_port(filling.port, filling.inlet, settings.wall_mm)
    with step("fixtures"):
        places = flange_places(casting, parting, settings)
        joints = find_joints(places, settings)
        ported = _at(shells, filling.port + 0.5 * settings.wall_mm * filling.inlet).name
        out_of_core = [boss.body() - core.land]
        shells = tuple(_fitted(piece, out_of_core if piece.name == ported else [], []) for piece in shells)
        syringe = syringe_room(filling.port, filling.inlet, settings.wall_mm)
        stand = base(core, casting, settings, shells, [syringe])
        shells = tuple(
            _fitted(piece, [], [bore.body(), *vents, *_given(stand.shell_cutters, piece.name)])
            for piece in shells
        )
        inner = Piece("core", "Core", "core", core.solid, None, np.eye(3), CORE_COLOUR)
        inner = _fitted(inner, [], [*vents, stand.core_cutter])
        pieces = joined((inner, *shells), joints)
    with step("bed"):
        taken = [place.point for place in (*places.bolts, *places.keys, *places.jacks)]
        avoid = np.array([*taken, filling.port, *filling.vents])
        split = split_for_bed((*pieces, stand.piece), printer, core, settings, avoid)
    with step("marks"):
        pieces = marked(split.pieces, casting, core.axis)
    with step("poses"):
        pieces = pose_pieces(pieces, printer, core.axis)
    return Mold(
        casting=casting,
        core=core,
        pieces=pieces,
        filling=filling,
        hardware=shopping_list((*joints.hardware, *split.hardware)),
        undercut=parting.undercut_mm2,
        undercut_deg=parting.undercut_deg,
        shell_of=parting.shell_of,
        channels=(bore.body(), *vents),
        gaps=_gaps((inner, *shells), joints) if casting.flat else (),
        drawn=(boss, bore, *joints.drawn, *split.drawn, *stand.placed),
    )


def _gaps(pieces: Sequence[Piece], joints: Joints) -> tuple[Manifold, ...]:
    """What the joints take from pieces and no key fills: only a lid's lie where its casting is measured."""
    pins = union(joints.adders.values())
    cutters = [(piece, [*joints.everywhere, *_given(joints.sockets, piece.name)]) for piece in pieces]
    return tuple((piece.solid ^ union(bodies)) - pins for piece, bodies in cutters if bodies)


def _at(shells: Sequence[Piece], point: Float[Array, "3"]) -> Piece:
    """The shell nearest to a point: the one whose wall a short way through it meets most of."""
    probe = Manifold.sphere(2.0, 24).translate(tuple(point))
    return max(shells, key=lambda shell: (shell.solid ^ probe).volume())


def _given(cutters: dict[str, Manifold], name: str) -> list[Manifold]:
    return [cutters[name]] if name in cutters else []


def _fitted(piece: Piece, adders: Sequence[Manifold], cutters: Sequence[Manifold]) -> Piece:
    """A piece with what its fixtures add to it and then take from it, computed now.

    Pending operations would be flattened into slower ones.
    """
    solid = piece.solid
    for bodies, operation in ((adders, OpType.Add), (cutters, OpType.Subtract)):
        full = [body for body in bodies if not body.is_empty()]
        if full:
            solid = Manifold.batch_boolean([solid, *full], operation)
            solid.volume()
    return replace(piece, solid=solid)
