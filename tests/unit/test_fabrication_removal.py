"""The proof of removal: closed forms, the front and back split that must fail, and the rule of the keys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.mold import Piece
from fabrication.removal import STEPS_MM, collision, collisions
from fabrication.shells import build_shells
from tests.unit.mold_shells import Case, tube_case

FREE_MM3 = 1e-3


def test_steps_are_those_that_the_mold_is_judged_by():
    assert STEPS_MM == (0.25, 0.5, 1, 2, 4, 8, 16, 32, 64, 128)


def test_a_block_under_a_ledge_runs_into_it_by_the_way_it_moved():
    block = Manifold.cube((10, 10, 10))
    ledge = Manifold.cube((4, 10, 3)).translate((6, 0, 10))
    shared = collisions(block, [ledge], np.array([0.0, 0.0, 1.0]))
    expected = [40 * max(min(step, 3.0, 13 - step), 0.0) for step in STEPS_MM]
    np.testing.assert_allclose(shared, expected, atol=1e-9)


def test_a_gap_smaller_than_a_coarse_step_is_seen():
    block = Manifold.cube((10, 10, 1))
    fin = Manifold.cube((10, 10, 0.2)).translate((0, 0, 1.2))
    assert collisions(block, [fin], np.array([0.0, 0.0, 1.0])).max() > 4.9


def test_pieces_that_stay_and_faces_that_slide_are_free():
    block = Manifold.cube((10, 10, 10))
    piece = Piece("a", "A", "core", block, None, np.eye(3), (1.0, 1.0, 1.0))
    other = replace(piece, name="b", solid=block.translate((10, 0, 0)))
    assert collision(piece, [other]) == 0.0
    assert collision(piece, [other], np.array([0.0, 1.0, 0.0])) < FREE_MM3


def split_in_plane(case: Case, normal: np.ndarray) -> tuple[Piece, ...]:
    """Shells on both sides of a plane through the middle of the limb, as they come."""
    size = 400.0
    room = Manifold.cube((size, size, size), True)
    above = room.trim_by_plane(tuple(normal), 0.0)
    below = room.trim_by_plane(tuple(-normal), 0.0)
    parting = replace(
        case.parting,
        pulls=np.stack([normal, -normal]),
        sectors=(above, below),
        reliefs=(Manifold(), Manifold()),
    )
    return build_shells(case.casting, case.core, parting, case.settings)


def worst(case: Case, shells: tuple[Piece, ...]) -> float:
    land = case.core.land
    return max(
        collisions(shell.solid, [land], shell.pull).max() for shell in shells if shell.pull is not None
    )


def test_front_and_back_halves_of_a_bent_limb_are_caught():
    case = tube_case()
    assert worst(case, split_in_plane(case, np.array([1.0, 0.0, 0.0]))) > 10.0


def test_halves_beside_the_plane_of_the_bent_axis_are_free():
    case = tube_case()
    assert worst(case, split_in_plane(case, np.array([0.0, 0.0, 1.0]))) < FREE_MM3


@pytest.mark.parametrize("count", [None, 3])
def test_shells_of_the_chosen_parting_are_free(count):
    case = tube_case(count)
    land = Piece("core", "Core", "core", case.core.land, None, np.eye(3), (1.0, 1.0, 1.0))
    for shell in case.shells:
        others = [land, *(other for other in case.shells if other is not shell)]
        assert collision(shell, others) < FREE_MM3


@pytest.mark.parametrize("count", [3, 4])
def test_cones_of_keys_must_open_wider_than_the_pull_slants(count):
    slant = np.pi / 2 - np.pi / count
    pull = np.array([np.sin(slant), 0.0, np.cos(slant)])
    socket = Manifold.cube((30, 30, 10), True).translate((0, 0, 5.0))
    for spare_deg, free in ((-3.0, False), (3.0, True)):
        tip = 8.0 - 3.0 * np.tan(slant + np.radians(spare_deg))
        key = Manifold.cylinder(3.0, 8.0, tip, 256)
        moved = collisions(socket - key, [key], pull).max()
        assert (moved < 1e-6) == free
