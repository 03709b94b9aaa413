"""What shall be cast: the brace of a run or a file, and the limb's surface under it and beyond its edges."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from fabrication.bodies import body_of
from fabrication.foreign_brace import Mesh, read_brace
from fabrication.foreign_limb import cut_tube, read_limb
from fabrication.foreign_sheet import flat_normal, on_ground, on_limb
from fabrication.guessed_limb import guessed_limb
from fabrication.limb import Limb, centreline, with_windows_filled
from fabrication.mold import Casting
from fabrication.printers import profile
from fabrication.sheet import Rim, Sheet, loop_normal, prolonged, rim_of
from fabrication.sleeve_axis import span_of, tube_axis
from hilbrace.config import MoldSettings, read_config
from hilbrace.domain.domain import Domain
from hilbrace.errors import GeometryError, InputError
from hilbrace.pattern.fields import places_on
from hilbrace.pattern.offset import Offset, safe_offset
from hilbrace.pattern.pattern import Pattern, Solid
from hilbrace.pattern.thicken import border_edges
from hilbrace.run.records import load

Array = np.ndarray

STANDING = 0.55
"""Cosine of the angle between each end and the way from one to the other above which the core stands straight
on its foot; else, as with an ankle, upright is along the upper end [-]."""
_TOUCH_MM = 1e-6
_SIDES = {"l": "left", "r": "right"}


def casting_of_run(folder: Path, settings: MoldSettings) -> Casting:
    """The brace of a run, ready for its mold.

    Args:
        folder: The run's folder, at least up to the stage ``solid``.
        settings: Shrinkage, foot and gutter.

    Raises:
        InputError: A record is missing, damaged, or of a version that molds cannot be made from.
        GeometryError: The brace is no single closed body, or the limb cannot be prolonged.
    """
    domain = load(Domain, folder / "domain" / "domain.npz")
    pattern = load(Pattern, folder / "pattern" / "pattern.npz")
    solid = load(Solid, folder / "solid" / "solid.npz")
    _check(folder, pattern, solid)
    motion = read_config(folder / "run.toml").motion
    recording = motion.synthetic or (motion.markers.stem if motion.markers else "brace")
    return casting_of(recording, domain, pattern, solid, settings)


def casting_of_stl(
    brace: Path, limb: Path | None, settings: MoldSettings, units: str | None = None
) -> Casting:
    """A brace from a file, ready for its mold; sleeves around a fairly straight limb, and flat coupons.

    Args:
        brace: STL, PLY or OBJ file of the brace.
        limb: The same of the limb that it lies on; a sleeve's is guessed, and a coupon lies on its ground.
        settings: Printer, shrinkage, foot, gutter and resolution.
        units: Unit of both files; told from the brace's size if left out.

    Raises:
        InputError: A file is missing or no mesh, or the unit cannot be told.
        GeometryError: The brace is unsound (see `read_brace`), or does not lie on its limb.
    """
    given = read_brace(brace, profile(settings), units)
    where = str(brace)
    growth = _growth(settings)
    centre = centre_of(*given.mesh)
    mesh = Mesh(centre + growth * (given.mesh.vertices - centre), given.mesh.triangles)
    normal = flat_normal(mesh) if limb is None else None
    if normal is not None:
        laid = on_ground(mesh, normal, settings, where)
        said: list[str] = []
    else:
        up = tube_axis(mesh, where)
        span = span_of(mesh, up)
        if limb is None:
            tube = guessed_limb(mesh, span, settings.resolution_mm, where)
            said = ["no limb was given: the core is shaped after the brace's inner face"]
        else:
            whole = read_limb(limb, given.factor)
            whole = Mesh(centre + growth * (whole.vertices - centre), whole.triangles)
            tube, said = cut_tube(whole, span, str(limb))
        laid = on_limb(mesh, tube, up, settings, where)
    sheet, thickness = laid.sheet, np.linalg.norm(laid.sheet.vector, axis=1)
    return Casting(
        name=_plain(brace.stem),
        joint="",
        side="",
        brace=body_of(mesh.vertices, mesh.triangles, where),
        thickness_mm=laid.thickness_mm,
        vertices=sheet.vertices,
        direction=sheet.vector / thickness[:, None],
        thickness=thickness,
        triangles=sheet.triangles,
        covered=None,
        beyond=sheet.beyond,
        down=-laid.up,
        up=laid.up,
        centreline=laid.line,
        shrinkage=growth - 1.0,
        flat=normal is not None,
        repairs=(*given.repairs, *said, *laid.repairs),
    )


def casting_of(
    recording: str, domain: Domain, pattern: Pattern, solid: Solid, settings: MoldSettings
) -> Casting:
    """The same from the records themselves.

    Args:
        recording: What the brace was designed for, for labels.
        domain: The design domain.
        pattern: Struts and lands on it.
        solid: The brace.
        settings: Shrinkage, foot and gutter.

    Raises:
        GeometryError: The brace is thinner than the printer can print gaps, or the limb cannot be prolonged.
    """
    _check_width(pattern, solid, settings)
    joint, letter = domain.joint.split("_")
    brace = body_of(solid.vertices, solid.triangles, "solid")
    centre = centre_of(solid.vertices, solid.triangles)
    growth = _growth(settings)
    offset = safe_offset(domain, solid.thickness_mm)
    limb = with_windows_filled(
        Limb(domain.vertices, offset.vector, domain.triangles, np.zeros(len(domain.triangles), dtype=bool)),
        domain.window_loops,
    )
    line = centreline(limb.vertices, limb.triangles, domain.lower_loop, domain.upper_loop)
    sheet = _skin(domain, pattern, offset, limb)
    sheet = replace(sheet, vertices=centre + growth * (sheet.vertices - centre), vector=growth * sheet.vector)
    lower, upper = _edges(sheet, domain, centre + growth * (domain.vertices - centre))
    # the sheet lies on the left of its rim: seen from beyond, the rim runs clockwise
    low, high = (sheet.vertices[edge[:-1]] for edge in (lower, upper))
    down, up = axes_of(-loop_normal(low), -loop_normal(high), high.mean(axis=0) - low.mean(axis=0))
    sheet = prolonged(sheet, lower, down, settings.foot_mm, -1)
    sheet = prolonged(sheet, upper, up, settings.gutter_mm, 1)
    thickness = np.linalg.norm(sheet.vector, axis=1)
    return Casting(
        name="-".join([_plain(recording), joint, letter.upper()]),
        joint=joint,
        side=_SIDES[letter],
        brace=brace.translate(tuple(-centre)).scale((growth, growth, growth)).translate(tuple(centre)),
        thickness_mm=growth * solid.thickness_mm,
        vertices=sheet.vertices,
        direction=sheet.vector / thickness[:, None],
        thickness=thickness,
        triangles=sheet.triangles,
        covered=sheet.covered,
        beyond=sheet.beyond,
        down=down,
        up=up,
        centreline=centre + growth * (line - centre),
        shrinkage=growth - 1.0,
    )


def axes_of(
    lower: Float[Array, "3"], upper: Float[Array, "3"], way: Float[Array, "3"]
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Directions in which the core goes on below and above.

    Where both ends face away from each other they are along one line, in which the core stands.

    Args:
        lower: Unit normal out of the lower edge.
        upper: Unit normal out of the upper edge.
        way: From the middle of the lower edge to that of the upper one.
    """
    way = way / np.linalg.norm(way)
    if min(-lower @ way, upper @ way) < STANDING:
        return lower, upper
    axis = (upper - lower) / np.linalg.norm(upper - lower)
    return -axis, axis


