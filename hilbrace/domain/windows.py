"""Windows in the sleeve: holes inside it that let the kneecap or the heel free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Float

from hilbrace.config.domain import WindowSettings
from hilbrace.domain.isoline import cut_by_levels, mesh_edges
from hilbrace.domain.landmarks import find_landmark
from hilbrace.domain.limb import Limb, Surface
from hilbrace.domain.loops import Loops, enclosed_area, loops_of
from hilbrace.errors import ConfigError, GeometryError

Array = np.ndarray

PATELLA_MM = (52.0, 64.0)
"""Width and height of the window over the kneecap [mm]."""

HEEL_SHARE = (0.30, 0.38)
"""Width and height of the open heel, in lengths of the foot before the ankle [-]."""

HEEL_OF_END = 3.4
"""The same length is taken to be at most so many square roots of the area that the lower end encloses, so
that the heel of a flat foot is not opened as wide as the sleeve itself [-]."""

_LARGEST = 0.75
"""Largest area that a window may enclose, of what the smaller end of the sleeve does [-]."""

_SNAP = 0.2
"""Vertices nearer to the edge of a window than this share of an edge move onto it [-]."""


@dataclass(frozen=True)
class Window:
    """An ellipsoid around a place on the skin; what lies inside it is left out of the sleeve.

    On a flat patch its edge is the ellipse of its width and height; on a round heel it narrows by itself.

    Attributes:
        name: Landmark that it lies around.
        key: Configuration key that asks for it.
        centre: Middle, in limb axes [mm].
        axes: Unit axes across, up the limb, and out of the skin [-].
        radii: Half-axes along them [mm].
    """

    name: str
    key: str
    centre: Float[Array, " xyz"]
    axes: Float[Array, "3 3"]
    radii: Float[Array, " 3"]

    @property
    def title(self) -> str:
        """Name of the landmark as it is written in a sentence."""
        return self.name.replace("_", " ")

    def levels(self, points: Float[Array, "point 3"]) -> Float[Array, " point"]:
        """About the distance of points outside the window's edge [mm]; negative inside."""
        scaled = (points - self.centre) @ self.axes.T / self.radii
        return (np.linalg.norm(scaled, axis=1) - 1.0) * float(self.radii.min())


def find_windows(
    skin: Surface, limb: Limb, region: Surface, wanted: Sequence[WindowSettings] | None
) -> tuple[Window, ...]:
    """The windows that a configuration asks for; where it says nothing, none at the knee and the open heel.

    Args:
        skin: The skin in limb axes [mm].
        limb: Axes of the limb.
        region: The sleeve that they are to be opened in [mm].
        wanted: ``domain.windows``.

    Raises:
        ConfigError: A landmark is unknown, or a size is missing.
        GeometryError: There is no skin at a landmark.
    """
    if wanted is None:
        wanted = (WindowSettings(at="heel"),) if limb.name == "ankle" else ()
    end = enclosed_area(region, loops_of(region, limb).lower)
    reach = min(float(limb.lower @ limb.distal), HEEL_OF_END * float(np.sqrt(end)))
    usual = {"patella": PATELLA_MM, "heel": (HEEL_SHARE[0] * reach, HEEL_SHARE[1] * reach)}
    return tuple(
        _window(skin, limb, window, usual.get(window.at, (None, None)), f"domain.windows[{number}]")
        for number, window in enumerate(wanted)
    )


def open_windows(region: Surface, limb: Limb, windows: Sequence[Window]) -> Surface:
    """A sleeve without what lies in its windows.

    Args:
        region: The sleeve [mm].
        limb: Axes of the limb.
        windows: Windows to open.

    Raises:
        GeometryError: A window crosses an edge of the sleeve or another window, or is no single hole.
    """
    edges, _ = mesh_edges(region.triangles)
    margin = float(np.median(np.linalg.norm(np.diff(region.vertices[edges], axis=1), axis=-1)))
    ends = loops_of(region, limb)
    _check_apart(region, ends, windows, margin)
    smaller = min(enclosed_area(region, loop) for loop in (ends.upper, ends.lower))
    for window in windows:
        before = igl.euler_characteristic(region.triangles)
        levels = -window.levels(region.vertices)
        region = Surface(*cut_by_levels(region.vertices, region.triangles, levels, _SNAP))
        pieces = np.unique(np.asarray(igl.facet_components(region.triangles)[1]))
        if igl.euler_characteristic(region.triangles) != before - 1 or len(pieces) != 1:
            raise GeometryError(
                f"the window at the {window.title} is no single hole in the skin",
                where=window.key,
                hint="make the window smaller or larger: it meets the skin in several places, or nowhere",
            )
        largest = max(enclosed_area(region, loop) for loop in loops_of(region, limb).windows)
        if largest > _LARGEST * smaller:
            raise GeometryError(
                f"the window at the {window.title} encloses {largest:.0f} mm^2 and an end of the sleeve "
                f"{smaller:.0f} mm^2: it is no window any more",
                where=window.key,
                hint="make the window smaller",
            )
    return region


def _check_apart(region: Surface, ends: Loops, windows: Sequence[Window], margin_mm: float) -> None:
    taken = np.zeros(len(region.vertices), bool)
    taken[np.concatenate([np.zeros(0, np.int64), *ends.windows])] = True
    for window in windows:
        inside = window.levels(region.vertices) < margin_mm
        for name, loop in (("upper", ends.upper), ("lower", ends.lower)):
            if inside[loop].any():
                raise GeometryError(
                    f"the window at the {window.title} crosses the {name} edge of the sleeve",
                    where=window.key,
                    hint="make the window smaller, or the sleeve longer (domain.above, domain.below)",
                )
        if (taken & inside).any():
            raise GeometryError(
                f"the window at the {window.title} runs into another window",
                where=window.key,
                hint="make the windows smaller, or join them into one",
            )
        taken |= inside


def _window(
    skin: Surface, limb: Limb, wanted: WindowSettings, usual: tuple[float | None, float | None], key: str
) -> Window:
    landmark = find_landmark(skin, limb, wanted.at, f"{key}.at")
    width = usual[0] if wanted.width_mm is None else wanted.width_mm
    height = usual[1] if wanted.height_mm is None else wanted.height_mm
    if width is None or height is None:
        raise ConfigError(
            f"a window at the {wanted.at} has no usual size",
            where=key,
            hint=f"set {key}.width_mm and {key}.height_mm",
        )
    axes = np.stack([np.cross(landmark.upward, landmark.outward), landmark.upward, landmark.outward])
    radii = np.array([width, height, max(width, height)]) / 2.0
    return Window(landmark.name, key, landmark.position, axes, radii)
