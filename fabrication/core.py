"""The grooved core: one height field over the limb's surface, closed at its ends.

Lands lie at the level of the brace's outer face and touch the shells. Grooves lie at the level of the limb
and are what the brace is cast in. Above the upper rim the surface sinks below the limb: the open gutter.
Between the levels stand walls along the brace's outline. Only the brace of a foreign file is cut out by a
boolean.
"""

from __future__ import annotations

import igl
import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold, triangulate
from scipy.spatial import KDTree

from fabrication.bodies import body_of, mesh_of
from fabrication.draft import Levels, drafted, wall_edges
from fabrication.foreign_brace import Mesh, check_apart
from fabrication.mold import Casting, Core
from fabrication.sheet import loop_normal, rim_of
from hilbrace.config import MoldSettings
from hilbrace.errors import GeometryError
from hilbrace.pattern.thicken import border_edges, thicken

Array = np.ndarray

GUTTER_DEPTH_MM = 6.0
"""How far the gutter's floor lies below the limb."""
BACK_MM = 12.0
"""Thickness of the core behind the ground of a flat casting."""
LIFT_MM = 0.4
"""How far what is cut out of a core by a boolean stands out of it, so that no film is left."""
LEVEL = 0.35
"""Distance of the brace's outer face from the land, over its thickness, up to which it is lifted [-]."""
FACING = 0.7
"""Cosine to the way outward above which a face of the brace is part of its outer face [-]."""
FILM_MM = 0.2
"""Pieces thinner than this that a boolean leaves over the grooves are films, no lands."""
CAVITY = 0.01
"""Largest difference of the grooves of a file's brace from its volume; rounded edges come out sharper [-]."""
FOLDED_MM2 = 1.0
"""Area of the land's faces that may lie in each other: needles of a limb's mesh."""
LOOKED_AT = 20_000
"""Faces of the land that are looked at for that."""
_LEVEL_MM = 1e-3
EQUAL_MM = 1e-6
"""Triangles are merged where the surface moves by no more than this."""


def build_core(casting: Casting, settings: MoldSettings) -> Core:
    """The core of a casting, its body without grooves, and the gutter.

    Args:
        casting: What shall be cast.
        settings: Draft of the groove walls.

    Raises:
        GeometryError: The core is no single closed body, or the limb prolonged at its ends runs into itself.
    """
    lower, upper = edge_line(casting, -1), edge_line(casting, 1)
    floor = casting.vertices - _sunk(casting, upper)[:, None] * casting.direction
    land = _closed(casting, casting.outer, casting.triangles, "core without grooves").simplify(EQUAL_MM)
    check_apart(Mesh(*mesh_of(land)), "mold core", "limb in the mold", FOLDED_MM2, LOOKED_AT)
    gutter = _gutter(casting, floor, 0.0)
    if casting.covered is None:
        solid = land - _opened(casting) - _gutter(casting, floor, LIFT_MM)
        gutter = gutter - casting.brace
        _check_volume(casting, land.volume() - solid.volume() - gutter.volume())
    else:
        solid = _grooved(casting, drafted(casting, settings.draft_deg), floor - casting.vertices)
    solid = _whole(solid.simplify(EQUAL_MM))
    return Core(
        solid=solid,
        land=land,
        gutter=gutter,
        lower=casting.outer[lower],
        upper=casting.outer[upper],
        axis=casting.up,
        foot=_foot(casting),
    )


def _check_volume(casting: Casting, grooves_mm3: float) -> None:
    """Refuse a core whose grooves are not the brace: its outer face has steps that no shell follows."""
    wanted = casting.brace.volume()
    if abs(grooves_mm3 - wanted) > CAVITY * wanted:
        raise GeometryError(
            f"the grooves hold {grooves_mm3 / 1000:.2f} ml and the brace {wanted / 1000:.2f} ml",
            where="mold core",
            hint="lower mold.resolution_mm, take off what stands out from the brace, or give its limb",
        )


def _whole(solid: Manifold) -> Manifold:
    """The core without the films that a boolean leaves over the grooves."""
    parts = sorted(solid.decompose(), key=lambda part: -part.volume())
    thick = [part for part in parts[1:] if 2 * part.volume() > FILM_MM * part.surface_area()]
    if thick:
        raise GeometryError(
            f"the core falls into {len(thick) + 1} pieces",
            where="mold core",
            hint="the limb must go through the brace from end to end, and the brace lie on it",
        )
    return parts[0]


def edge_line(casting: Casting, end: int) -> Int[Array, " corner"]:
    """Vertices along the brace's lower (-1) or upper (1) edge, in order, each once."""
    own = border_edges(casting.triangles[casting.beyond == end])
    rest = border_edges(casting.triangles[casting.beyond == 0])
    count = len(casting.vertices)
    shared = np.isin(rest[:, 0] * count + rest[:, 1], own[:, 1] * count + own[:, 0])
    after = dict(rest[shared].tolist())
    starts = sorted(set(after) - set(after.values()))
    start = starts[0] if starts else min(after)
    line = [start]
    while (following := after.get(line[-1], start)) != start:
        line.append(following)
    return np.array(line)