def centre_of(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> Float[Array, "3"]:
    """Centroid of a closed body [mm]."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    volume = np.einsum("tx,tx->t", a, np.cross(b, c))
    return ((a + b + c) / 4 * volume[:, None]).sum(axis=0) / volume.sum()


def _growth(settings: MoldSettings) -> float:
    """What the casting will shrink from, over what it shall be [-]."""
    return 1.0 / (1.0 - settings.shrinkage_percent / 100.0)


def _check(folder: Path, pattern: Pattern, solid: Solid) -> None:
    if not len(pattern.land_triangles):
        raise InputError(
            "the pattern was drawn by a version that kept no skin between its struts",
            where=str(folder / "pattern" / "pattern.npz"),
            hint="delete the file and run the stage again",
        )
    if not solid.watertight or solid.parts != 1:
        raise GeometryError(
            f"the brace is no single closed body: {solid.parts} parts, "
            f"{'closed' if solid.watertight else 'open'}",
            where=str(folder / "solid"),
            hint="change pattern.resolution_mm a little and run the stages pattern and solid again",
        )


def _check_width(pattern: Pattern, solid: Solid, settings: MoldSettings) -> None:
    """Refuse struts that the mold's printer would close."""
    printer = profile(settings)
    thinnest = min(pattern.strut_width_min_mm, solid.thickness_min_mm)
    if thinnest < printer.min_wall_mm:
        raise GeometryError(
            f"the brace is only {thinnest:.2f} mm thick somewhere, and {printer.title} prints no wall or gap "
            f"below {printer.min_wall_mm:g} mm",
            where="mold.printer",
            hint="raise pattern.min_strut_mm, or print the mold in resin",
        )


def _skin(domain: Domain, pattern: Pattern, offset: Offset, limb: Limb) -> Sheet:
    """Struts, lands and filled windows; the outer face is linear over each triangle of the domain."""
    points = np.concatenate([pattern.vertices, pattern.land_vertices])
    vector = places_on(domain, points).value(domain.triangles, offset.vector)
    count, lands = len(pattern.triangles), len(pattern.land_triangles)
    sheet = Sheet(
        points,
        vector,
        np.concatenate([pattern.triangles, pattern.land_triangles]),
        np.arange(count + lands) < count,
        np.zeros(count + lands, dtype=np.int64),
    )
    caps = limb.triangles[limb.filled]
    if not len(caps):
        return sheet
    rim = rim_of(sheet.triangles)
    known = len(domain.vertices)
    loops = np.concatenate(domain.window_loops)
    number = len(points) - known + np.arange(len(limb.vertices))
    number[loops] = _on_rim(sheet, rim, domain.vertices[loops])
    return sheet.joined(limb.vertices[known:], limb.vector[known:], _divided(caps, number, rim))


def _divided(caps: Int[Array, "cap 3"], number: Int[Array, " vertex"], rim: Rim) -> Int[Array, "triangle 3"]:
    """Caps whose edges on the rim are divided as finely as the rim is.

    Args:
        caps: Triangles of a coarse mesh, none with two edges on its border.
        number: What its vertices are called in the fine one.
        rim: Border of the fine mesh.
    """
    count = len(number)
    code = caps * count + np.roll(caps, -1, axis=1)
    border = np.isin(code, border_edges(caps) @ [count, 1])
    pieces = [number[caps[~border.any(axis=1)]]]
    for row, side in zip(*np.nonzero(border), strict=True):
        head, tail, tip = (int(number[caps[row, (side + k) % 3]]) for k in range(3))
        way = rim.walk(tail, head)[::-1]
        pieces.append(np.stack([way[:-1], way[1:], np.full(len(way) - 1, tip)], axis=1))
    return np.concatenate(pieces)


def _edges(
    sheet: Sheet, domain: Domain, points: Float[Array, "vertex 3"]
) -> tuple[Int[Array, " low"], Int[Array, " up"]]:
    """Vertices along the lower and the upper edge, the first one again at the end.

    Args:
        sheet: The sheet.
        domain: The design domain.
        points: Where the domain's vertices are now.
    """
    rim = rim_of(sheet.triangles)
    first = np.array([domain.lower_loop[0], domain.upper_loop[0]])
    low, high = (int(start) for start in _on_rim(sheet, rim, points[first]))
    return rim.walk(low, low), rim.walk(high, high)


def _on_rim(sheet: Sheet, rim: Rim, points: Float[Array, "point 3"]) -> Int[Array, " point"]:
    """Vertices of the rim at given places."""
    away, near = KDTree(sheet.vertices[rim.vertices]).query(points)
    if away.max() > _TOUCH_MM:
        raise GeometryError(
            f"the struts do not lie on the domain's surface: an edge is {away.max():.3g} mm away",
            where="pattern",
            hint="run the stages pattern and solid again",
        )
    return rim.vertices[near]


def _plain(text: str) -> str:
    """A short name of letters and digits."""
    return "".join(letter if letter.isalnum() else "_" for letter in text)[:24] or "brace"
