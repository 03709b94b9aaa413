"""Into how many shells a mold parts, where they meet, and which way each comes off.

The fewest shells are taken from which the limb can be freed. Two shells are tried along pulls all around the
limb's axis; of pulls that are as good, the one across the plane in which the limb bends is taken, so that the
shells of a leg come off sideways. What hinders a shell is measured on every face; faces that lean a hair
against the pull, which facets and real skin always have, are relieved, and what they cost is measured.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from manifold3d import Manifold

from fabrication.ends import End, find_ends, reaching_inside
from fabrication.faces import face_normals
from fabrication.mold import Casting, Core
from fabrication.seams import Seam, Surface, fit_graph, pull_axes, surface_of
from fabrication.undercut import hindering, lean, relief, undercut_areas
from fabrication.wedges import limb_wedges
from hilbrace.config.mold import MoldSettings
from hilbrace.errors import GeometryError

Array = np.ndarray

AZIMUTHS = 24
"""Directions that are tried, evenly around the axis."""

SCAN_CELL_MM, CELL_MM = 8.0, 3.0
"""Spacing of the parting's grid while directions are tried, and of the final one [mm]."""

SCAN_SIMPLIFY_MM = 0.05
"""How far the surface may be off while directions are tried [mm]."""

AS_GOOD = 3e-3
"""Directions whose undercut differs by less than this part of the surface are equally good [-]."""

MOST_UNDERCUT = 2e-2
"""Largest part of the surface that may hinder its shell [-]: facets beside the parting, mostly."""

MOST_RELIEF = 5e-4
"""Largest volume of all reliefs, as a part of the brace's [-]. They are cast too, so a quarter of the error
that a cavity may have."""

OUTSIDE_MM = 8.0
"""How far the parting reaches beyond the flanges [mm]."""

BEND_MM = 2.0
"""A centreline that leaves a straight line by less than this has no plane of its own [mm]."""


@dataclass(frozen=True)
class Parting:
    """How a mold parts.

    Attributes:
        names: Name of each shell, for files: ``shell_medial``.
        titles: What a person calls it.
        pulls: Unit direction in which each comes off.
        sectors: The room of each: they fill space and do not overlap.
        seams: Sheets in which two shells meet; none of a lid.
        reliefs: What each shell must lack besides the core so that it comes off.
        relief_mm3: Volume that the reliefs take from the shells [mm^3].
        ends: Where the shells end.
        shell_of: The shell on each triangle of the casting.
        undercut_deg: Angle by which each triangle of the casting hinders its shell, negative where it lets
            it go [deg].
        undercut_mm2: Area that hinders each shell by more than a degree [mm^2], by name.
        land: The body that the shells come off: the core without grooves.
        sides_mm2: Area of the casting's surface between the ends [mm^2].
    """

    names: tuple[str, ...]
    titles: tuple[str, ...]
    pulls: Float[Array, "shell 3"]
    sectors: tuple[Manifold, ...]
    seams: tuple[Seam, ...]
    reliefs: tuple[Manifold, ...]
    relief_mm3: float
    ends: tuple[End, ...]
    shell_of: Int[Array, " triangle"]
    undercut_deg: Float[Array, " triangle"]
    undercut_mm2: dict[str, float]
    land: Manifold
    sides_mm2: float


def find_parting(casting: Casting, core: Core, settings: MoldSettings) -> Parting:
    """Choose the shells of a mold.

    Args:
        casting: What shall be cast.
        core: Its core; the directions are tried on its land.
        settings: Section ``mold``; ``shells`` fixes their number.

    Returns:
        The parting with the fewest shells that come off; a lid over a flat casting.

    Raises:
        GeometryError: Shells of the number wanted, or of any number up to four, do not come off.
    """
    if casting.flat:
        return _lid(casting, core)
    counts = (settings.shells,) if settings.shells else (2, 3, 4)
    refused = []
    for count in counts:
        parting = _best(casting, core, count, settings)
        parting = replace(parting, relief_mm3=relief_volume(parting))
        fault = _fault(parting, casting)
        if fault is None:
            return parting
        refused.append(f"{count} shells: {fault}")
    raise GeometryError(
        "the shells do not come off the limb",
        where="; ".join(refused),
        hint="smooth hollows of the limb, shorten the brace, or choose another number in mold.shells",
    )


def relief_volume(parting: Parting) -> float:
    """Volume that the reliefs take from the shells, and give to the casting [mm^3]."""
    rooms = zip(parting.reliefs, parting.sectors, strict=True)
    return sum(((body ^ sector) - parting.land).volume() for body, sector in rooms if not body.is_empty())