def _sunk(casting: Casting, upper: Int[Array, " corner"]) -> Float[Array, " vertex"]:
    """How far the gutter's floor lies below the limb [mm]: as far as above the rim, up to its depth."""
    sunk = np.zeros(len(casting.vertices))
    above = np.setdiff1d(casting.triangles[casting.beyond == 1], upper)
    away = KDTree(casting.outer[upper]).query(casting.outer[above])[0]
    sunk[above] = np.minimum(away, GUTTER_DEPTH_MM)
    return sunk


def _gutter(casting: Casting, floor: Float[Array, "vertex 3"], lift_mm: float) -> Manifold:
    """The gutter, from its floor to the shells' inner face or somewhat beyond."""
    above = casting.triangles[casting.beyond == 1]
    reach = np.linalg.norm(casting.outer - floor, axis=1) + lift_mm
    height = casting.outer @ casting.up
    floor = floor + np.where(height > height.max() - _LEVEL_MM, lift_mm, 0.0)[:, None] * casting.up
    return body_of(*thicken(floor, casting.direction, above, reach), "gutter").simplify(EQUAL_MM)


def _opened(casting: Casting) -> Manifold:
    """The brace of a file, its outer face lifted a little out of the lands."""
    points, triangles = mesh_of(casting.brace)
    found = igl.point_mesh_squared_distance(points, casting.outer, casting.triangles)
    away, near = np.sqrt(np.asarray(found[0])), np.asarray(found[1])
    way = casting.direction[casting.triangles[near]].mean(axis=1)
    p = points[triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    outward = np.einsum("tx,tx->t", normal, way[triangles].mean(axis=1)) > FACING
    on_face = np.zeros(len(points), dtype=bool)
    on_face[triangles[outward]] = True
    on_face &= away < LEVEL * casting.thickness_mm
    return body_of(points + np.where(on_face, LIFT_MM, 0.0)[:, None] * way, triangles, "brace")


def _grooved(casting: Casting, levels: Levels, sunk: Float[Array, "vertex 3"]) -> Manifold:
    """Floor under brace and gutter, lands elsewhere, walls between them."""
    groove = casting.covered | (casting.beyond == 1)
    count = len(casting.vertices)
    a, b = wall_edges(casting.triangles, groove).T
    # the walls of `thicken`, seen from the other side
    walls = np.concatenate([np.stack([b, a, b + count], axis=1), np.stack([b + count, a, a + count], axis=1)])
    points = np.concatenate([levels.floor + sunk, levels.top])
    faces = np.concatenate([casting.triangles[groove], casting.triangles[~groove] + count, walls])
    return _closed(casting, points, faces, "core")


def _closed(
    casting: Casting, points: Float[Array, "point 3"], faces: Int[Array, "face 3"], name: str
) -> Manifold:
    """A body from a surface with open ends; behind the ground of a flat casting lies a plate."""
    if casting.flat:
        points, faces = _backed(casting, points, faces)
    rim = rim_of(faces)
    left = set(rim.vertices.tolist())
    caps = []
    while left:
        start = min(left)
        loop = rim.walk(start, start)[:-1][::-1]
        left -= set(loop.tolist())
        caps.append(loop[_cap(points[loop])])
    used, faces = np.unique(np.concatenate([faces, *caps]), return_inverse=True)
    return body_of(points[used], faces.reshape(-1, 3), name)


def _cap(loop: Float[Array, "corner 3"]) -> Int[Array, "triangle 3"]:
    """Triangles over a nearly plane closed line, which runs counterclockwise around their normal."""
    normal = loop_normal(loop)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    flat = (loop - loop.mean(axis=0)) @ np.stack([first, np.cross(normal, first)], axis=1)
    return np.asarray(triangulate([flat])).astype(np.int64)


def _backed(
    casting: Casting, points: Float[Array, "point 3"], faces: Int[Array, "face 3"]
) -> tuple[Float[Array, "more 3"], Int[Array, "face_or_side 3"]]:
    """A flat surface with sides down to a plane behind its ground."""
    normal = casting.direction.mean(axis=0)
    normal /= np.linalg.norm(normal)
    a, b = border_edges(faces).T
    rim, place = np.unique(np.concatenate([a, b]), return_inverse=True)
    height = (casting.vertices @ normal).min() - BACK_MM
    back = points[rim] + np.outer(height - points[rim] @ normal, normal)
    far_a, far_b = len(points) + place.reshape(2, -1)
    sides = np.concatenate([np.stack([b, a, far_a], axis=1), np.stack([b, far_a, far_b], axis=1)])
    return np.concatenate([points, back]), np.concatenate([faces, sides])


def _foot(casting: Casting) -> Float[Array, "3"]:
    """Middle of the end of the part below the lower edge."""
    points = casting.outer[np.unique(casting.triangles[casting.beyond == -1])]
    height = points @ casting.down
    end = points[height > height.max() - 1e-3]
    return (end.min(axis=0) + end.max(axis=0)) / 2
