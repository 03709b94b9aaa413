"""Small molds whose shells tests look at, each made once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from manifold3d import Manifold

from fabrication.bodies import body_of
from fabrication.ends import border_loops
from fabrication.mold import Casting, Core, Piece
from fabrication.parting import Parting, find_parting
from fabrication.shells import build_shells
from hilbrace.config.mold import MoldSettings
from tests.unit.mold_cases import bent_tube, flat_coupon


@dataclass(frozen=True)
class Case:
    """A casting with its shells."""

    casting: Casting
    core: Core
    parting: Parting
    shells: tuple[Piece, ...]
    settings: MoldSettings


@cache
def tube_case(shells: int | None = None) -> Case:
    """The bent tube."""
    return shelled(bent_tube(), MoldSettings(shells=shells))


@cache
def coupon_case() -> Case:
    """The flat coupon."""
    return shelled(flat_coupon(), MoldSettings())


def shelled(casting: Casting, settings: MoldSettings) -> Case:
    """Shells around a core without grooves."""
    core = plain_core(casting)
    parting = find_parting(casting, core, settings)
    return Case(casting, core, parting, build_shells(casting, core, parting, settings), settings)


def plain_core(casting: Casting) -> Core:
    """The limb up to the brace's outer face, closed flat."""
    vertices, triangles = [casting.outer], [casting.triangles]
    count = len(casting.outer)
    if casting.flat:
        vertices.append(casting.outer - 12.0 * casting.direction)
        triangles.append(casting.triangles[:, ::-1] + count)
    for loop in border_loops(casting.triangles):
        ahead = np.roll(loop, -1)
        if casting.flat:
            triangles.append(np.stack([ahead, loop, loop + count], axis=1))
            triangles.append(np.stack([ahead, loop + count, ahead + count], axis=1))
        else:
            number = sum(map(len, vertices))
            vertices.append(casting.outer[loop].mean(axis=0)[None])
            triangles.append(np.stack([ahead, loop, np.full(len(loop), number)], axis=1))
    land = body_of(np.concatenate(vertices), np.concatenate(triangles), "land").simplify(1e-6)
    none = np.zeros((0, 3))
    return Core(land, land, land.trim_by_plane((0, 1, 0), 1e9), none, none, casting.up, np.zeros(3))


def tube_of(
    centre_z: np.ndarray, radius: np.ndarray, y: np.ndarray, around: int = 72, joint: str = "", side: str = ""
) -> Casting:
    """A tube of given sections, star-shaped about a centre that moves sideways; all rows under the brace.

    Args:
        centre_z: Sideways position of the centre in each row [mm].
        radius: Radius at each turn and row [mm].
        y: Heights of the rows [mm].
        around: Vertices around.
        joint: Of the casting.
        side: Of the casting.
    """
    turn = np.arange(around) / around * 2 * np.pi
    points = np.stack(
        [radius * np.sin(turn)[:, None], np.tile(y, (around, 1)), radius * np.cos(turn)[:, None] + centre_z],
        axis=-1,
    )
    ends = [points[:, :1] - [0, 12.0, 0], points, points[:, -1:] + [0, 12.0, 0]]
    grid = np.concatenate(ends, axis=1)
    rows = grid.shape[1]
    i, j = np.meshgrid(np.arange(around), np.arange(rows - 1), indexing="ij")
    a, b, c, d = (
        p * rows + q for p, q in ((i, j), ((i + 1) % around, j), ((i + 1) % around, j + 1), (i, j + 1))
    )
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    band = np.where(j == 0, -1, np.where(j == rows - 2, 1, 0))
    vertices = grid.reshape(-1, 3)
    line = np.stack([0 * y, y, centre_z], axis=1)
    return Casting(
        name="limb",
        joint=joint,
        side=side,
        brace=Manifold.cube((60.0, 60.0, 60.0)),
        thickness_mm=4.0,
        vertices=vertices,
        direction=np.tile([0.0, 0.0, 1.0], (len(vertices), 1)),
        thickness=np.zeros(len(vertices)),
        triangles=triangles,
        covered=None,
        beyond=np.repeat(band.reshape(-1), 2),
        down=np.array([0.0, -1.0, 0.0]),
        up=np.array([0.0, 1.0, 0.0]),
        centreline=line,
        shrinkage=0.0,
    )
