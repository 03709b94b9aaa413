"""Windows in the sleeve: holes inside it that let the kneecap or the heel free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.domain.landmarks import Landmark, find_landmark
from hilbrace.domain.limb import Limb, Surface

Array = np.ndarray

HEEL_SHARE = (0.30, 0.38)
"""Width and height of the open heel, in lengths of the foot before the ankle [-]."""


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


def window_at(landmark: Landmark, key: str, width_mm: float, height_mm: float) -> Window:
    """The window of a given width and height around a landmark.

    Args:
        landmark: Its middle.
        key: Configuration key that asks for it.
        width_mm: Width around the limb [mm].
        height_mm: Height along the limb [mm].
    """
    axes = np.stack([np.cross(landmark.upward, landmark.outward), landmark.upward, landmark.outward])
    radii = np.array([width_mm, height_mm, max(width_mm, height_mm)]) / 2.0
    return Window(landmark.name, key, landmark.position, axes, radii)


def preset_windows(skin: Surface, limb: Limb) -> tuple[Window, ...]:
    """The windows that a brace has where none are asked for: none at the knee, the open heel at the ankle.

    Args:
        skin: The skin in limb axes [mm].
        limb: Axes of the limb.

    Raises:
        GeometryError: There is no skin at the heel.
    """
    if limb.name != "ankle":
        return ()
    reach = float(limb.lower @ limb.distal)
    width, height = (share * reach for share in HEEL_SHARE)
    return (window_at(find_landmark(skin, limb, "heel", "domain.joint"), "domain.windows", width, height),)
