"""Random designs through the whole workshop: every figure that is proved of a mold holds for each of them."""

from __future__ import annotations

import pytest

from fabrication.build import build_mold
from fabrication.casting import casting_of
from fabrication.checks import check_mold
from fabrication.printable import printable
from fabrication.printers import profile
from hilbrace.config import MoldSettings, SolidSettings
from hilbrace.domain.domain import Domain
from hilbrace.pattern.build import build_pattern, build_solid
from tests.unit.random_patterns import random_task
from tests.unit.sleeve import sleeve_domain
from tests.unit.test_pattern_fuzz import CELLS, limb_domain

BED_MM = (250.0, 210.0, 210.0)
STEPS_MM = (0.25, 0.5, 1, 2, 4, 8, 16, 32, 64, 128)
SOAK = 20


def check(
    seed: int,
    domain: Domain,
    cells: tuple[str, ...],
    struts: tuple[float, float],
    settings: MoldSettings,
) -> None:
    """One random design: its mold keeps every limit; those that it is judged by are measured once more."""
    pattern_settings, material, design = random_task(seed, domain, cells, struts)
    pattern = build_pattern(domain, design, pattern_settings, material)
    solid = build_solid(pattern, domain, design, material, SolidSettings())
    casting = casting_of(f"random-{seed}", domain, pattern, solid, settings)
    mold = build_mold(casting, settings)
    pieces = [printable(piece) for piece in mold.pieces]
    checks = check_mold(mold, pieces, profile(settings))
    failed = {
        name: (found.value, found.rule, found.where) for name, found in checks.items() if not found.passed
    }
    assert failed == {}, seed
    for piece in pieces:
        assert (piece.parts, piece.voids, piece.open_edges) == (1, 0, 0), (seed, piece.piece.name)
        width, depth, height = piece.size
        assert max(width, depth) <= BED_MM[0], (seed, piece.piece.name)
        assert min(width, depth) <= BED_MM[1], (seed, piece.piece.name)
        assert height <= BED_MM[2], (seed, piece.piece.name)
    shells = mold.of("shell")
    core = [piece.solid for piece in mold.of("core")]
    for shell in shells:
        assert sum((shell.solid ^ body).volume() for body in core) <= 2.0, (seed, shell.name)
        for step in STEPS_MM:
            moved = shell.solid.translate(tuple(step * shell.pull))
            others = core + [
                other.solid for other in shells if other is not shell and not (other.pull == shell.pull).all()
            ]
            assert sum((moved ^ body).volume() for body in others) < 1e-3, (seed, shell.name, step)


@pytest.mark.parametrize("seed", [1, 4])
def test_random_designs_give_molds_that_keep_every_limit(seed):
    domain = sleeve_domain(around=34, along=9, height_mm=84.0)
    check(seed, domain, ("sinusoidal", "voronoi_open"), (2.8, 3.2), MoldSettings(resolution_mm=2.0))


@pytest.mark.soak
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", range(SOAK))
def test_twenty_random_designs_on_knees_and_ankles(seed):
    joint = ("knee", "ankle")[seed % 2]
    domain = limb_domain(joint, ("periodic", "lscm", "slim")[seed // 2 % 3])
    check(1000 + seed, domain, CELLS, (1.8, 3.2), MoldSettings())