def graph_parting(
    casting: Casting, core: Core, pull: Float[Array, "3"], along: Float[Array, "3"], reach_mm: float
) -> Parting:
    """Two shells that meet in the sheet through the outline which the limb shows to a pull.

    Args:
        casting: What shall be cast.
        core: Its core.
        pull: Direction in which the first shell comes off; the second leaves the other way.
        along: Direction of the limb.
        reach_mm: How far flanges reach from the limb's surface [mm].
    """
    ends = find_ends(casting)
    surface = surface_of(core.land, ends)
    graph = fit_graph(surface, pull_axes(pull, along), reach_mm + OUTSIDE_MM, CELL_MM)
    above = graph.above(surface.vertices)
    reach = 2.0 * float(np.abs(surface.vertices @ graph.axes[2]).max() + np.ptp(graph.height))
    pulls = np.stack([graph.axes[2], -graph.axes[2]])
    return _parting(
        casting,
        core.land,
        surface,
        ends,
        pulls,
        graph.half_spaces(reach),
        (Seam(1, 0, graph.points(), graph.axes[2]),),
        lambda points: np.where(graph.above(points) > 0, 0, 1),
        [above, -above],
    )


def wedge_parting(
    casting: Casting, core: Core, count: int, turn: float, axes: Float[Array, "3 3"], reach_mm: float
) -> Parting:
    """Three or more shells that meet in half-planes which spring from the limb's centreline.

    Args:
        casting: What shall be cast.
        core: Its core.
        count: How many shells.
        turn: Angle of the first meeting from the first axis [rad].
        axes: Rows: two unit directions across the limb, and along it.
        reach_mm: How far flanges reach from the limb's surface [mm].
    """
    ends = find_ends(casting)
    surface = surface_of(core.land, ends)
    margin = reach_mm + OUTSIDE_MM
    along = casting.outer @ axes[2]
    wide = float(np.linalg.norm(np.ptp(casting.outer, axis=0))) + margin
    wedges = limb_wedges(casting.centreline, along.min() - margin, along.max() + margin, turn, count, axes)
    depths = [wedges.depth(surface.vertices, pull) for pull in wedges.pulls]
    return _parting(
        casting,
        core.land,
        surface,
        ends,
        wedges.pulls,
        wedges.bodies(wide),
        wedges.seams(wide),
        wedges.wedge_of,
        depths,
    )


def limb_axes(casting: Casting) -> Float[Array, "3 3"]:
    """Across the plane in which the limb bends, in it, and along the limb.

    A leg bends in its sagittal plane; a limb that is no known joint in the plane that its centreline shows.
    """
    line = casting.centreline
    along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
    sideways = np.array([0.0, 0.0, 1.0])
    if not casting.joint:
        away = line - line.mean(axis=0)
        away -= np.outer(away @ along, along)
        _, spread, ways = np.linalg.svd(away, full_matrices=False)
        if spread[0] > BEND_MM * np.sqrt(len(line)):
            sideways = np.cross(along, ways[0])
    if abs(sideways @ along) > 0.9:
        sideways = np.array([1.0, 0.0, 0.0])
    sideways = sideways - (sideways @ along) * along
    sideways /= np.linalg.norm(sideways)
    sideways *= np.sign(sideways[np.argmax(np.abs(sideways))])
    return np.stack([sideways, np.cross(along, sideways), along])


def _best(casting: Casting, core: Core, count: int, settings: MoldSettings) -> Parting:
    """The best parting into a number of shells."""
    reach = settings.wall_mm + settings.flange_mm
    surface = surface_of(core.land.simplify(SCAN_SIMPLIFY_MM), find_ends(casting))
    axes = limb_axes(casting)
    if count == 2:
        turns = np.arange(AZIMUTHS) * np.pi / AZIMUTHS
        pulls = np.cos(turns)[:, None] * axes[0] + np.sin(turns)[:, None] * axes[1]
        hindered = [_hindered_by_sheet(surface, pull, axes[2]) for pull in pulls]
        return graph_parting(casting, core, pulls[_first_good(hindered)], axes[2], reach)
    turns = np.arange(AZIMUTHS) * 2 * np.pi / count / AZIMUTHS
    along = surface.vertices @ axes[2]
    tried = [limb_wedges(casting.centreline, along.min(), along.max(), turn, count, axes) for turn in turns]
    hindered = [_hindered(surface, wedges.wedge_of(surface.middles), wedges.pulls) for wedges in tried]
    return wedge_parting(casting, core, count, float(turns[_first_good(hindered)]), axes, reach)


def _first_good(hindered: list[float]) -> int:
    """The candidate nearest to the first one, either way around, that is as good as the best."""
    good = np.flatnonzero(np.array(hindered) <= min(hindered) + AS_GOOD)
    return int(min(good, key=lambda at: (min(at, len(hindered) - at), at)))


