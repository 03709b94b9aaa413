"""From what shall be cast to the closed mold: every part in its place, in the order in which they depend."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold, OpType

from fabrication.core import build_core
from fabrication.filling import plan
from fabrication.fixtures.luer import placed_luer_port
from fabrication.fixtures.stand import base
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
MARK_MM = 9.0
"""Size of the letters on the pieces [mm]."""


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
        channels = (bore.body(), *vents)
    with step("fixtures"):
        stand = base(core, casting, settings, shells)
        at_port = _at(shells, filling.port + 0.5 * settings.wall_mm * filling.inlet)
        shells = tuple(
            _added(shell, [boss.body() - core.land]) if shell is at_port else shell for shell in shells
        )
        shells = tuple(_cut(shell, [*channels, *_given(stand.shell_cutters, shell.name)]) for shell in shells)
        solid = _less(core.solid, [*vents, stand.core_cutter])
    inner = Piece("core", "Core", "core", solid, None, np.eye(3), CORE_COLOUR)
    pieces = (inner, *shells, stand.piece)
    with step("poses"):
        pieces = pose_pieces(pieces, printer, core.axis)
    return Mold(
        casting=casting,
        core=core,
        pieces=pieces,
        filling=filling,
        hardware=(),
        undercut=parting.undercut_mm2,
        undercut_deg=parting.undercut_deg,
        shell_of=parting.shell_of,
        channels=channels,
        drawn=(boss, bore, *stand.placed),
    )


def _at(shells: Sequence[Piece], point: Float[Array, "3"]) -> Piece:
    """The shell nearest to a point: the one whose wall a short way through it meets most of."""
    probe = Manifold.sphere(2.0, 24).translate(tuple(point))
    return max(shells, key=lambda shell: (shell.solid ^ probe).volume())


def _given(cutters: dict[str, Manifold], name: str) -> list[Manifold]:
    return [cutters[name]] if name in cutters else []


def _added(piece: Piece, bodies: Sequence[Manifold]) -> Piece:
    return replace(piece, solid=_forced(piece.solid + Manifold.batch_boolean(list(bodies), OpType.Add)))


def _cut(piece: Piece, cutters: Sequence[Manifold]) -> Piece:
    return replace(piece, solid=_less(piece.solid, cutters))


def _less(solid: Manifold, cutters: Sequence[Manifold]) -> Manifold:
    return _forced(solid - Manifold.batch_boolean(list(cutters), OpType.Add)) if cutters else solid


def _forced(solid: Manifold) -> Manifold:
    """The same body, computed now: pending operations would be flattened into slower ones."""
    solid.volume()
    return solid