def _hindered_by_sheet(surface: Surface, pull: Array, along: Array) -> float:
    graph = fit_graph(surface, pull_axes(pull, along), SCAN_CELL_MM, SCAN_CELL_MM)
    above = graph.above(surface.middles) > 0
    return _hindered(surface, np.where(above, 0, 1), np.stack([pull, -pull]))


def _hindered(surface: Surface, shell_of: Array, pulls: Array) -> float:
    """Part of a surface that hinders the shells [-]."""
    angle = lean(surface.normals, shell_of, pulls)
    return float(undercut_areas(angle, surface.areas, shell_of, len(pulls)).sum() / surface.areas.sum())


def _parting(
    casting: Casting,
    land: Manifold,
    surface: Surface,
    ends: tuple[End, ...],
    pulls: Array,
    sectors: tuple[Manifold, ...],
    seams: tuple[Seam, ...],
    shell_at: Callable[[Array], Array],
    depths: list[Array],
) -> Parting:
    """Measure a parting and clear what hinders it.

    Args:
        casting: What shall be cast.
        land: The core without grooves.
        surface: Its sides.
        ends: Where the shells end.
        pulls: Direction of each shell.
        sectors: Room of each shell.
        seams: Where they meet.
        shell_at: Shell whose room a point lies in.
        depths: How far each vertex of the surface lies above the parting, for each shell.
    """
    reliefs = tuple(
        relief(surface, hindering(surface, depth, pull), depth, pull)
        for pull, depth in zip(pulls, depths, strict=True)
    )
    faces = shell_at(casting.outer[casting.triangles].mean(axis=1))
    normals, areas = face_normals(casting.outer, casting.triangles)
    angle = lean(normals, faces, pulls)
    within = reaching_inside(ends, casting.outer, casting.triangles)
    hindered = undercut_areas(angle[within], areas[within], faces[within], len(pulls))
    names, titles = _names(casting, pulls)
    return Parting(
        names=names,
        titles=titles,
        pulls=pulls,
        sectors=sectors,
        seams=seams,
        reliefs=reliefs,
        relief_mm3=0.0,
        ends=ends,
        shell_of=faces,
        undercut_deg=angle,
        undercut_mm2=dict(zip(names, hindered.tolist(), strict=True)),
        land=land,
        sides_mm2=float(areas[within].sum()),
    )


def _fault(parting: Parting, casting: Casting) -> str | None:
    """Why a parting will not do; ``None`` where it will."""
    hindered = sum(parting.undercut_mm2.values())
    if hindered > MOST_UNDERCUT * parting.sides_mm2:
        return f"{hindered:.0f} mm2 of {parting.sides_mm2:.0f} mm2 are undercut"
    if parting.relief_mm3 > MOST_RELIEF * casting.brace.volume():
        return f"undercuts would add {parting.relief_mm3:.0f} mm3 to the casting"
    return None


def _lid(casting: Casting, core: Core) -> Parting:
    """One shell over a flat casting.

    Raises:
        GeometryError: The ground bends so much that a lid does not come off it.
    """
    normals, areas = face_normals(casting.outer, casting.triangles)
    pull = areas @ normals
    pull /= np.linalg.norm(pull)
    shell_of = np.zeros(len(casting.triangles), int)
    angle = lean(normals, shell_of, pull[None])
    if angle.max() > 0:
        raise GeometryError(
            f"the ground leans {angle.max():.0f} deg against the pull of a lid",
            where="mold shells",
            hint="flatten the ground, or give the limb as a closed tube",
        )
    size = 4.0 * float(np.linalg.norm(np.ptp(casting.outer, axis=0)))
    room = Manifold.cube((size, size, size), True).translate(tuple(casting.outer.mean(axis=0)))
    return Parting(
        names=("shell_lid",),
        titles=("Lid",),
        pulls=pull[None],
        sectors=(room,),
        seams=(),
        reliefs=(Manifold(),),
        relief_mm3=0.0,
        ends=(),
        shell_of=shell_of,
        undercut_deg=angle,
        undercut_mm2={"shell_lid": 0.0},
        land=core.land,
        sides_mm2=float(areas.sum()),
    )


def _names(casting: Casting, pulls: Array) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """File names and titles: sides of the leg where each shell has one of its own, numbers elsewhere."""
    lateral = -1.0 if casting.side == "left" else 1.0
    sides = {"front": pulls[:, 0], "back": -pulls[:, 0]}
    sides |= {"lateral": lateral * pulls[:, 2], "medial": -lateral * pulls[:, 2]}
    words = [max(sides, key=lambda side: float(sides[side][shell])) for shell in range(len(pulls))]
    if not casting.joint or max(Counter(words).values()) > 1:
        words = [str(shell + 1) for shell in range(len(pulls))]
    return tuple(f"shell_{word}" for word in words), tuple(f"Shell, {word}" for word in words)
